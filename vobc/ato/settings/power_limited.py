"""Settings of the law that drives power-limited running curves."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class PowerLimited:
    """Assumed motors and mass of the law, and its weights of energy and peak power."""

    weight_factor: float = 5.0
    """Weight of equation (1). 0 saves acceleration energy; 15 and more lowers the peak of
    regeneration."""
    tare_kg: float = 130000.0
    """Mass of the empty train, without rotating masses and passengers."""
    brake_power_w: float = 2.0e6
    """Greatest power of the electric brake at the wheel, all motors together."""
    power_min_w: float = 0.1e6
    """Lower bound of the power limit, however much time there is."""
    traction_power_w: float = 2.4e6
    """Traction power at the wheel, used to plan acceleration."""
    slowest_mps: float = 8.0
    """Lower bound of the planned notch-off speed."""
    look_s: float = 1.0
    """Interval between updates of the power limit while coasting."""
    spare_ratio: float = 0.94
    """Share of the power limit used to plan the braking point. The rest is for corrections."""

    def __post_init__(self) -> None:
        for name in (
            *("tare_kg", "brake_power_w", "power_min_w", "traction_power_w"),
            *("slowest_mps", "look_s"),
        ):
            if getattr(self, name) <= 0.0:
                raise ValueError(f"{name} {getattr(self, name)} is not positive")
        if not 0.0 <= self.weight_factor <= 1e6:
            raise ValueError(f"weight_factor {self.weight_factor} is not within 0..1e6")
        if self.power_min_w > self.brake_power_w:
            raise ValueError("power_min_w is over brake_power_w")
        if not 0.5 <= self.spare_ratio <= 1.0:
            raise ValueError(f"spare_ratio {self.spare_ratio} is not within 0.5..1")
