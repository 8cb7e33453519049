"""Settings of the law that runs to a timetable."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Timing:
    """The Green CBTC speed control for one train; its guards and braking."""

    start_up_mps: float = 5.0 / 3.6
    """V_cfg: faster than this a train that set off is in automatic operation."""
    slowed_mps: float = 3.0 / 3.6
    """Slower than this a train in automatic operation starts up anew."""
    parking_m: float = 50.0
    """Least S_cfg: within so much of the stopping point the train parks."""
    parking_spare_m: float = 10.0
    """S_cfg is not less than the way of the service brake and this."""
    decel_mps2: float = 0.75
    """b of V_top, before gravity."""
    look_s: float = 1.0
    """How often the timing target speed is reckoned anew."""
    least_mps: float = 5.0
    """No lower target speed is given, however much time there is."""

    def __post_init__(self) -> None:
        if not 0.0 < self.slowed_mps < self.start_up_mps:
            raise ValueError("not 0 < slowed_mps < start_up_mps")
        for name in ("parking_m", "decel_mps2", "look_s", "least_mps"):
            if getattr(self, name) <= 0.0:
                raise ValueError(f"{name} {getattr(self, name)} is not positive")
        if self.parking_spare_m < 0.0:
            raise ValueError(f"parking_spare_m {self.parking_spare_m} is negative")
