"""The output stage of the automatic operation: how a demand reaches the train."""

from dataclasses import dataclass
from typing import Final

STAGES: Final = ("continuous", "notches", "current_loop")


@dataclass(frozen=True, slots=True)
class OutputStage:
    """Levels are those of the master controller; a law that picks notches picks from them, too."""

    stage: str = "continuous"
    """continuous, notches or current_loop."""
    traction_levels_mps2: tuple[float, ...] = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
    """Acceleration of each traction notch on the level, rising."""
    brake_levels_mps2: tuple[float, ...] = (
        *(0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4),
        *(0.45, 0.5, 0.55, 0.6, 0.65, 0.7, 0.75, 0.8),
    )
    """Deceleration of each brake notch on the level, rising."""

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
