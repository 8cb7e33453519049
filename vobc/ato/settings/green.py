"""Settings of the law of Green CBTC: its weights, and what it takes the supply to be."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Green:
    """Weights and supply arm of seed 000, equations (8) to (12); the literal readings are off."""

    alpha_ratio: float = 0.786
    """Weight of the timing target speed; with the other one it makes 1."""
    beta_ratio: float = 0.214
    """Weight of the energy-saving target speed."""
    standard_v: float = 750.0
    """U_s. Nearly all voltages of a running line lie above it, so it acts as a bias."""
    standard_a: float = 0.0
    """I_s: 0 is a reference without load."""
    feed_factor: float = 4.0
    """p: 4 for bilateral, 2 for unilateral feed."""
    arm_ohm: float = 0.04
    """L * r of feeder and return."""
    train_count_factor: float = 2.0
    """m, trains in the arm."""
    exponent_factor: float = 1.0
    """q. Printed is 2 for unilateral feed, which a ladder of resistors shows 12 to 20 % high."""
    horizon_s: float = 1.0
    """What makes an energy of the power in (9); printed is nothing, which is 1 s."""
    constant_v: float = 0.0
    """Over 0: the law is shown this voltage instead of the true one, to see what it is worth."""
    tare_kg: float = 136000.0
    """Of the empty train; rotating masses and passengers come on top."""
    literal_time: bool = False
    """(7) as printed: the time of gaining speed is left out."""
    literal_target: bool = False
    """(12) as printed: V_energy at or over V_top gives V_top, whatever its weight."""

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
