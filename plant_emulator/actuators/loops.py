"""Source of the reference of traction and service brake: the bus, or current loops of 4 to 20 mA.

With loops, a module on the bus sets the currents that the controller commands, and each unit reads
its own. The protected commands stay in force for everything but the amount: emergency and holding
brake, permission and direction of traction. A unit compares its loop with the amount in the
protected command. If they disagree, the unit reports not ready: the brake then gives the stronger
of both, and traction gives nothing.
"""

from typing import Final

from can_dbc.analogue import AnalogueCommand
from plant_emulator.actuators.response import NS_PER_S, CommandWatch
from plant_emulator.noise import Gaussian, Generators, NoiseSource
from plant_emulator.train_config import LoopConfig

LIVE_ZERO_MA: Final = 4.0
FULL_MA: Final = 18.0
OVER_MA: Final = 20.0
"""Above this current the brake is fully applied and traction is cut."""
CONVERTER_MA: Final = 24.0
"""Range of the unit's analogue-to-digital converter."""


def effort_ratio(read_ma: float, *, over_ratio: float) -> float:
    """Convert a current into a share of full effort.

    Args:
        over_ratio: effort for a current above the range.
    """
    if read_ma > OVER_MA:
        return over_ratio
    if read_ma >= FULL_MA:
        return 1.0
    return (read_ma - LIVE_ZERO_MA) / (FULL_MA - LIVE_ZERO_MA) if read_ma >= LIVE_ZERO_MA else 0.0


class Loop:
    """One pair of wires, from the module's output to the unit's reading."""

    __slots__ = (
        "_config",
        "_fault_ma",
        "_full_mps2",
        "_gain",
        "_noise",
        "_offset_ma",
        "_over_ratio",
        "_short_ma",
        "_since_ns",
        "_step_ma",
        "_waits_ns",
        "broken",
        "read_ma",
        "reference_mps2",
        "trusted",
    )

    def __init__(
        self,
        config: LoopConfig,
        *,
        full_mps2: float,
        over_ratio: float,
        offset_ma: float,
        gain_ratio: float,
        noise: Gaussian,
    ) -> None:
        self._config = config
        self._full_mps2, self._over_ratio = full_mps2, over_ratio
        self._offset_ma, self._gain, self._noise = offset_ma, gain_ratio, noise
        self._step_ma = CONVERTER_MA / ((1 << config.adc_bits) - 1)
        self.broken = False
        """A fault: the wire carries no current."""
        self._short_ma: float | None = None
        self._fault_ma = 0.0
        self.read_ma = 0.0
        self.reference_mps2 = 0.0
        """Reference that the unit derives from the current."""
        self.trusted = False
        self._since_ns: int | None = None
        """Instant from which the loop has looked different from `trusted`; None while both
        agree."""
        self._waits_ns = round(config.patience_s * NS_PER_S)
        """Time after which the unit accepts such a change."""

    def disturb(self, *, offset_ma: float, short_ma: float | None, broken: bool) -> None:
        """Set the faults.

        A broken wire carries no current; a shorted one carries the current of its supply.
        """
        self._fault_ma, self._short_ma, self.broken = offset_ma, short_ma, broken

    def step(self, set_ma: float | None, said_mps2: float, now_ns: int) -> None:
        """Read the loop once.

        Args:
            set_ma: current that the module sets; None while it receives no command.
            said_mps2: the amount in the protected command.
        """
        self.read_ma = read_ma = self._converted(self._wire_ma(set_ma) + self._noise.draw())
        full_mps2 = self._full_mps2
        self.reference_mps2 = full_mps2 * effort_ratio(read_ma, over_ratio=self._over_ratio)
        off_mps2 = abs(self.reference_mps2 - min(said_mps2, full_mps2))
        sound = self._config.broken_ma <= read_ma <= OVER_MA
        self._judge(sound and off_mps2 <= self._config.tolerance_mps2, now_ns)

    def _wire_ma(self, set_ma: float | None) -> float:
        if self.broken:
            return 0.0
        if self._short_ma is not None:
            return self._short_ma
        if set_ma is None:
            return 0.0
        return set_ma * self._gain + self._offset_ma + self._fault_ma

    def _converted(self, exact_ma: float) -> float:
        count = round(min(CONVERTER_MA, max(0.0, exact_ma)) / self._step_ma)
        return count * self._step_ma

    def _judge(self, right: bool, now_ns: int) -> None:
        if right is self.trusted:
            self._since_ns = None
        elif self._since_ns is None:
            self._since_ns = now_ns
        elif now_ns - self._since_ns >= self._waits_ns:
            self.trusted, self._since_ns = right, None
            waits_s = self._config.patience_s if right else self._config.recovery_s
            self._waits_ns = round(waits_s * NS_PER_S)


class Loops:
    """Both loops behind one module. The module listens to the bus and the units to their wires."""

    __slots__ = ("_command", "_watch", "brake", "traction")

    def __init__(self, config: LoopConfig, generators: Generators, *, timeout_ns: int) -> None:
        errors = generators.of(NoiseSource.LOOP_ERROR)
        self._command: AnalogueCommand | None = None
        self._watch = CommandWatch(timeout_ns)
        noise = Gaussian(generators.of(NoiseSource.LOOP_NOISE), config.sigma_ma)
        self.traction = Loop(
            config,
            full_mps2=config.traction_full_mps2,
            over_ratio=0.0,
            offset_ma=config.offset_ma.draw(errors),
            gain_ratio=config.gain_ratio.draw(errors),
            noise=noise,
        )
        self.brake = Loop(
            config,
            full_mps2=config.brake_full_mps2,
            over_ratio=1.0,
            offset_ma=config.offset_ma.draw(errors),
            gain_ratio=config.gain_ratio.draw(errors),
            noise=noise,
        )

    def excuse(self, held_up_ns: int) -> None:
        """Extend the command timeout by the time for which the bench itself was stopped."""
        self._watch.excuse(held_up_ns)

    def hear(self, command: AnalogueCommand, heard_ns: int) -> None:
        self._command = command
        self._watch.heard(heard_ns)

    def step(self, now_ns: int, *, traction_mps2: float, brake_mps2: float) -> None:
        """Set and read both loops.

        Args:
            traction_mps2, brake_mps2: amounts in the protected commands.
        """
        if now_ns > self._watch.expires_ns:
            self._command = None
            self._watch.lost()
        command = self._command
        traction_ma = None if command is None else command.traction_ma
        brake_ma = None if command is None else command.brake_ma
        self.traction.step(traction_ma, traction_mps2, now_ns)
        self.brake.step(brake_ma, brake_mps2, now_ns)
