"""Contents of the controller's parameter file, and the mission of a run."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

from firmware_py import settings
from firmware_py.settings import SettingsError
from firmware_py.trackdb import LineMap, Station
from vobc.ato import AtoConfig
from vobc.ato.laws import STRATEGIES
from vobc.atp import AtpConfig
from vobc.odometry import OdometryConfig
from vobc.vocabulary import Mission, TrainBelief

SHIPPED = "vobc.params"
CYCLE_MS_MIN = 5.0
CYCLE_MS_MAX = 200.0
NOTHING: Final[Mapping[str, Any]] = {}
RANGES: Final[Mapping[str, tuple[float, float]]] = {
    "report_ms": (50.0, 2000.0),
    "manual_jerk_mps3": (0.05, 5.0),
}
"""Plausible range of each value."""


@dataclass(frozen=True, slots=True)
class VobcConfig:
    name: str
    address: int
    """Number of the train on the radio."""
    cycle_ms: float
    report_ms: float
    """Period of position reports on the radio."""
    manual_jerk_mps3: float
    """Greatest rate at which the demand follows the lever."""
    train: TrainBelief
    odometry: OdometryConfig
    atp: AtpConfig
    ato: AtoConfig = field(default_factory=AtoConfig)

    def __post_init__(self) -> None:
        if not CYCLE_MS_MIN <= self.cycle_ms <= CYCLE_MS_MAX:
            raise ValueError(
                f"cycle_ms {self.cycle_ms} is not in {CYCLE_MS_MIN:g}..{CYCLE_MS_MAX:g}"
            )
        if not 1 <= self.address <= 65535:
            raise ValueError(f"address {self.address} is not in 1..65535")
        if self.ato.strategy not in STRATEGIES:
            known = ", ".join(sorted(STRATEGIES))
            raise ValueError(f"ato.strategy {self.ato.strategy!r} is unknown; there is {known}")
        settings.check_ranges(self, RANGES)

    @property
    def true_per_counted(self) -> float:
        """Greatest true distance of one metre that odometry counts."""
        return 1.0 / (1.0 + self.odometry.scale_error_low_ratio)


def load_config(
    name: str,
    *,
    cycle_ms: float | None = None,
    law: str | None = None,
    stage: str | None = None,
    changes: Mapping[str, Any] = NOTHING,
) -> VobcConfig:
    """Load parameters by path or by the stem of a shipped file. Raises SettingsError.

    Operation uses the same train properties as the rest of the controller.

    Args:
        law: control law of the automatic operation, instead of the file's.
        stage: its output stage, instead of the file's.
        changes: changes of the file by dotted key; see `firmware_py.settings.override`.
    """
    config = settings.load(VobcConfig, name, SHIPPED)
    config = settings.override(config, changes, name)
    if law is not None:
        config = settings.override(config, {"ato.strategy": law}, "--ato")
    if stage is not None:
        config = settings.override(config, {"ato.output.stage": stage}, "--output")
    train = config.train
    ato = replace(
        config.ato,
        train_length_m=train.length_m,
        rotating_mass_percent=100.0 * train.rotating_mass_ratio,
    )
    try:
        return replace(config, ato=ato, cycle_ms=config.cycle_ms if cycle_ms is None else cycle_ms)
    except ValueError as error:
        raise SettingsError(f"--cycle-ms: {error}") from error


def plan_mission(
    line: LineMap, start: str | None, end: str | None, only: Sequence[str] | None = None
) -> Mission:
    """Mission from one station to another. The default is the whole line.

    Raises SettingsError for a station that does not exist or lies in the wrong direction.

    Args:
        only: stations to stop at, including the last one. None: all stations on the way.
    """
    first = _station(line, start, line.stations[0], "--from")
    last = _station(line, end, line.stations[-1], "--to")
    stops = tuple(line.stations_between(first.stop_m, last.stop_m))
    if not stops:
        raise SettingsError(
            f"--to {last.name}: lies at {last.stop_m:g} m, not beyond {first.name} at "
            f"{first.stop_m:g} m; trains run towards growing chainage"
        )
    return Mission(first, stops if only is None else _chosen(stops, only))


def _chosen(stops: Sequence[Station], only: Sequence[str]) -> tuple[Station, ...]:
    names = [station.name for station in stops]
    for name in only:
        if name not in names:
            raise SettingsError(f"stops: {name}: not on the way; {settings.nearest(name, names)}")
    if names[-1] not in only:
        raise SettingsError(f"stops: the last must be {names[-1]}, the end of the mission")
    return tuple(station for station in stops if station.name in only)


def _station(line: LineMap, name: str | None, default: Station, option: str) -> Station:
    if name is None:
        return default
    try:
        return line.station(name)
    except KeyError as error:
        raise SettingsError(f"{option} {name}: {error.args[0]}") from None
