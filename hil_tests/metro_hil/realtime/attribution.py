"""Decides whether a failure in real time is due to the controller or to the host of the bench.

The rules, applied to evidence that the run collected:

1. A *disturbance* is a stretch of the run in which the host demonstrably delayed something. Other
guests took processor time (steal). The controller or a carrier of its frames was ready to run and
got no processor. The controller's cycle started late although its own cycles were short. The plant
fell behind its steps. Or a frame waited in the gateway. Each has a threshold; below it is everyday
jitter, which monitors allow for (`metro_hil.realtime.tolerances`).
2. What a fault of the scenario did to the controller's process is not a disturbance. Neither is a
cycle that is late because the one before took too long: that is the controller's own failure.
3. A *failure* is INVALID instead of FAIL when a disturbance overlaps its window. The window begins
`LOOKBACK_S` before the violation and ends with it; for a failure without an instant it is the whole
run. Otherwise the failure stays a FAIL.
4. A program that ends by itself does so whatever the host does. Only an end by its watchdog, or
silence, may be due to the host, and only if a disturbance is long enough for it.
5. A *pass* stands only where the bench observed everything. Frames that the tap lost, or truth that
did not arrive for longer than `BLIND_S`, make it INCONCLUSIVE. A plant that skipped steps makes it
INVALID: the train did not move as its physics demands.
"""

import enum
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from metro_hil.model.case import Verdict

STEAL_S: Final = 0.05
"""Stolen time from all processors together within a second: as long as a control cycle."""
WAITED_S: Final = 0.05
"""Waiting time for a processor, summed over a second."""
LATE_S: Final = 0.05
"""Lateness of a cycle: one default period, a third of the time that the train's units wait."""
PLANT_LATE_S: Final = 0.05
GATEWAY_LATE_S: Final = 0.02
BLIND_S: Final = 0.05
"""Gap in the truth: five steps of the plant."""
LOOKBACK_S: Final = 5.0
"""Longest time from a cause to its violation. Units that miss commands brake within 0.15 s, and
a train braked from full speed stands some seconds later."""
START_UP_S: Final = 2.0
"""Time in which starting processes delay each other while the train still stands. Later failures do
not come from that."""
HANG_S: Final = 0.5
"""Shortest delay that can make a controller silent for two seconds or trip its watchdog of one
second."""
NO_EXCUSE_S: Final = 1.0e9
WHOLE_RUN_S: Final = 1.0e9


class DisturbanceSource(enum.Enum):
    """Evidence of a disturbance."""

    STEAL = "processor time stolen by other guests"
    WAITING = "controller ready to run, no processor given"
    LATENESS = "controller begun late by the host"
    CARRIERS = "bus or gateway ready to run, no processor given"
    STALL = "neither bench nor controller given a processor"
    PLANT = "plant fell behind its steps"
    GATEWAY = "frames waited in the gateway"


@dataclass(frozen=True, slots=True)
class Disturbance:
    """A delay by the host, in seconds since the start of the plant's time."""

    begin_s: float
    end_s: float
    source: DisturbanceSource
    amount_s: float
    """Duration of the delay."""

    def words(self) -> str:
        return (
            f"{self.source.value}: {1000.0 * self.amount_s:.0f} ms at "
            f"{self.begin_s:.2f}..{self.end_s:.2f} s"
        )


@dataclass(frozen=True, slots=True)
class CycleRow:
    """One cycle in the controller's log."""

    t_s: float
    """Start of the cycle in the plant's time."""
    work_s: float
    """Work time of the cycle before, as the controller logs it."""
    lateness_s: float
    period_s: float


@dataclass(frozen=True, slots=True)
class RunWindow:
    """A stretch of the run, in seconds of the plant's time."""

    begin_s: float
    end_s: float

    def overlaps(self, begin_s: float, end_s: float) -> bool:
        return self.begin_s <= end_s and begin_s <= self.end_s


@dataclass(frozen=True, slots=True)
class HostEvidence:
    """What the bench knows about its host at the end of a run."""

    disturbances: Sequence[Disturbance] = ()
    dropped_frames: int = 0
    """Number of frames that the tap lost."""
    blind: Sequence[RunWindow] = ()
    """Stretches in which no truth arrived."""
    given_up_s: float = 0.0
    """Plant time in steps that the plant skipped."""


