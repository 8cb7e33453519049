"""Whose fault a failure in real time is: the controller's, or the host's that ran the bench.

The rules, applied to evidence that the run collected:

1. A *disturbance* is a stretch of the run in which the host demonstrably held something up: other
   guests took processor time (steal), the controller or what carries its frames was ready to run
   and got no processor, the controller was begun late though its own cycles were short, the plant
   fell behind its steps, or a frame waited in the gateway. Each has a threshold, below which it is
   everyday jitter that monitors allow for (`metro_hil.realtime.tolerances`).
2. What a fault of the scenario did to the controller's process is no disturbance; neither is a
   cycle that is late because the one before took too long: that is the controller's own.
3. A *failure* is INVALID instead of FAIL when a disturbance overlaps its window: from `LOOKBACK_S`
   before the instant of the violation to the instant itself; the whole run where a failure has no
   instant. Otherwise it stays a FAIL.
4. A program that ends by itself does so whatever the host does; only its own watchdog, or silence,
   may be the host's doing, and then only of a disturbance that is long enough for it.
5. A *pass* stands only where the bench saw everything: frames that the tap lost, or truth that did
   not arrive for longer than `BLIND_S`, make it INCONCLUSIVE. A plant that gave up steps makes it
   INVALID: the train did not move as its physics says.
"""

import enum
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from metro_hil.model.case import Verdict

STEAL_S: Final = 0.05
"""Taken from all processors together within a second: as long as a control cycle."""
WAITED_S: Final = 0.05
"""Summed over a second."""
LATE_S: Final = 0.05
"""A whole cycle of the default period, a third of what the train's units wait for."""
PLANT_LATE_S: Final = 0.05
GATEWAY_LATE_S: Final = 0.02
BLIND_S: Final = 0.05
"""Five steps of the plant."""
LOOKBACK_S: Final = 5.0
"""How long before a violation its cause may lie: units that brake for want of commands do so within
0.15 s, and a train that was braked from full speed stands within some seconds more."""
START_UP_S: Final = 2.0
"""While the processes of a case start they hold each other up, and the train still stands: what
goes wrong much later is not the fault of that."""
HANG_S: Final = 0.5
"""Nothing shorter makes a controller silent for two seconds, or its watchdog of one second bite."""
NO_EXCUSE_S: Final = 1.0e9
WHOLE_RUN_S: Final = 1.0e9


class DisturbanceSource(enum.Enum):
    """What shows a disturbance."""

    STEAL = "processor time stolen by other guests"
    WAITING = "controller ready to run, no processor given"
    LATENESS = "controller begun late by the host"
    CARRIERS = "bus or gateway ready to run, no processor given"
    STALL = "neither bench nor controller given a processor"
    PLANT = "plant fell behind its steps"
    GATEWAY = "frames waited in the gateway"


@dataclass(frozen=True, slots=True)
class Disturbance:
    """Seconds since the start of the plant's time."""

    begin_s: float
    end_s: float
    source: DisturbanceSource
    amount_s: float
    """How long it held things up."""

    def words(self) -> str:
        return (
            f"{self.source.value}: {1000.0 * self.amount_s:.0f} ms at "
            f"{self.begin_s:.2f}..{self.end_s:.2f} s"
        )


@dataclass(frozen=True, slots=True)
class CycleRow:
    """What the controller's log says of one cycle."""

    t_s: float
    """In the plant's time."""
    work_s: float
    """Of the cycle before, as the controller's log has it."""
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
    """What the bench knows of its host at the end of a run."""

    disturbances: Sequence[Disturbance] = ()
    dropped_frames: int = 0
    """That the tap did not get."""
    blind: Sequence[RunWindow] = ()
    """Where no truth arrived."""
    given_up_s: float = 0.0
    """Of the plant's time, that it passed over."""


@dataclass(frozen=True, slots=True)
class Failure:
    """One thing that went wrong."""

    at_s: float | None
    """Of the violation, in the plant's time; None for the run as a whole."""
    least_s: float = 0.0
    """A disturbance that is to excuse it has to have held things up for at least so long."""


@dataclass(frozen=True, slots=True)
class Ruling:
    """The verdict that stands, and why it is another than the monitors'."""

    verdict: Verdict
    reason: str = ""


def rule(verdict: Verdict, failures: Sequence[Failure], evidence: HostEvidence) -> Ruling:
    """Apply the rules to what the monitors say; `failures` is empty but for a FAIL."""
    if verdict is Verdict.FAIL:
        return _rule_failure(failures or (Failure(None),), evidence)
    if verdict is Verdict.PASS:
        return _rule_pass(evidence)
    return Ruling(verdict)


def _rule_failure(failures: Sequence[Failure], evidence: HostEvidence) -> Ruling:
    found = [_cause(failure, evidence.disturbances) for failure in failures]
    excused = [cause for cause in found if cause is not None]
    if len(excused) < len(found):
        # One failure that nothing excuses is enough.
        return Ruling(Verdict.FAIL)
    worst = max(excused, key=lambda cause: cause.amount_s)
    return Ruling(Verdict.INVALID, f"the host disturbed the run: {worst.words()}")


def _cause(failure: Failure, disturbances: Sequence[Disturbance]) -> Disturbance | None:
    """The greatest disturbance that may have brought about a failure."""
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
        reason = f"the plant was held up by the host and gave up {evidence.given_up_s:.2f} s"
        return Ruling(Verdict.INVALID, reason)
    if evidence.dropped_frames:
        reason = f"{evidence.dropped_frames} frames on the bus were not seen by the monitors"
        return Ruling(Verdict.INCONCLUSIVE, reason)
    longest = max(evidence.blind, key=lambda each: each.end_s - each.begin_s, default=None)
    if longest is not None and longest.end_s - longest.begin_s > BLIND_S:
        return Ruling(
            Verdict.INCONCLUSIVE,
            f"the monitors saw no truth for {longest.end_s - longest.begin_s:.2f} s at "
            f"{longest.begin_s:.2f} s",
        )
    return Ruling(Verdict.PASS)


def second_disturbances(
    samples: Sequence[tuple[float, float]], source: DisturbanceSource, least_s: float
) -> list[Disturbance]:
    """From (end of a second, how long it held things up within it), a sample a second."""
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
    """Cycles that the host began late.

    A cycle is late by itself when the one before overran its period; only what is late beyond that
    is the host's.

    Args:
        excused: while a fault of the scenario held the process up.
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
    """From (plant's time, how late the step was that brought it there)."""
    return [
        Disturbance(at_s - late_s, at_s, DisturbanceSource.PLANT, late_s)
        for at_s, late_s in arrivals
        if late_s >= PLANT_LATE_S
    ]
