"""The keys of a campaign file, their types and ranges."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from typing import Any, Final

from can_dbc.cab import CabMode
from firmware_py.expression import ExpressionError, compile_expression
from firmware_py.settings import nearest
from metro_hil.model.case import TIME_MAX_S, BenchKind, ControllerSpec, PlantSpec
from metro_hil.model.service import TRAINS_MAX
from plant_emulator.desk.drivers import DRIVERS
from plant_emulator.truth import SIGNALS

SEED_MAX: Final = 2**63 - 1
SEEDS_MAX: Final = 10_000_000
DURATION_MAX_S: Final = 86_400.0
LEASE_RANGE_S: Final = (0.01, 3600.0)
STRENGTH_MAX: Final = 6
POINTS_MAX: Final = 1_000_000
POOL_MAX: Final = 1000

NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
CONTROL: Final = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")
"""Control characters, except tabs and line feeds."""
REQUIREMENT: Final = re.compile(r"[A-Z][A-Z0-9]*(?:-[A-Za-z0-9]+)+")

TABLES: Final = ("train", "timetable", "controller", "plant", "branch", "sweep", "each")
ARRAYS: Final = ("fault", "monitor", "scenario")
SWEPT: Final = ("train", "timetable", "controller", "plant", "branch", "fault", "monitor")
"""Tables that a sweep may change."""
OVERRIDES: Final = ("real", "believed")
"""Tables of dotted keys below `train`."""


def in_range(owner: object, name: str, low: float, high: float) -> None:
    """Raises ValueError that names key and value; None stands for the default and is accepted."""
    value = getattr(owner, name)
    if value is not None and not low <= value <= high:
        raise ValueError(f"{name} {value!r} is not within {low:g}..{high:g}")


def needs_owner(keys: "ControllerKeys | PlantKeys", name: str, kind: Enum) -> None:
    """Raises ValueError if the key is given with another kind, or missing with its own."""
    value = getattr(keys, name)
    if value and keys.kind is not kind:
        raise ValueError(f"{name} {value!r} belongs to kind {kind.value!r}")
    if not value and keys.kind is kind:
        raise ValueError(f"kind {kind.value!r} needs {name}")


def fits(owner: object, name: str, pattern: re.Pattern[str], what: str) -> None:
    value = getattr(owner, name)
    if value is not None and not pattern.fullmatch(value):
        raise ValueError(f"{name} {value!r} is no {what}")


@dataclass(frozen=True, slots=True)
class HeadKeys:
    """Keys above all tables. Keys with more than one form, such as `seeds`, are read elsewhere."""

    name: str = "campaign"
    """Placeholder: a file without a name is named by its stem."""
    title: str = ""
    description: str = ""
    requirements: tuple[str, ...] = ()
    bench: BenchKind = BenchKind.LOCKSTEP
    seed_base: int = 1
    stop_at_violation: bool = True
    idle_counts: bool = False
    layout: str | None = None

    def __post_init__(self) -> None:
        if "\n" in self.title:
            raise ValueError(f"title {self.title!r} is more than one line")
        fits(self, "name", NAME, "name for a folder: letters, digits, '-', '_', '.'; 64 at most")
        in_range(self, "seed_base", 0, SEED_MAX - SEEDS_MAX)
        fits(self, "layout", NAME, "name of a table")
        for requirement in self.requirements:
            if not REQUIREMENT.fullmatch(requirement):
                raise ValueError(f"requirements {requirement!r} is no id such as INV-04")


HEAD: Final = (*HeadKeys.__dataclass_fields__, "seeds", "invariants", "expected", "vacuous")
CAMPAIGN_ONLY: Final = ("layout", "scenario")


@dataclass(frozen=True, slots=True)
class TrainKeys:
    """`[train]` without its overrides. These defaults are placeholders; those of Setup apply."""

    line: str = ""
    start: str | None = None
    end: str | None = None
    consist: str = ""
    params: str = ""
    load_ratio: float | None = None
    odometer_error: float | None = None
    cycle_ms: float | None = None
    duration_s: float | None = None
    desk_mode: CabMode = CabMode.AUTO
    driver: str | None = None
    desk_recording: str | None = None
    wakes_up: bool = False
    memory_line: str | None = None
    service: str | None = None
    trains: int | None = None
    masters: bool = False
    cut_master_at_s: float | None = None
    kill_master_at_s: float | None = None
    supply: str | None = None

    def __post_init__(self) -> None:
        in_range(self, "load_ratio", 0.0, 1.0)
        in_range(self, "odometer_error", -0.2, 0.2)
        in_range(self, "cycle_ms", 5.0, 200.0)
        in_range(self, "duration_s", 0.1, DURATION_MAX_S)
        if self.driver is not None and self.driver not in DRIVERS:
            raise ValueError(f"driver {self.driver!r}: {nearest(self.driver, list(DRIVERS))}")
        if self.driver is not None and self.desk_recording is not None:
            raise ValueError(
                f"desk_recording {self.desk_recording!r} excludes driver {self.driver!r}"
            )
        if self.memory_line is not None and not self.wakes_up:
            raise ValueError(f"memory_line {self.memory_line!r} needs wakes_up = true")
        in_range(self, "trains", 1, TRAINS_MAX)
        if self.trains is not None and self.service is None:
            raise ValueError(f"trains {self.trains} needs service, whose trips the trains make")
        if self.masters and self.service is None:
            raise ValueError("masters true needs service, whose trains command themselves")
        self._check_strikes()
        if self.supply is not None and self.service is None:
            raise ValueError(f"supply {self.supply!r} needs service, whose trains it feeds")
        if self.service is not None:
            given = [name for name in ("start", "end") if getattr(self, name) is not None]
            given += ["wakes_up"] if self.wakes_up else []
            if given:
                raise ValueError(f"{given[0]} is decided by service {self.service!r}; leave it out")

    def _check_strikes(self) -> None:
        strikes = ("cut_master_at_s", "kill_master_at_s")
        given = [name for name in strikes if getattr(self, name) is not None]
        for name in given:
            in_range(self, name, 0.0, DURATION_MAX_S)
            if not self.masters:
                raise ValueError(f"{name} {getattr(self, name):g} needs masters = true")
        if len(given) > 1:
            raise ValueError(f"{given[1]} {getattr(self, given[1]):g} excludes {given[0]}")


TRAIN: Final = (*TrainKeys.__dataclass_fields__, *OVERRIDES)


@dataclass(frozen=True, slots=True)
class TimetableKeys:
    stops: tuple[str, ...] | None = None
    dwell_s: dict[str, float] | None = None
    run_s: dict[str, float] | None = None
    """Planned running times by the station at which they end, s."""

    def __post_init__(self) -> None:
        if self.stops == ():
            raise ValueError("stops [] names no station; leave it out to stop at every station")
        for key, times_s in (("dwell_s", self.dwell_s), ("run_s", self.run_s)):
            for station, time_s in (times_s or {}).items():
                if not 0.0 <= time_s <= TIME_MAX_S:
                    raise ValueError(
                        f"{key} {station} = {time_s:g} is not within 0..{TIME_MAX_S:g}"
                    )


class ControllerKind(Enum):
    SHIPPED = "shipped"
    CHECKOUT = "checkout"
    COMMAND = "command"


@dataclass(frozen=True, slots=True)
class ControllerKeys:
    kind: ControllerKind = ControllerKind.SHIPPED
    path: str = ""
    command: str = ""
    lease_s: float = ControllerSpec().lease_s

    def __post_init__(self) -> None:
        in_range(self, "lease_s", *LEASE_RANGE_S)
        needs_owner(self, "path", ControllerKind.CHECKOUT)
        needs_owner(self, "command", ControllerKind.COMMAND)


class PlantKind(Enum):
    SHIPPED = "shipped"
    COMMAND = "command"
    FMU = "fmu"
    NODES = "nodes"


@dataclass(frozen=True, slots=True)
class PlantKeys:
    kind: PlantKind = PlantKind.SHIPPED
    command: str = ""
    mapping: str = ""
    nodes: str = ""
    lease_s: float = PlantSpec().lease_s

    def __post_init__(self) -> None:
        in_range(self, "lease_s", *LEASE_RANGE_S)
        needs_owner(self, "command", PlantKind.COMMAND)
        needs_owner(self, "mapping", PlantKind.FMU)
        needs_owner(self, "nodes", PlantKind.NODES)


@dataclass(frozen=True, slots=True)
class BranchKeys:
    seed: int
    when: str

    def __post_init__(self) -> None:
        in_range(self, "seed", 0, SEED_MAX)
        try:
            compile_expression(self.when, SIGNALS)
        except ExpressionError as error:
            raise ValueError(f"when {error}") from error


class DesignKind(Enum):
    FACTORIAL = "factorial"
    """Every combination of all levels."""
    PAIRWISE = "pairwise"
    """Every combination of two levels of two factors at least once."""
    COVERING = "covering"
    """Every combination of levels of `strength` factors at least once."""
    LHS = "lhs"
    """Latin hypercube: each factor's range in `count` strata, each used once."""
    SOBOL = "sobol"
    """Scrambled Sobol sequence."""
    RANDOM = "random"
    DRAWN = "drawn"
    """Every seed is a case of its own, sampled entirely from the seed."""


