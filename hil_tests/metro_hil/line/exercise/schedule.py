"""When the faults of a line begin and when they end. Pure."""

from collections.abc import Callable, Sequence
from typing import Final

from metro_hil.line.exercise.plan import Fault

NS_PER_S: Final = 1_000_000_000


class FaultSchedule:
    """The planned faults of a run."""

    def __init__(self, faults: Sequence[Fault], down_s: float) -> None:
        """Args:
        down_s: time after which a fault ends.
        """
        self.waiting = list(faults)
        """Faults that have not begun."""
        self._down_ns = round(down_s * NS_PER_S)
        self._later: list[tuple[int, Callable[[], None]]] = []

    def step(self, now_ns: int, began_ns: int, apply: Callable[[Fault], bool]) -> None:
        """End and begin what is due.

        Args:
            began_ns: instant from which the seconds of faults count.
            apply: begins a fault; returns False if it cannot begin yet.
        """
        for due in list(self._later):
            if now_ns >= due[0]:
                self._later.remove(due)
                due[1]()
        for fault in list(self.waiting):
            if now_ns - began_ns >= fault.at_s * NS_PER_S and apply(fault):
                self.waiting.remove(fault)

    def ends(self, now_ns: int, action: Callable[[], None]) -> None:
        """Plan what ends a fault that begins now."""
        self._later.append((now_ns + self._down_ns, action))
