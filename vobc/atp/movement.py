"""What protection remembers of the way: how far back, how far from where it was held or granted."""

from dataclasses import replace
from typing import NamedTuple

from vobc.vocabulary import Motion


class _Jog(NamedTuple):
    from_m: float
    """Where it was granted."""
    back_to_m: float
    """The train may go back to here."""


class Movement:
    """Distances on one way, which no tag makes jump."""

    def __init__(self) -> None:
        self._foremost_m = 0.0
        self._held_at_m = 0.0
        self._jog: _Jog | None = None
        self.rollback_m = 0.0
        """Back from the foremost place; a jog may go back and counts nothing of it."""
        self.held_m = 0.0
        """Either way from where it was last to be held."""
        self.jog_m = 0.0
        """Either way from where the jog was granted; 0 without one."""
        self.behind_jog_m = 0.0
        """Back from the place up to which the jog's rear is protected; 0 without one."""

    def look(self, travel_m: float) -> None:
        """Measure, before anything is decided."""
        # In this order: a way that is no number is not the foremost place for ever.
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

    def begin_anew(self, travel_m: float) -> None:
        """The train comes to be held: what it rolled back before is over."""
        self._held_at_m = self._foremost_m = travel_m

    def jogs(self, motion: Motion, jog_back_m: float) -> None:
        """A jog is granted. How far back it may go is settled while the train stands.

        What is settled once only gets less: a train that rolls back bit by bit gains nothing.
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
    """By pulses alone, and by what is believed of the ground while wheels slip.

    Either may be wrong: pulses of a wheel that spins or is locked, belief where an accelerometer
    makes a slip of none. What says more counts.
    """

    def __init__(self) -> None:
        self._counted = Movement()
        self._believed = Movement()
        self.rollback_m = 0.0
        self.held_m = 0.0
        self.jog_m = 0.0
        self.behind_jog_m = 0.0

    def look(self, motion: Motion) -> None:
        """Measure, before anything is decided."""
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

    def begin_anew(self, motion: Motion) -> None:
        """The train comes to be held: what it rolled back before is over."""
        self._counted.begin_anew(motion.pulses_m)
        self._believed.begin_anew(motion.travel_m)

    def jogs(self, motion: Motion, jog_back_m: float) -> None:
        """A jog is granted, on both ways alike."""
        self._counted.jogs(replace(motion, travel_m=motion.pulses_m), jog_back_m)
        self._believed.jogs(motion, jog_back_m)

    def jogs_no_more(self, motion: Motion) -> None:
        self._counted.jogs_no_more(motion.pulses_m)
        self._believed.jogs_no_more(motion.travel_m)
