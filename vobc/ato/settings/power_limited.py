"""Settings of the law that drives power-limited running curves."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class PowerLimited:
    """What the law believes of motors and mass, and how it weighs energy against peak power."""

    weight_factor: float = 5.0
    """Of equation (1): 0 saves acceleration energy, 15 and more lowers the peak of regeneration."""
    tare_kg: float = 130000.0
    """Of the empty train; rotating masses and passengers come on top."""
    brake_power_w: float = 2.0e6
    """Most that the electric brake takes at the wheel, all motors together."""
    power_min_w: float = 0.1e6
    """No lower limit is given, however much time there is."""
    traction_power_w: float = 2.4e6
    """At the wheel; gaining speed is planned with it."""
    slowest_mps: float = 8.0
    """No lower notch-off speed is planned."""
    look_s: float = 1.0
    """While coasting, how often the power limit is reckoned anew."""
    spare_ratio: float = 0.94
    """Share of the power limit that the braking point is planned with; the rest corrects."""

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