SAMPLED: Final = (DesignKind.LHS, DesignKind.SOBOL, DesignKind.RANDOM)
"""Designs that sample `count` points, and so accept factors without levels."""


@dataclass(frozen=True, slots=True)
class SweepKeys:
    """`[sweep]` without its factors."""

    design: DesignKind = DesignKind.FACTORIAL
    strength: int | None = None
    """Number of factors of which a covering design combines all levels; default 2."""
    count: int | None = None
    """Number of points of a sampled design."""
    seed: int = 1
    """Seed of a sampled design, independent of the seeds of the runs."""
    new_seeds: bool = False
    """Whether each point has its own seeds; otherwise all points share them."""
    exclude: tuple[str, ...] = ()
    faults_min: int | None = None
    """Least number of pool faults in each case of design `drawn`; default 0."""
    faults_max: int | None = None
    """Greatest number of pool faults in each case of design `drawn`; default 1."""

    def __post_init__(self) -> None:
        in_range(self, "strength", 1, STRENGTH_MAX)
        in_range(self, "count", 1, POINTS_MAX)
        in_range(self, "seed", 0, SEED_MAX)
        if self.design in SAMPLED and self.count is None:
            raise ValueError(f"design {self.design.value!r} needs count")
        if self.design not in SAMPLED and self.count is not None:
            raise ValueError(f"count {self.count} is for lhs, sobol and random alone")
        in_range(self, "faults_min", 0, POOL_MAX)
        in_range(self, "faults_max", 0, POOL_MAX)
        for name in ("faults_min", "faults_max"):
            value = getattr(self, name)
            if self.design is not DesignKind.DRAWN and value is not None:
                raise ValueError(f"{name} {value} is for design drawn alone")
        if self.design is DesignKind.DRAWN and self.exclude:
            raise ValueError(f"exclude {list(self.exclude)} is not for design drawn")
        if self.design is not DesignKind.COVERING and self.strength is not None:
            raise ValueError(f"strength {self.strength} is for design covering alone")


POOL: Final = ("fault", "window")
"""Tables of design `drawn`: the pool of faults, and keys that their windows share."""
SWEEP: Final = (*SweepKeys.__dataclass_fields__, "factors", *POOL)


def unfit(value: Any, key: str = "") -> Iterator[tuple[str, str]]:
    """Keys and reasons of TOML values that cannot be part of a case."""
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from unfit(inner, f"{key}.{name}")
    elif isinstance(value, list):
        for number, inner in enumerate(value):
            yield from unfit(inner, f"{key}[{number}]")
    elif (why := _unfit_alone(value)) is not None:
        yield key, why


def _unfit_alone(value: Any) -> str | None:
    if isinstance(value, float):
        return None if abs(value) < float("inf") else f"{value} is not a finite number"
    if isinstance(value, int):
        return None if abs(value) <= SEED_MAX else f"{value} is too large"
    if not isinstance(value, str):
        return f"{value} is neither number, text nor true or false"
    # Names and reasons are printed, so control characters would reach the terminal.
    return f"{value!r} holds control characters" if CONTROL.search(value) else None
