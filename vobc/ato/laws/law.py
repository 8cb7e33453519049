"""Interface of every control law of the automatic operation."""

from dataclasses import dataclass
from typing import Protocol

from vobc.vocabulary import AtoInput, BrakeFinding


@dataclass(frozen=True, slots=True)
class Target:
    """Next place where the front should come to a stand."""

    at_m: float
    at_station: bool
    """True for a stop at a station, false for one before the end of authority."""
    due_ns: int | None = None
    """Arrival by the timetable."""


@dataclass(frozen=True, slots=True)
class Drive:
    """Output of a law while the train drives."""

    accel_mps2: float
    """Demand, before the limits of acceleration and jerk are applied."""
    reference_mps: float
    braking: bool
    """The train brakes towards the target, with nothing else before the stop."""
    pulls: bool = False
    """Uphill gravity brakes, and traction leads the train into its stop."""
    weak_mps2: float = 0.0
    """Brake demand beyond the comfort limit with which a weak brake still reaches that limit."""
    brake_finding: BrakeFinding | None = None
    """Set as long as the brake acts later or weaker than the law expects."""


class Strategy(Protocol):
    """One control law.

    It receives the demand that was actually sent in each cycle, for its predictions.
    """

    @property
    def speed_mps(self) -> float:
        """Estimated speed."""

    def observe(self, inputs: AtoInput, cycles: int) -> None:
        """Process the inputs.

        This is the first call of every cycle, driving or not. `cycles` includes missed ones.
        """

    def rest(self) -> None:
        """The train stands and is held: reset the motion."""

    def set_off(self, inputs: AtoInput, demand_mps2: float) -> None:
        """Driving begins, from standstill or on taking over a moving train."""

    def drive(self, inputs: AtoInput, target: Target) -> Drive:
        """Demand of this cycle."""

    def issued(self, demand_mps2: float) -> None:
        """Note the demand that is sent in this cycle."""
