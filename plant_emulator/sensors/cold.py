"""Cold-movement detector: measures how far the train moves while its controller is off."""

from can_dbc.odometer import ColdMovement


class ColdDetector:
    """Measures movement while the controller is off.

    The controller counts as off until its first command, and while no unit receives commands. The
    result can be read until the next switch-off. The detector ignores movement under a working
    controller.
    """

    __slots__ = ("_found_m", "_left_at_m", "_moved_m", "_off", "forced_m", "monitored")

    def __init__(self, front_m: float) -> None:
        self._left_at_m = front_m
        """Place of the train at its last command."""
        self._off = True
        self._found_m = 0.0
        """Largest distance from that place during the present or the last switch-off."""
        self.forced_m: float | None = None
        """A fault: distance that the detector reports instead of its own."""
        self.monitored = True
        """A fault sets this to False: the detector did not monitor all the time."""

    def attended(self, front_m: float) -> None:
        """Record that the controller sent a command."""
        if self._off:
            self._found(front_m)
            self._off = False
        self._left_at_m = front_m

    def look(self, front_m: float, *, silent: bool) -> None:
        """Update the detector periodically.

        Args:
            silent: the controller sent commands before, and no unit receives them now.
        """
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
