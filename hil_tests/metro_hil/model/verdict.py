"""From what a run showed to its verdict; the same rules on every bench."""

from collections.abc import Sequence

from metro_hil.model.case import MonitorResult, Verdict

DEAD = "the controller ended by itself"
MOVED_MIN_M = 1.0
"""A train that did not move by this much has shown nothing about driving."""


def judge(
    monitors: Sequence[MonitorResult],
    *,
    died: str,
    never_began: Sequence[str],
    moved_m: float,
    violated: bool,
    idle_counts: bool = False,
) -> tuple[Verdict, str]:
    """The verdict and why it is not a pass.

    Args:
        died: how the controller ended by itself, empty when it did not.
        never_began: faults whose time or condition never came.
        moved_m: how far the train was from its first place at most, either way.
        idle_counts: monitors alone decide, though the train never moved or a fault never began.
        violated: the run was ended at a violation, so that what comes later was never tried.
    """
    failed = [result for result in monitors if result.verdict is Verdict.FAIL]
    if died:
        return Verdict.FAIL, f"{DEAD}: {died}"
    if failed:
        return Verdict.FAIL, "; ".join(_words(result) for result in failed)
    assert not violated, "a violation without a monitor that failed"
    if never_began and not idle_counts:
        return Verdict.BLOCKED, f"never began: {', '.join(never_began)}"
    unseen = [result.name for result in monitors if result.verdict is not Verdict.PASS]
    if unseen:
        return Verdict.INCONCLUSIVE, f"nothing seen by: {', '.join(unseen)}"
    if moved_m < MOVED_MIN_M and not idle_counts:
        return Verdict.INCONCLUSIVE, "the train never moved"
    return Verdict.PASS, ""


def _words(result: MonitorResult) -> str:
    margin = "" if result.margin is None else f" by {-result.margin:.3g} {result.unit}".rstrip()
    at = "" if result.at_s is None else f" at {result.at_s:.2f} s"
    return f"{result.name} violated{margin}{at}"
