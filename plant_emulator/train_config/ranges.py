"""Ranges: quantities that vary over a range, and range checks of values."""

from dataclasses import dataclass, fields
from typing import Protocol

from firmware_py.settings import check_ranges


class UniformSource(Protocol):
    """A generator of numbers in [0, 1), such as numpy's."""

    def random(self) -> float: ...


@dataclass(frozen=True, slots=True)
class Spread:
    """A quantity distributed uniformly over [low, high]; equal ends make it fixed."""

    low: float
    high: float

    def __post_init__(self) -> None:
        if not self.low <= self.high:
            raise ValueError(f"low {self.low} is not at or under high {self.high}")

    def draw(self, generator: UniformSource) -> float:
        return self.low + (self.high - self.low) * generator.random()


def check(owner: object, name: str, least: float, most: float) -> None:
    """Raise ValueError unless the field lies within the range; NaN never does."""
    check_ranges(owner, {name: (least, most)})


def check_spread(owner: object, name: str, least: float, most: float) -> None:
    spread = getattr(owner, name)
    for end in fields(spread):
        value = getattr(spread, end.name)
        if not least <= value <= most:
            raise ValueError(f"{name}.{end.name} {value} is not in {least:g}..{most:g}")