@dataclass(frozen=True, slots=True)
class Failure:
    """One failure of the run."""

    at_s: float | None
    """Instant of the violation in the plant's time; None for the run as a whole."""
    least_s: float = 0.0
    """Least duration of a disturbance that can explain this failure."""


@dataclass(frozen=True, slots=True)
class Ruling:
    """The final verdict, and the reason if it differs from the monitors' verdict."""

    verdict: Verdict
    reason: str = ""


def rule(verdict: Verdict, failures: Sequence[Failure], evidence: HostEvidence) -> Ruling:
    """Apply the rules to the monitors' verdict; `failures` is empty except for a FAIL."""
    if verdict is Verdict.FAIL:
        return _rule_failure(failures or (Failure(None),), evidence)
    if verdict is Verdict.PASS:
        return _rule_pass(evidence)
    return Ruling(verdict)


def _rule_failure(failures: Sequence[Failure], evidence: HostEvidence) -> Ruling:
    found = [_cause(failure, evidence.disturbances) for failure in failures]
    excused = [cause for cause in found if cause is not None]
    if len(excused) < len(found):
        # One failure that no disturbance explains is enough.
        return Ruling(Verdict.FAIL)
    worst = max(excused, key=lambda cause: cause.amount_s)
    return Ruling(Verdict.INVALID, f"the host disturbed the run: {worst.words()}")


def _cause(failure: Failure, disturbances: Sequence[Disturbance]) -> Disturbance | None:
    """Return the greatest disturbance that may have caused the failure."""
    window = failure_window(failure.at_s)
    near = [
        each
        for each in disturbances
        if window.overlaps(each.begin_s, each.end_s) and each.amount_s >= failure.least_s
    ]
    return max(near, key=lambda each: each.amount_s, default=None)


def failure_window(at_s: float | None) -> RunWindow:
    if at_s is None:
        return RunWindow(START_UP_S, WHOLE_RUN_S)
    return RunWindow(at_s - LOOKBACK_S, at_s)


def _rule_pass(evidence: HostEvidence) -> Ruling:
    if evidence.given_up_s > 0.0:
        reason = f"the host delayed the plant, which skipped {evidence.given_up_s:.2f} s"
        return Ruling(Verdict.INVALID, reason)
    if evidence.dropped_frames:
        reason = f"{evidence.dropped_frames} frames on the bus did not reach the monitors"
        return Ruling(Verdict.INCONCLUSIVE, reason)
    longest = max(evidence.blind, key=lambda each: each.end_s - each.begin_s, default=None)
    if longest is not None and longest.end_s - longest.begin_s > BLIND_S:
        return Ruling(
            Verdict.INCONCLUSIVE,
            f"the monitors received no truth for {longest.end_s - longest.begin_s:.2f} s at "
            f"{longest.begin_s:.2f} s",
        )
    return Ruling(Verdict.PASS)


def second_disturbances(
    samples: Sequence[tuple[float, float]], source: DisturbanceSource, least_s: float
) -> list[Disturbance]:
    """Return disturbances from samples of (end of a second, delay within that second)."""
    found = []
    last_s = 0.0
    for at_s, held_s in samples:
        if held_s >= least_s:
            found.append(Disturbance(min(last_s, at_s), at_s, source, held_s))
        last_s = at_s
    return found


def lateness_disturbances(
    rows: Sequence[CycleRow], excused: Sequence[RunWindow] = ()
) -> list[Disturbance]:
    """Return the cycles that the host started late.

    A cycle is late by itself when the one before overran its period; the host is responsible only
    for the rest.

    Args:
        excused: stretches in which a fault of the scenario delayed the process.
    """
    found = []
    for row in rows:
        own_s = max(0.0, row.work_s - row.period_s)
        late_s = row.lateness_s - own_s
        begin_s = row.t_s - row.lateness_s
        if late_s < LATE_S or any(window.overlaps(begin_s, row.t_s) for window in excused):
            continue
        found.append(Disturbance(begin_s, row.t_s, DisturbanceSource.LATENESS, late_s))
    return found


def plant_disturbances(arrivals: Sequence[tuple[float, float]]) -> list[Disturbance]:
    """Return disturbances from samples of (plant time, lateness of the step that reached it)."""
    return [
        Disturbance(at_s - late_s, at_s, DisturbanceSource.PLANT, late_s)
        for at_s, late_s in arrivals
        if late_s >= PLANT_LATE_S
    ]
