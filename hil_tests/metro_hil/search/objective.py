"""How bad a point is: the least margin of its runs, comparable across monitors."""

import statistics
from collections.abc import Mapping, Sequence
from typing import Final

from firmware_py.settings import nearest
from metro_hil.model.case import CaseResult, Verdict
from metro_hil.search.space import SearchError

NOTHING_SEEN: Final = 1.0e6
"""Worth of a point whose runs say nothing: worse to go to than any that says something."""
DIED: Final = -1.0
"""A run that failed without a margin under zero, such as by a controller that died, counts as a
violation as large as margins of that scenario usually are."""
SCALE_MIN: Final = 1e-9


class Objective:
    """Of one monitor, in its unit, or the least over all, each over its own usual size."""

    def __init__(self, monitor: str | None) -> None:
        self.monitor = monitor
        self.scales: dict[str, float] = {}
        """Median size of each monitor's margin over the first batch; empty for one monitor."""

    def calibrate(self, results: Sequence[CaseResult]) -> None:
        """Learn from the first batch what margins are usual. Raises SearchError."""
        sizes: dict[str, list[float]] = {}
        names: list[str] = []
        for result in results:
            for monitor in result.monitors:
                names.append(monitor.name)
                if monitor.margin is not None:
                    sizes.setdefault(monitor.name, []).append(abs(monitor.margin))
        if self.monitor is None:
            self.scales = {
                name: max(SCALE_MIN, statistics.median(some)) for name, some in sizes.items()
            }
        elif self.monitor not in names:
            known = list(dict.fromkeys(names))
            raise SearchError(f"--monitor {self.monitor}: {nearest(self.monitor, known)}")

    def of(self, results: Sequence[CaseResult]) -> float:
        """The worst of the seeds; negative when a monitor was violated."""
        return min(map(self._of_run, results))

    def worst_of(self, results: Sequence[CaseResult]) -> CaseResult:
        return min(results, key=self._of_run)

    def _of_run(self, result: CaseResult) -> float:
        margins = margins_of(result)
        if self.monitor is not None:
            return margins.get(self.monitor, NOTHING_SEEN)
        # A monitor that the first batch never saw has no usual size; its own unit has to do.
        known = [margin / self.scales.get(name, 1.0) for name, margin in margins.items()]
        least = min(known, default=NOTHING_SEEN)
        return min(least, DIED) if result.verdict is Verdict.FAIL and least >= 0.0 else least


def margins_of(result: CaseResult) -> Mapping[str, float]:
    """By monitor, of those that saw something."""
    return {
        monitor.name: monitor.margin for monitor in result.monitors if monitor.margin is not None
    }
