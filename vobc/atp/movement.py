"""Distances of the train: rollback, movement while held, and movement during a jog."""

from dataclasses import replace
from typing import NamedTuple

from vobc.vocabulary import Motion


class _Jog(NamedTuple):
    from_m: float
    """Where the jog was granted."""
    back_to_m: float
    """Hindmost place to which the train may go back."""


class Movement:
    """Distances along one odometer reading. Tags do not shift it."""

    def __init__(self) -> None:
        self._foremost_m = 0.0
        self._held_at_m = 0.0
        self._jog: _Jog | None = None
        self.rollback_m = 0.0
        """Distance back from the foremost place. 0 during a jog, which may go back."""
        self.held_m = 0.0
        """Distance from the place where the train was last to be held, in either direction."""
        self.jog_m = 0.0
        """Distance from the place where the jog was granted, in either direction. 0 without a jog.
        """
        self.behind_jog_m = 0.0
        """Distance back from the place that protects the rear during a jog. 0 without a jog."""

    def look(self, travel_m: float) -> None:
        """Measure, before any decision."""
        # With this order of arguments, max() ignores a NaN.
        self._foremost_m = max(self._foremost_m, travel_m)
        self.held_m = abs(travel_m - self._held_at_m)
        if self._jog is None:
            self.rollback_m = self._foremost_m - travel_m
            self.jog_m = self.behind_jog_m = 0.0
        else:
            self.rollback_m = 0.0
            self.jog_m = abs(travel_m - self._jog.from_m)
            self.behind_jog_m = self._jog.back_to_m - travel_m

    def held_here(self, travel_m: float) -> None:
        self._held_at_m = travel_m

    def restart(self, travel_m: float) -> None:
        """Restart the measurement, because the train is to be held from now on."""
        self._held_at_m = self._foremost_m = travel_m

    def jogs(self, motion: Motion, jog_back_m: float) -> None:
        """Grant a jog. How far back it may go is fixed while the train stands.

        The limit can only become tighter, so a train that rolls back bit by bit gains nothing.
        """
        back_to_m = motion.travel_m - jog_back_m
        jog = self._jog
        if jog is None:
            self._jog = _Jog(motion.travel_m, back_to_m)
        elif motion.standing:
            self._jog = _Jog(jog.from_m, max(jog.back_to_m, back_to_m))

    def jogs_no_more(self, travel_m: float) -> None:
        if self._jog is not None:
            self._jog = None
            self._foremost_m = travel_m


class Movements:
    """Distances by pulses alone, and by the estimated movement over ground during slip.

    Either may be wrong: pulses of a spinning or locked wheel, or the estimate if a faulty
    accelerometer simulates slip. The larger value counts.
    """

    def __init__(self) -> None:
        self._counted = Movement()
        self._believed = Movement()
        self.rollback_m = 0.0
        self.held_m = 0.0
        self.jog_m = 0.0
        self.behind_jog_m = 0.0

    def look(self, motion: Motion) -> None:
        """Measure, before any decision."""
        counted, believed = self._counted, self._believed
        counted.look(motion.pulses_m)
        believed.look(motion.travel_m)
        self.rollback_m = max(counted.rollback_m, believed.rollback_m)
        self.held_m = max(counted.held_m, believed.held_m)
        self.jog_m = max(counted.jog_m, believed.jog_m)
        self.behind_jog_m = max(counted.behind_jog_m, believed.behind_jog_m)

    def held_here(self, motion: Motion) -> None:
        self._counted.held_here(motion.pulses_m)
        self._believed.held_here(motion.travel_m)

    def restart(self, motion: Motion) -> None:
        """Restart the measurement, because the train is to be held from now on."""
        self._counted.restart(motion.pulses_m)
        self._believed.restart(motion.travel_m)

    def jogs(self, motion: Motion, jog_back_m: float) -> None:
        """Grant a jog by both measures."""
        self._counted.jogs(replace(motion, travel_m=motion.pulses_m), jog_back_m)
        self._believed.jogs(motion, jog_back_m)

    def jogs_no_more(self, motion: Motion) -> None:
        self._counted.jogs_no_more(motion.pulses_m)
        self._believed.jogs_no_more(motion.travel_m)
