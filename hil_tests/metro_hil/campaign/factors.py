"""The factors of a sweep: levels, ranges, and phases of the control cycle."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from enum import Enum
from typing import Any, Final

from firmware_py import settings
from metro_hil.campaign.problems import Findings, attempt

LEVELS_MAX: Final = 100_000
DIGITS: Final = 12
"""Significant digits of a computed level, so that no level reads 0.30000000000000004."""


class LevelScale(Enum):
    LINEAR = "linear"
    LOG = "log"


class PhaseOf(Enum):
    CYCLE = "cycle"
    """Control cycle of the controller."""


@dataclass(frozen=True, slots=True)
class NumberRange:
    """A range of numbers, both ends included."""

    low: float
    high: float
    scale: LevelScale = LevelScale.LINEAR
    integer: bool = False

    def at(self, share: float) -> float | int:
        """The number at a share in [0, 1) of the range; whole numbers have equal parts."""
        if self.integer:
            return int(self.low) + int(share * (int(self.high) - int(self.low) + 1))
        if self.scale is LevelScale.LOG:
            return rounded(self.low * (self.high / self.low) ** share)
        return rounded(self.low + (self.high - self.low) * share)


@dataclass(frozen=True, slots=True)
class CyclePhase:
    """An instant as level: `base_s` plus a share of the control cycle."""

    base_s: float
    cycle_share: float

    def instant_s(self, cycle_ms: float) -> float:
        return round(self.base_s + self.cycle_share * cycle_ms / 1000.0, 9)


@dataclass(frozen=True, slots=True)
class Factor:
    """One quantity that a sweep varies."""

    key: str
    levels: tuple[Any, ...]
    """The levels; empty for a range without steps, which has a span."""
    span: NumberRange | None = None
    """Range from which a search may choose; None for listed levels."""

    def at(self, share: float) -> Any:
        """The value at a share in [0, 1); levels have equal parts."""
        if self.levels:
            return self.levels[min(int(share * len(self.levels)), len(self.levels) - 1)]
        assert self.span is not None
        return self.span.at(share)

    def searched(self, share: float) -> Any:
        """Like `at`, but from the whole range even if it has levels."""
        return self.at(share) if self.span is None else self.span.at(share)

    @property
    def numeric(self) -> bool:
        return all(
            isinstance(level, int | float) and not isinstance(level, bool) for level in self.levels
        )


@dataclass(frozen=True, slots=True)
class RangeKeys:
    """A table `{ low, high }` with the keys that divide the range into levels."""

    low: float
    high: float
    count: int | None = None
    step: float | None = None
    scale: LevelScale = LevelScale.LINEAR
    integer: bool = False

    def __post_init__(self) -> None:
        if not self.low < self.high:
            raise ValueError(f"high {self.high:g} is not above low {self.low:g}")
        if self.count is not None and self.step is not None:
            raise ValueError(f"step {self.step:g} and count {self.count} exclude each other")
        if self.count is not None and not 2 <= self.count <= LEVELS_MAX:
            raise ValueError(f"count {self.count} is not within 2..{LEVELS_MAX}")
        if self.step is not None and not self.step > 0.0:
            raise ValueError(f"step {self.step:g} is not positive")
        if self.step is not None and (self.high - self.low) / self.step > LEVELS_MAX:
            raise ValueError(f"step {self.step:g} makes more than {LEVELS_MAX} levels")
        if self.scale is LevelScale.LOG and self.low <= 0.0:
            raise ValueError(f"low {self.low:g} is not positive, as scale 'log' needs")
        if self.scale is LevelScale.LOG and self.step is not None:
            raise ValueError(f"step {self.step:g} does not go with scale 'log'; give count")
        if self.integer:
            for name in ("low", "high", "step"):
                value = getattr(self, name)
                if value is not None and not value.is_integer():
                    raise ValueError(f"{name} {value:g} is no whole number")


@dataclass(frozen=True, slots=True)
class PhaseKeys:
    """A table `{ phase_of, count, base }`: an instant at several offsets in the control cycle."""

    phase_of: PhaseOf
    count: int
    base: float = 0.0

    def __post_init__(self) -> None:
        if not 1 <= self.count <= LEVELS_MAX:
            raise ValueError(f"count {self.count} is not within 1..{LEVELS_MAX}")


def read_factors(table: object, findings: Findings) -> tuple[Factor, ...]:
    """Factors of `[sweep.factors]`, in the order of the file."""
    if not isinstance(table, Mapping):
        findings.add("sweep.factors", f"{table!r} is not a table")
        return ()
    read = [_read(key, value, findings) for key, value in table.items()]
    return tuple(factor for factor in read if factor is not None)


def where(key: str) -> str:
    """Name of a factor in messages."""
    return f'sweep.factors."{key}"'


def _read(key: str, value: object, findings: Findings) -> Factor | None:
    if isinstance(value, list):
        return _listed(key, value, findings)
    if not isinstance(value, dict):
        findings.add(where(key), f"{value!r} is neither a list nor {{ low = …, high = … }}")
        return None
    if "phase_of" in value:
        made = attempt(lambda t: _phase_keys(t, key), value, where(key), findings)
        return None if made is None else Factor(key, phases(made))
    keys = attempt(lambda t: _range_keys(t, key), value, where(key), findings)
    if keys is None:
        return None
    integer = keys.integer or all(
        isinstance(value.get(name), int) for name in ("low", "high", "step")
    )
    span = NumberRange(keys.low, keys.high, keys.scale, integer)
    return Factor(key, ladder(keys, integer), span if keys.step is None else None)


def _listed(key: str, levels: list[Any], findings: Findings) -> Factor | None:
    if not levels:
        findings.add(where(key), "[] has no level")
        return None
    doubles = [level for index, level in enumerate(levels) if _among(level, levels[:index])]
    for level in doubles:
        findings.add(where(key), f"{level!r} is listed twice")
    return None if doubles else Factor(key, tuple(levels))


def _among(level: object, others: Sequence[object]) -> bool:
    return any(other == level and type(other) is type(level) for other in others)


def _range_keys(table: dict[str, Any], key: str) -> RangeKeys:
    return settings.build(RangeKeys, table, "", where(key))


def _phase_keys(table: dict[str, Any], key: str) -> PhaseKeys:
    return settings.build(PhaseKeys, table, "", where(key))


def phases(keys: PhaseKeys) -> tuple[CyclePhase, ...]:
    return tuple(CyclePhase(keys.base, index / keys.count) for index in range(keys.count))


def ladder(keys: RangeKeys, integer: bool) -> tuple[float | int, ...]:
    """The levels of a range without rounding noise; none for a range without steps."""
    if keys.step is not None:
        low, step, high = (Decimal(str(value)) for value in (keys.low, keys.step, keys.high))
        # Keep a last step that misses the end only by rounding.
        number = int((high - low) / step + Decimal("1e-9")) + 1
        levels = [float(low + index * step) for index in range(number)]
    elif keys.count is not None:
        span = NumberRange(keys.low, keys.high, keys.scale)
        levels = [float(span.at(index / (keys.count - 1))) for index in range(keys.count)]
    else:
        return ()
    if integer:
        return tuple(dict.fromkeys(round(level) for level in levels))
    return tuple(levels)


def rounded(value: float) -> float:
    if value == 0.0 or not math.isfinite(value):
        return value
    return float(f"{value:.{DIGITS}g}")
