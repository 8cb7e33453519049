"""What every control law of the automatic operation offers."""

from dataclasses import dataclass
from typing import Protocol

from vobc.vocabulary import AtoInput


@dataclass(frozen=True, slots=True)
class Target:
    """Where the front shall come to a stand next."""

    at_m: float
    at_station: bool
    """Otherwise before the end of authority."""
    due_ns: int | None = None
    """When the train shall stand there by its timetable."""


@dataclass(frozen=True, slots=True)
class Drive:
    """A strategy's answer while the train drives."""

    accel_mps2: float
    """Wanted demand; limits of acceleration and jerk are applied to it afterwards."""
    reference_mps: float
    braking: bool
    """Braking towards the target, with nothing but the stop to come."""


class Strategy(Protocol):
    """One control law. It is told what really left after each cycle, so that it can predict."""

    @property
    def speed_mps(self) -> float:
        """The speed it believes in."""

    def observe(self, seen: AtoInput, cycles: int) -> None:
        """Called first in every cycle, driving or not; `cycles` counts missed ones in."""

    def rest(self) -> None:
        """The train stands and is held; forget its motion."""

    def set_off(self, seen: AtoInput, demand_mps2: float) -> None:
        """Driving begins, from standstill or on taking over a moving train."""

    def drive(self, seen: AtoInput, target: Target) -> Drive:
        """What to ask for now."""

    def issued(self, demand_mps2: float) -> None:
        """The demand that leaves in this cycle."""
