"""Settings of the Green CBTC law: its weights and its assumed power supply."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Green:
    """Weights and supply section of [Lin], equations (8) to (12). The literal variants are off."""

    alpha_ratio: float = 0.786
    """Weight of the timing target speed. Both weights add up to 1."""
    beta_ratio: float = 0.214
    """Weight of the energy-saving target speed."""
    standard_v: float = 750.0
    """U_s. Nearly all voltages of a line in service are above it, so it acts as a bias."""
    standard_a: float = 0.0
    """I_s. 0 means a reference without load."""
    feed_factor: float = 4.0
    """p: 4 for bilateral feed, 2 for unilateral feed."""
    arm_ohm: float = 0.04
    """L * r of feeder and return."""
    train_count_factor: float = 2.0
    """m, number of trains in the section."""
    exponent_factor: float = 1.0
    """q. [Lin] prints 2 for unilateral feed, which is 12 to 20 % too high compared with a resistor
    ladder."""
    horizon_s: float = 1.0
    """Time that turns the power in (9) into an energy. [Lin] prints none, which means 1 s."""
    constant_v: float = 0.0
    """Above 0, the law uses this voltage instead of the measured one. This shows what the
    measurement is worth."""
    tare_kg: float = 136000.0
    """Mass of the empty train, without rotating masses and passengers."""
    literal_time: bool = False
    """(7) as printed, without the time of gaining speed."""
    literal_target: bool = False
    """(12) as printed: V_energy at or above V_top gives V_top, whatever its weight."""

    def __post_init__(self) -> None:
        for name in (
            *("standard_v", "feed_factor", "arm_ohm", "train_count_factor", "horizon_s"),
            *("tare_kg", "exponent_factor"),
        ):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} {getattr(self, name)} is not positive")
        if not (0.0 <= self.beta_ratio <= 1.0 and 0.0 <= self.alpha_ratio <= 1.0):
            raise ValueError("alpha_ratio or beta_ratio is not within 0..1")
        if abs(self.alpha_ratio + self.beta_ratio - 1.0) > 1e-9:
            raise ValueError(
                f"alpha_ratio {self.alpha_ratio} and beta_ratio {self.beta_ratio} do not make 1"
            )
        if self.constant_v < 0.0:
            raise ValueError(f"constant_v {self.constant_v} is negative")
