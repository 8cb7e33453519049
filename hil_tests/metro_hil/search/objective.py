"""Value of a point: the least margin of its runs, comparable across monitors."""

import statistics
from collections.abc import Mapping, Sequence
from typing import Final

from firmware_py.settings import nearest
from metro_hil.model.case import CaseResult, Verdict
from metro_hil.search.space import SearchError

NOTHING_SEEN: Final = 1.0e6
"""Value of a point without margins; greater than any margin, so that the search avoids it."""
DIED: Final = -1.0
"""Value of a failed run without a negative margin, such as after the controller died. It counts as
a violation of usual size."""
SCALE_MIN: Final = 1e-9


class Objective:
    """Margin of one monitor in its unit, or the least of all, each over its usual size."""

    def __init__(self, monitor: str | None) -> None:
        self.monitor = monitor
        self.scales: dict[str, float] = {}
        """Median size of each monitor's margin in the first batch; empty for a single monitor."""

    def calibrate(self, results: Sequence[CaseResult]) -> None:
        """Learn the usual margins from the first batch. Raises SearchError."""
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
        """Value of the worst seed; negative if a monitor was violated."""
        return min(map(self._of_run, results))

    def worst_of(self, results: Sequence[CaseResult]) -> CaseResult:
        return min(results, key=self._of_run)

    def _of_run(self, result: CaseResult) -> float:
        margins = margins_of(result)
        if self.monitor is not None:
            return margins.get(self.monitor, NOTHING_SEEN)
        # A monitor without a margin in the first batch has no usual size; its unit replaces it.
        known = [margin / self.scales.get(name, 1.0) for name, margin in margins.items()]
        least = min(known, default=NOTHING_SEEN)
        return min(least, DIED) if result.verdict is Verdict.FAIL and least >= 0.0 else least


def margins_of(result: CaseResult) -> Mapping[str, float]:
    """Margins by monitor; monitors that judged nothing are left out."""
    return {
        monitor.name: monitor.margin for monitor in result.monitors if monitor.margin is not None
    }
