"""Settings of the law that runs to a timetable."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Timing:
    """Green CBTC speed control for one train: guards and braking."""

    start_up_mps: float = 5.0 / 3.6
    """V_cfg: speed above which a departing train is in automatic operation."""
    slowed_mps: float = 3.0 / 3.6
    """Speed below which a train in automatic operation starts up again."""
    parking_m: float = 50.0
    """Least S_cfg: distance to the stopping point within which the train parks."""
    parking_spare_m: float = 10.0
    """S_cfg is at least the service-braking distance plus this."""
    decel_mps2: float = 0.75
    """b of V_top, without gravity."""
    look_s: float = 1.0
    """Interval between updates of the timing target speed."""
    least_mps: float = 5.0
    """Lower bound of the target speed, however much time there is."""

    def __post_init__(self) -> None:
        if not 0.0 < self.slowed_mps < self.start_up_mps:
            raise ValueError("not 0 < slowed_mps < start_up_mps")
        for name in ("parking_m", "decel_mps2", "look_s", "least_mps"):
            if getattr(self, name) <= 0.0:
                raise ValueError(f"{name} {getattr(self, name)} is not positive")
        if self.parking_spare_m < 0.0:
            raise ValueError(f"parking_spare_m {self.parking_spare_m} is negative")
