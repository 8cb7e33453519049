"""The output stage of the automatic operation: how a demand reaches the train."""

from dataclasses import dataclass
from typing import Final

STAGES: Final = ("continuous", "notches", "current_loop")
LOOP_BITS_MIN: Final = 8
LOOP_BITS_MAX: Final = 24


@dataclass(frozen=True, slots=True)
class OutputStage:
    """Kind of the output stage, and its levels. Laws that pick notches use the same levels."""

    stage: str = "continuous"
    """One of: continuous, notches, current_loop."""
    traction_levels_mps2: tuple[float, ...] = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
    """Acceleration of each traction notch on level track, in rising order."""
    brake_levels_mps2: tuple[float, ...] = (
        *(0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4),
        *(0.45, 0.5, 0.55, 0.6, 0.65, 0.7, 0.75, 0.8),
    )
    """Deceleration of each brake notch on level track, in rising order."""
    hysteresis_ratio: float = 0.4
    """Hysteresis of a notch change, as a share of the step between two notches. For brakes it
    counts from the middle between them, for traction from the notch itself."""
    dwell_s: float = 0.7
    """Shortest time between notch changes. A large change does not wait, and a light brake waits
    less."""
    loop_bits: int = 12
    """Resolution of the converter for the current loops, over 0 to 20 mA."""
    loop_traction_full_mps2: float = 1.0
    """Acceleration at full current of the traction loop."""
    loop_brake_full_mps2: float = 1.0
    """Deceleration at full current of the brake loop."""

    def __post_init__(self) -> None:
        if self.stage not in STAGES:
            raise ValueError(f"stage {self.stage} is none of {', '.join(STAGES)}")
        for name, levels_mps2 in (
            ("traction_levels_mps2", self.traction_levels_mps2),
            ("brake_levels_mps2", self.brake_levels_mps2),
        ):
            if not levels_mps2 or levels_mps2[0] <= 0.0:
                raise ValueError(f"{name} is empty or begins with a level that is not positive")
            if list(levels_mps2) != sorted(set(levels_mps2)):
                raise ValueError(f"{name} {list(levels_mps2)} do not rise")
        if not 0.0 <= self.hysteresis_ratio < 1.0 or self.dwell_s < 0.0:
            raise ValueError("hysteresis_ratio is not in 0..1, or dwell_s is negative")
        if not LOOP_BITS_MIN <= self.loop_bits <= LOOP_BITS_MAX:
            raise ValueError(
                f"loop_bits {self.loop_bits} is not in {LOOP_BITS_MIN}..{LOOP_BITS_MAX}"
            )
        if self.loop_traction_full_mps2 <= 0.0 or self.loop_brake_full_mps2 <= 0.0:
            raise ValueError("loop_traction_full_mps2 or loop_brake_full_mps2 is not positive")
