"""Reads a recorded ride of this project's bus from a log in any format that canlog reads."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NamedTuple

import canlog
from can_dbc.analogue import AnalogueCommand
from can_dbc.binding import Frame
from can_dbc.brake import BrakeCommand
from can_dbc.cab import Desk
from can_dbc.codec import Decoder
from can_dbc.diagnostics import TcmsStatus
from can_dbc.doors import DoorCars, DoorCommand
from can_dbc.odometer import Tacho
from can_dbc.rejection import Rejected
from can_dbc.traction import TractionCommand
from can_dbc.vobc import VobcPosition
from firmware_py.settings import SettingsError
from firmware_py.trackdb import LineMap, Station
from metro_hil.metrics.stops import NEAR_STOP_M
from plant_emulator.sensors.tacho import COUNTER_PERIOD
from plant_emulator.train_config import NOMINAL_WHEEL_M, PULSES_PER_TURN
from plant_emulator.world import STEP_NS

COMMANDS: Final = (BrakeCommand, TractionCommand, DoorCommand, DoorCars, AnalogueCommand, Desk)
"""Frames that act on the train, or on its train lines."""
TACHO: Final = "TACHO"
NEEDED: Final[Mapping[type[Frame], str]] = {
    Tacho: TACHO,
    BrakeCommand: "BRAKE_CMD and BRAKE_CMD_INV",
    TractionCommand: "TRACTION_CMD and TRACTION_CMD_INV",
    VobcPosition: "VOBC_POSITION",
}
"""Frames without which a ride cannot be repeated, as the DBC files name them."""
DAMAGED_RATIO_MAX: Final = 0.5
"""Greatest share of rejected frames; beyond it, the log counts as that of another bus."""
UNCERTAIN_MAX_M: Final = 20.0
"""Uncertainty up to which a reported position counts."""
AT_STATION_M: Final = 5.0
"""Greatest distance from the stopping point at which the train stands at a station."""
RIDE_MIN_M: Final = 50.0
"""Least distance of a ride; a shorter one does not show how the train drives and brakes."""
METRES_PER_PULSE: Final = math.pi * NOMINAL_WHEEL_M / PULSES_PER_TURN
DISTANCE_ERROR_MAX_RATIO: Final = 0.2
"""Greatest error of the odometer that a scenario may have."""


class HeardFrame(NamedTuple):
    at_ns: int
    frame: Frame


class OdometerSample(NamedTuple):
    """A sample of the odometer."""

    at_ns: int
    distance_m: float
    """Distance since the start of the log, for a wheel of nominal diameter."""


class ReportedPlace(NamedTuple):
    at_ns: int
    front_m: float


@dataclass(frozen=True, slots=True)
class RecordedRide:
    """What a log tells of one ride; all times are since the start of the log."""

    path: Path
    start_ns: int
    """Stamp of the log at which the ride begins."""
    commands: tuple[HeardFrame, ...]
    odometer: tuple[OdometerSample, ...]
    positions: tuple[ReportedPlace, ...]
    """Positions that the controller reported with little uncertainty."""
    desk: tuple[HeardFrame, ...]
    load_kg: float | None
    """Mass of all passengers that the air springs reported at first; None if not recorded."""

    @property
    def duration_ns(self) -> int:
        return self.odometer[-1].at_ns

    @property
    def distance_m(self) -> float:
        return self.odometer[-1].distance_m

    @property
    def left_ns(self) -> int:
        """Time at which the odometer first moves."""
        return next(each.at_ns for each in self.odometer if abs(each.distance_m) > 0.1)


class RideStations(NamedTuple):
    start: Station
    stops: tuple[Station, ...]
    """Stations at which the train stopped, and the one for which it was bound at the end."""
    arrived: bool
    """Whether the log ends with the train standing at the last of them."""


@dataclass(slots=True)
class _Found:
    heard: dict[type[Frame], list[HeardFrame]] = field(default_factory=dict)
    rejected: dict[int, int] = field(default_factory=dict)

    def of(self, *kinds: type[Frame]) -> tuple[HeardFrame, ...]:
        mixed = [each for kind in kinds for each in self.heard.get(kind, [])]
        return tuple(sorted(mixed, key=lambda each: each.at_ns))


def read_ride(log: "canlog.Log") -> RecordedRide:
    """Read the ride of a log. Raises SettingsError if the log shows no ride of this bus."""
    path = log.path
    tacho = canlog.load_bus().message(TACHO).key
    if len(on := [channel for key, channel in log.groups.places if key == tacho]) > 1:
        raise SettingsError(f"{path}: channels {', '.join(on)} have {TACHO}; name one by --channel")
    start_ns = log.start_ns - log.start_ns % STEP_NS
    found = _decoded(log, start_ns)
    heard = sum(len(each) for each in found.heard.values())
    rejected = sum(found.rejected.values())
    if rejected > DAMAGED_RATIO_MAX * (heard + rejected):
        raise SettingsError(
            f"{path}: {rejected} of {heard + rejected} frames with identifiers of this bus are "
            "damaged; name a log of this project's bus, or one of its channels by --channel"
        )
    lacking = [name for kind, name in NEEDED.items() if kind not in found.heard]
    if lacking:
        raise SettingsError(
            f"{path}: has no frame {', no '.join(lacking)}; name a log of this project's bus that "
            "holds odometer and controller"
        )
    samples = found.of(Tacho)
    ride = RecordedRide(
        path=path,
        start_ns=start_ns,
        commands=found.of(*COMMANDS),
        odometer=tuple(_counted(samples)),
        positions=tuple(
            ReportedPlace(at_ns, frame.front_m)
            for at_ns, frame in found.of(VobcPosition)
            if isinstance(frame, VobcPosition) and frame.uncertainty_m <= UNCERTAIN_MAX_M
        ),
        desk=found.of(Desk),
        load_kg=next(
            (each.load_kg for _, each in found.of(TcmsStatus) if isinstance(each, TcmsStatus)),
            None,
        ),
    )
    if ride.distance_m < RIDE_MIN_M:
        raise SettingsError(
            f"{path}: is too short: the train moves {ride.distance_m:.1f} m in "
            f"{ride.duration_ns / 1e9:.1f} s; a ride of at least {RIDE_MIN_M:g} m is needed"
        )
    return ride


def _decoded(log: "canlog.Log", start_ns: int) -> _Found:
    decoder = Decoder((*COMMANDS, Tacho, TcmsStatus, VobcPosition))
    found, frames = _Found(), log.frames
    rows = [
        row
        for row, (can_id, is_data) in enumerate(
            zip(frames.key.tolist(), frames.is_data.tolist(), strict=True)
        )
        if is_data and can_id in decoder.ids
    ]
    rows.sort(key=frames.at_ns.__getitem__)
    for row in rows:
        at_ns, can_id = int(frames.at_ns[row]) - start_ns, int(frames.identifier[row])
        heard = decoder.decode(can_id, frames.payload(row), at_ns)
        if isinstance(heard, Rejected):
            found.rejected[can_id] = found.rejected.get(can_id, 0) + 1
        elif heard is not None:
            found.heard.setdefault(type(heard), []).append(HeardFrame(at_ns, heard))
    return found


def _counted(samples: Sequence[HeardFrame]) -> "list[OdometerSample]":
    """Add up the counter of tacho A, which wraps."""
    counted: list[OdometerSample] = []
    pulses, before = 0, None
    for at_ns, frame in samples:
        assert isinstance(frame, Tacho)
        if before is not None:
            step = (frame.pulses_a - before) % COUNTER_PERIOD
            pulses += step - COUNTER_PERIOD if step > COUNTER_PERIOD // 2 else step
        before = frame.pulses_a
        counted.append(OdometerSample(at_ns, pulses * METRES_PER_PULSE))
    return counted


def stations_of(ride: RecordedRide, line: LineMap) -> RideStations:
    """The stations of a ride. Raises SettingsError if it does not begin at one."""
    still = _standstills(ride)
    if not still or still[0].at_ns > ride.left_ns:
        raise SettingsError(
            f"{ride.path}: the controller reports no certain place (VOBC_POSITION) while the train "
            "stands at first; begin the log at a station, with the train localised"
        )
    start = _nearest(line, still[0].front_m)
    off_m = still[0].front_m - start.stop_m
    if abs(off_m) > AT_STATION_M:
        raise SettingsError(
            f"{ride.path}: begins with the train at {still[0].front_m:.1f} m, {abs(off_m):.1f} m "
            f"from {start.name}; begin the log at a station of {line.name}, or name its --line"
        )
    last = ride.positions[-1]
    stops = [
        station
        for station in line.stations
        if station.stop_m > start.stop_m
        and any(abs(each.front_m - station.stop_m) <= NEAR_STOP_M for each in still)
    ]
    off_m = abs(last.front_m - stops[-1].stop_m) if stops else math.inf
    if off_m > NEAR_STOP_M:
        ahead = [each for each in line.stations if each.stop_m > last.front_m]
        if not ahead or last.front_m <= start.stop_m:
            raise SettingsError(
                f"{ride.path}: ends at {last.front_m:.1f} m of {line.name}, with no station ahead; "
                "name the --line of the ride, with its direction"
            )
        stops.append(ahead[0])
    return RideStations(start, tuple(stops), arrived=off_m <= AT_STATION_M)


def _standstills(ride: RecordedRide) -> list[ReportedPlace]:
    """Reported places within a second without any pulse."""
    moved_ns = [
        now.at_ns
        for before, now in zip(ride.odometer, ride.odometer[1:], strict=False)
        if now.distance_m != before.distance_m
    ]
    still, index = [], 0
    for each in ride.positions:
        while index < len(moved_ns) and moved_ns[index] <= each.at_ns:
            index += 1
        since_ns = each.at_ns - (moved_ns[index - 1] if index else -1_000_000_000)
        if since_ns >= 1_000_000_000:
            still.append(each)
    return still


def _nearest(line: LineMap, front_m: float) -> Station:
    return min(line.stations, key=lambda station: abs(station.stop_m - front_m))


def odometer_error_of(ride: RecordedRide, start_m: float) -> float:
    """Relative error of the odometer: its distance against that of the reported positions.

    Raises SettingsError if they do not belong together.
    """
    last = ride.positions[-1]
    true_m = last.front_m - start_m
    counted_m = next(each.distance_m for each in ride.odometer[::-1] if each.at_ns <= last.at_ns)
    error = counted_m / true_m - 1.0 if true_m > 0.0 else math.inf
    if not abs(error) <= DISTANCE_ERROR_MAX_RATIO:
        raise SettingsError(
            f"{ride.path}: odometer and controller disagree: {counted_m:.1f} m by TACHO, "
            f"{true_m:.1f} m by VOBC_POSITION; name a log of one whole ride"
        )
    return error
