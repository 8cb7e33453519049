"""True properties of the current loops: module, wires and the units that read them."""

from dataclasses import dataclass, field

from plant_emulator.train_config.ranges import Spread, check, check_spread


@dataclass(frozen=True, slots=True)
class LoopConfig:
    """Two loops of 4 to 20 mA, for traction and service brake, from a module on the bus."""

    connected: bool = False
    """The units take their reference from the loops; if False there are no loops and it comes from
    the bus."""
    traction_full_mps2: float = 1.0
    """Acceleration at 18 mA, whatever the load."""
    brake_full_mps2: float = 1.0
    """Deceleration at 18 mA."""
    offset_ma: Spread = field(default_factory=lambda: Spread(-0.02, 0.02))
    """Offset of module and unit together, sampled once a run for each loop."""
    gain_ratio: Spread = field(default_factory=lambda: Spread(0.998, 1.002))
    """Current on the wire divided by the set current, sampled once a run for each loop."""
    sigma_ma: float = 0.004
    """Standard deviation of each reading."""
    adc_bits: int = 12
    """Resolution of the unit's converter over 0 to 24 mA."""
    broken_ma: float = 3.6
    """Current below which a unit assumes a broken loop."""
    tolerance_mps2: float = 0.2
    """Largest difference between loop and protected command that a unit accepts."""
    patience_s: float = 0.3
    """Time after which a unit distrusts a wrong loop; at the start, time until it trusts a correct
    one."""
    recovery_s: float = 10.0
    """Time for which a distrusted loop must be correct before the unit trusts it again."""

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
