"""What the current loops really are: module, wires and the units that read them."""

from dataclasses import dataclass, field

from plant_emulator.train_config.ranges import Spread, check, check_spread


@dataclass(frozen=True, slots=True)
class LoopConfig:
    """Two loops of 4 to 20 mA, for traction and service brake, from a module on the bus."""

    connected: bool = False
    """The units take their reference from the loops; else from the bus, and there are no loops."""
    traction_full_mps2: float = 1.0
    """Acceleration at 18 mA; the unit weighs its load."""
    brake_full_mps2: float = 1.0
    """Deceleration at 18 mA."""
    offset_ma: Spread = field(default_factory=lambda: Spread(-0.02, 0.02))
    """Of module and unit together; drawn once a run for each loop."""
    gain_ratio: Spread = field(default_factory=lambda: Spread(0.998, 1.002))
    """Current on the wire over the one that was set, drawn likewise."""
    sigma_ma: float = 0.004
    """Scatter of what a unit reads, each time."""
    adc_bits: int = 12
    """Resolution of the unit's converter over 0 to 24 mA."""
    broken_ma: float = 3.6
    """Under this a unit takes its loop for broken."""
    tolerance_mps2: float = 0.2
    """A loop that says more or less than the protected command by more than this is wrong."""
    patience_s: float = 0.3
    """For so long, before the unit no longer trusts it; at the start so long until it does."""
    recovery_s: float = 10.0
    """A loop that was not trusted has to be right for so long."""

    def __post_init__(self) -> None:
        check(self, "traction_full_mps2", 0.1, 3.0)
        check(self, "brake_full_mps2", 0.1, 3.0)
        check_spread(self, "offset_ma", -20.0, 20.0)
        check_spread(self, "gain_ratio", 0.0, 2.0)
        check(self, "sigma_ma", 0.0, 5.0)
        check(self, "adc_bits", 6, 24)
        check(self, "broken_ma", 0.0, 4.0)
        check(self, "tolerance_mps2", 0.0, 10.0)
        check(self, "patience_s", 0.0, 10.0)
        check(self, "recovery_s", 0.0, 3600.0)
