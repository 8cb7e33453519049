"""Detector of cold movement: how far the train moves while its controller is switched off."""

from can_dbc.odometer import ColdMovement


class ColdDetector:
    """The controller counts as switched off until it speaks first, and while no unit hears it.

    What was found stays to be read until it is switched off again. Movement under a controller that
    speaks is none of the detector's business.
    """

    __slots__ = ("_found_m", "_left_at_m", "_moved_m", "_off", "forced_m", "monitored")

    def __init__(self, front_m: float) -> None:
        self._left_at_m = front_m
        """Where the train was when it was commanded last."""
        self._off = True
        self._found_m = 0.0
        """Most that the train was away from there, in the present or the last absence."""
        self.forced_m: float | None = None
        """A fault: what it says instead."""
        self.monitored = True
        """A fault makes it False: the detector slept for a while."""

    def attended(self, front_m: float) -> None:
        """The controller speaks."""
        if self._off:
            self._found(front_m)
            self._off = False
        self._left_at_m = front_m

    def look(self, front_m: float, *, silent: bool) -> None:
        """Now and then; `silent`: the controller spoke before, and no unit hears it any more."""
        if silent and not self._off:
            self._off = True
            self._found_m = 0.0
        if self._off:
            self._found(front_m)

    def _found(self, front_m: float) -> None:
        self._found_m = max(self._found_m, abs(front_m - self._left_at_m))

    def frame(self) -> ColdMovement:
        moved_m = self._found_m if self.forced_m is None else self.forced_m
        return ColdMovement(moved_m=moved_m, monitored=self.monitored)
