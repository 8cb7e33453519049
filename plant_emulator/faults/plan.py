"""A fault of a scenario: kind, parameters, window and seed; and how it is read from a file."""

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from firmware_py import settings
from firmware_py.expression import Expression, ExpressionError, compile_expression
from firmware_py.settings import SettingsError
from plant_emulator.faults import declared  # noqa: F401  # enters all kinds into the catalogue
from plant_emulator.faults.kinds import CATALOGUE, Kind
from plant_emulator.truth import REPORTED, SIGNALS

FAULT_SPAWN_KEY: Final = 0xFA
"""Separates the random numbers of faults from those of the plant's own noise."""


@dataclass(frozen=True, slots=True)
class FaultWindow:
    """The time window of a fault.

    The fault begins at the first step at or after `start_s` at which `when` holds. It ends at the
    first step after that at which `end_s` or `duration_s` is reached or `until` holds. With
    `repeat` it may begin again. Conditions are expressions over the plant's truth
    (`plant_emulator.truth.SIGNALS`) and over what the controller reports (`REPORTED`).
    """

    start_s: float = 0.0
    end_s: float | None = None
    duration_s: float | None = None
    """Duration from the begin of the fault."""
    when: str = ""
    until: str = ""
    repeat: bool = False

    def __post_init__(self) -> None:
        if not 0.0 <= self.start_s <= 1.0e6:
            raise ValueError(f"start_s {self.start_s:g} is not within 0..1e6")
        if self.end_s is not None and not self.end_s > self.start_s:
            raise ValueError(f"end_s {self.end_s:g} is not after start_s {self.start_s:g}")
        if self.duration_s is not None and not self.duration_s > 0.0:
            raise ValueError(f"duration_s {self.duration_s:g} is not positive")
        for key in ("when", "until"):
            text = getattr(self, key)
            if text:
                try:
                    _compiled(text)
                except ExpressionError as error:
                    raise ValueError(f"{key} {error}") from error

    def begins(self) -> Expression | None:
        return _compiled(self.when) if self.when else None

    def ends(self) -> Expression | None:
        return _compiled(self.until) if self.until else None

    @property
    def reads_controller(self) -> bool:
        """A condition depends on what the controller reports."""
        conditions = (self.begins(), self.ends())
        return any(each is not None and not each.names.isdisjoint(REPORTED) for each in conditions)


def _compiled(text: str) -> Expression:
    return compile_expression(text, (*SIGNALS, *REPORTED), REPORTED)


SERVICE_KEYS: Final = ("train", "trip")
WINDOW_KEYS: Final = ("start_s", "end_s", "duration_s", "when", "until", "repeat")


@dataclass(frozen=True, slots=True)
class FaultPlan:
    """One fault of a scenario."""

    index: int
    """Index in the scenario; part of the fault's seed."""
    kind: Kind
    parameters: Any
    """An instance of `kind.parameters`."""
    window: FaultWindow
    seed: int | None = None
    """Seed of this fault alone; None takes the run's seed."""
    train: int | None = None
    """Number of the train, from 1; None for every train."""
    trip: int | None = None
    """Number of the trip of a service, from 1; None for every trip."""

    def acts_in(self, *, train: int, trip: int) -> bool:
        """Whether the fault may act on a train in one of its trips."""
        return self.train in (None, train) and self.trip in (None, trip)

    def generator(self, run_seed: int) -> np.random.Generator:
        """Return the generator of this fault alone, so that other faults do not affect it."""
        seed = run_seed if self.seed is None else self.seed
        sequence = np.random.SeedSequence(seed, spawn_key=(FAULT_SPAWN_KEY, self.index))
        return np.random.Generator(np.random.PCG64(sequence))


def read_faults(tables: Sequence[Mapping[str, Any]], source: str) -> tuple[FaultPlan, ...]:
    """Read the `[[fault]]` tables of a scenario.

    Raises SettingsError with source, key and value.
    """
    return tuple(read_fault(table, index, source) for index, table in enumerate(tables))


def read_fault(table: Mapping[str, Any], index: int, source: str) -> FaultPlan:
    """Read one table: `kind`, the keys of FaultWindow, SERVICE_KEYS, `seed`, and the parameters of
    the kind.
    """
    where = f"fault[{index}]"
    name = table.get("kind")
    if not isinstance(name, str) or name not in CATALOGUE:
        close = difflib.get_close_matches(str(name), CATALOGUE, n=1)
        hint = f"nearest valid kind: {close[0]}" if close else f"kinds: {', '.join(CATALOGUE)}"
        what = "missing key" if name is None else f"{name!r}: unknown kind"
        raise SettingsError(f"{source}: {where}.kind: {what}; {hint}")
    kind = CATALOGUE[name]
    seed = _whole(table, "seed", 0, f"{source}: {where}")
    window = {key: value for key, value in table.items() if key in WINDOW_KEYS}
    rest = {
        key: value
        for key, value in table.items()
        if key not in (*WINDOW_KEYS, *SERVICE_KEYS, "kind", "seed")
    }
    return FaultPlan(
        index=index,
        kind=kind,
        parameters=settings.build(kind.parameters, rest, source, where),
        window=settings.build(FaultWindow, window, source, where),
        seed=seed,
        train=_whole(table, "train", 1, f"{source}: {where}"),
        trip=_whole(table, "trip", 1, f"{source}: {where}"),
    )


def _whole(table: Mapping[str, Any], key: str, least: int, where: str) -> int | None:
    value = table.get(key)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int) or value < least:
        raise SettingsError(f"{where}.{key}: {value!r} is not a whole number of {least} or more")
    return value
