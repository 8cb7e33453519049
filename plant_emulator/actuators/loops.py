"""Where traction and service brake take their reference from: the bus, or loops of 4 to 20 mA.

On loops a module on the bus sets the currents that the controller asks for, and each unit reads its
own. What the protected commands say stays in force for all but the amount: emergency and holding
brake, permission and direction of traction. The amount in them is what a unit holds its loop
against. A unit that does not trust its loop says that it is not ready; the brake then gives the
stronger of both, traction nothing.
"""

from typing import Final

from can_dbc.analogue import AnalogueCommand
from plant_emulator.actuators.response import NS_PER_S, CommandWatch
from plant_emulator.noise import Gaussian, Generators, NoiseSource
from plant_emulator.train_config import LoopConfig

LIVE_ZERO_MA: Final = 4.0
FULL_MA: Final = 18.0
OVER_MA: Final = 20.0
"""Over this the brake is applied in full and traction is cut."""
CONVERTER_MA: Final = 24.0
"""Range of the unit's converter."""


def effort_ratio(read_ma: float, *, over_ratio: float) -> float:
    """Share of full effort that a current stands for.

    Args:
        over_ratio: what a current over the range stands for.
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
        """A fault: the wire carries nothing."""
        self._short_ma: float | None = None
        self._fault_ma = 0.0
        self.read_ma = 0.0
        self.reference_mps2 = 0.0
        """What the unit makes of it."""
        self.trusted = False
        self._since_ns: int | None = None
        """Since when it has looked other than `trusted` says."""
        self._waits_ns = round(config.patience_s * NS_PER_S)
        """Until that is believed."""

    def disturb(self, *, offset_ma: float, short_ma: float | None, broken: bool) -> None:
        """Faults: a broken wire carries nothing, one shorted to a supply what that drives."""
        self._fault_ma, self._short_ma, self.broken = offset_ma, short_ma, broken

    def step(self, set_ma: float | None, said_mps2: float, now_ns: int) -> None:
        """Read once.

        Args:
            set_ma: by the module; None where it has nobody to ask.
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
    """Both loops behind one module; it listens to the bus, the units to their wires."""

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
        """The bench stood still for so long; that is not the controller's silence."""
        self._watch.excuse(held_up_ns)

    def hear(self, command: AnalogueCommand, heard_ns: int) -> None:
        self._command = command
        self._watch.heard(heard_ns)

    def step(self, now_ns: int, *, traction_mps2: float, brake_mps2: float) -> None:
        """Set and read both.

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
