"""What protection remembers of the way: how far back, how far from where it was held or granted."""

from typing import NamedTuple

from vobc.vocabulary import Motion


class _Jog(NamedTuple):
    from_m: float
    """Where it was granted."""
    back_to_m: float
    """The train may go back to here."""


class Movement:
    """Distances by pulses alone, which no tag makes jump."""

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
