"""All monitors of one run: they take frames and truth during the run, and give results after it."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from metro_hil.model.case import MonitorResult, Verdict
from metro_hil.monitors.context import Context
from metro_hil.monitors.description import CONTROLLER_IDS, Spoken
from metro_hil.monitors.gauge import NEVER_NS, Gauge
from metro_hil.monitors.invariants import Invariants
from metro_hil.monitors.place import LinePlaces
from metro_hil.monitors.plan import MonitorKind, MonitorPlan, Severity
from metro_hil.monitors.signals import Signals
from metro_hil.monitors.stl import NEVER_HELD, Formula
from metro_hil.monitors.terms import TermState
from metro_hil.monitors.vocabulary import BOOLEANS, NAMES
from plant_emulator.truth import SIGNALS as TRUTH_SIGNALS
from plant_emulator.truth import Truth
from zenoh_config.messages import MovementAuthority

NS_PER_S: Final = 1_000_000_000
AROUND_NS: Final = NS_PER_S
TRUTH_NAMES: Final = frozenset(TRUTH_SIGNALS)
TINY: Final = 1.0e-300
"""Margins closer to zero only show that a strict limit was met exactly."""


@dataclass(frozen=True, slots=True)
class Violation:
    """Where to look in the logs of a run."""

    monitor: str
    first_ns: int
    """Instant from which the violation was known."""
    begin_ns: int
    end_ns: int
    """The window lasts from a second before the first violation to a second after the worst one."""


class MonitorSet:
    """Takes each frame and each step in order."""

    __slots__ = (
        "_context",
        "_cut_short",
        "_fills",
        "_finished",
        "_first_ns",
        "_formulas",
        "_gauges",
        "_heard",
        "_invariants",
        "_known_violated",
        "_plans",
        "_signals",
        "_spoken",
        "_stop_gauges",
        "_violated_at_ns",
        "_watches",
        "violated",
        "wanted_ids",
    )

    def __init__(
        self, plans: Sequence[MonitorPlan], context: Context, *, own_port: bool = False
    ) -> None:
        """Create the monitors.

        Args:
            own_port: `said` passes the controller's frames from its own port, before a gateway can
                change them. Otherwise they are taken from the bus.
        """
        self._plans = tuple(plans)
        self._context = context
        self._spoken = spoken = Spoken(context.start_ns)
        self._heard = Spoken(context.start_ns) if own_port else spoken
        train = context.train
        place = LinePlaces(
            context.line,
            length_m=train.length_m,
            rotating_ratio=train.rotating_mass_percent / 100.0,
        )
        self._invariants = Invariants(context, spoken, self._heard, place)
        self._watches = any(plan.kind is MonitorKind.INVARIANT for plan in plans)
        self._stop_gauges: dict[str, MonitorPlan] = {
            plan.text: plan
            for plan in plans
            if plan.kind is MonitorKind.INVARIANT and plan.severity is Severity.STOP
        }
        self._formulas: list[tuple[MonitorPlan, Formula]] = [
            (plan, Formula(plan.text, NAMES, BOOLEANS))
            for plan in plans
            if plan.kind is MonitorKind.STL
        ]
        self._first_ns: dict[str, int] = {}
        """Instant at which the violation of each formula was known, by name of the monitor."""
        names: set[str] = set()
        for _, formula in self._formulas:
            names |= formula.names
        # The stopping distance needs the history of the emergency brake, which the invariants
        # follow.
        self._watches = self._watches or "stopping_m" in names
        self._signals = Signals(spoken, place, self._invariants.motion, names)
        self._fills = not names <= TRUTH_NAMES
        listens = self._watches or self._fills
        self.wanted_ids: frozenset[int] = spoken.wanted_ids if listens else frozenset()
        """Identifiers of frames that matter; all others change nothing."""
        self.violated: MonitorPlan | None = None
        """First violated monitor that may end the run."""
        self._violated_at_ns = NEVER_NS
        self._known_violated = 0
        self._finished = self._cut_short = False

    def frame(self, stamp_ns: int, can_id: int, data: bytes) -> None:
        """Take one frame of the bus, at the end of its transmission."""
        if can_id not in self.wanted_ids:
            return
        self._heard.frame(stamp_ns, can_id, data)
        if self._heard is not self._spoken and can_id not in CONTROLLER_IDS:
            self._spoken.frame(stamp_ns, can_id, data)

    def said(self, now_ns: int, can_id: int, data: bytes) -> None:
        """Take one frame of the controller, at its own port."""
        if can_id in self.wanted_ids:
            self._spoken.frame(now_ns, can_id, data)

    def radio(self, payload: bytes) -> None:
        """Take one radio message, as the controller receives it."""
        if self._watches:
            self._invariants.radio(payload)

    def authority(self, authority: MovementAuthority) -> None:
        """Take an authority of masters, on which the controller may act from now on."""
        if self._watches:
            self._invariants.authority(authority)

    def sample(self, truth: Truth, now_ns: int) -> None:
        """Take one step of the plant, after all frames that ended up to now."""
        if self._watches:
            self._invariants.sample(truth, now_ns)
            raised = self._invariants.alarm.raised
            if len(raised) > self._known_violated:
                self._on_alarm(raised, now_ns)
        if self._formulas:
            signals = self._signals
            if self._fills:
                signals.fill(truth, now_ns)
            # Formulas over truth alone read the truth directly.
            source: object = signals if self._fills else truth
            for plan, formula in self._formulas:
                if formula.step(now_ns, source) and plan.name not in self._first_ns:
                    self._first_ns[plan.name] = now_ns
                    self._on_violation(plan, now_ns)
        self._spoken.news = False

    def _on_alarm(self, raised: list[Gauge], now_ns: int) -> None:
        for gauge in raised[self._known_violated :]:
            plan = self._stop_gauges.get(gauge.name)
            if plan is not None:
                self._on_violation(plan, now_ns)
        self._known_violated = len(raised)

    def _on_violation(self, plan: MonitorPlan, now_ns: int) -> None:
        if self.violated is None and plan.severity is Severity.STOP:
            self.violated = plan
            self._violated_at_ns = now_ns

    @property
    def violated_at_s(self) -> float | None:
        """Time since the start at which `violated` became known."""
        return None if self.violated is None else self._seconds(self._violated_at_ns)

    def finish(self, cut_short: bool = False) -> None:
        """End the run: no more samples follow.

        Args:
            cut_short: the run ended early, as at a violation, so that events still due are unknown.
        """
        if not self._finished:
            self._finished = True
            self._cut_short = cut_short
            for _, formula in self._formulas:
                formula.finish(cut_short)

    def results(self, measures: Mapping[str, float | None]) -> tuple[MonitorResult, ...]:
        """Return the results in the order of the plans. `finish` must have been called."""
        assert self._finished
        formulas = {plan.name: formula for plan, formula in self._formulas}
        return tuple(
            self._of_gauge(plan, self._invariants.gauges[plan.text])
            if plan.kind is MonitorKind.INVARIANT
            else self._of_formula(plan, formulas[plan.name])
            if plan.kind is MonitorKind.STL
            else _of_measure(plan, None if self._cut_short else measures.get(plan.text))
            for plan in self._plans
        )

    def violations(self) -> tuple[Violation, ...]:
        """Return the violations of all monitors that judge during the run, in plan order."""
        formulas = {plan.name: formula for plan, formula in self._formulas}
        found = []
        for plan in self._plans:
            if plan.kind is MonitorKind.INVARIANT:
                gauge = self._invariants.gauges[plan.text]
                first_ns, at_ns = gauge.first_ns, gauge.at_ns
            elif plan.name in self._first_ns:
                first_ns, at_ns = self._first_ns[plan.name], formulas[plan.name].at_ns
            else:
                continue
            if first_ns != NEVER_NS:
                begin_ns = max(self._context.start_ns, min(first_ns, at_ns) - AROUND_NS)
                end_ns = max(first_ns, at_ns) + AROUND_NS
                found.append(Violation(plan.name, first_ns, begin_ns, end_ns))
        return tuple(found)

    def _of_gauge(self, plan: MonitorPlan, gauge: Gauge) -> MonitorResult:
        if gauge.at_ns == NEVER_NS:
            return _result(plan, Verdict.VACUOUS, None, None, _join_words(NEVER_HELD, gauge.note))
        verdict = Verdict.PASS if gauge.least >= 0.0 else Verdict.FAIL
        first = ""
        if gauge.first_ns not in (NEVER_NS, gauge.at_ns):
            first = f"first at {self._seconds(gauge.first_ns):.2f} s"
        at_s = self._seconds(gauge.at_ns)
        return _result(plan, verdict, gauge.least, at_s, _join_words(first, gauge.note))

    def _of_formula(self, plan: MonitorPlan, formula: Formula) -> MonitorResult:
        margin: float | None = formula.margin
        at_s: float | None = self._seconds(formula.at_ns)
        if not math.isfinite(formula.margin):
            margin = at_s = None
        if formula.state is TermState.VIOLATED:
            known_ns = self._first_ns.get(plan.name, formula.at_ns)
            known = f"known at {self._seconds(known_ns):.2f} s" if known_ns != formula.at_ns else ""
            return _result(plan, Verdict.FAIL, margin, at_s, known)
        if formula.broken:
            return _result(plan, Verdict.INCONCLUSIVE, None, None, formula.broken)
        if formula.state is not TermState.HOLDS:
            detail = "the run ended before the result was certain"
            return _result(plan, Verdict.INCONCLUSIVE, margin, at_s, detail)
        if formula.vacuous:
            return _result(plan, Verdict.VACUOUS, None, None, formula.vacuous)
        return _result(plan, Verdict.PASS, margin, at_s, "")

    def _seconds(self, at_ns: int) -> float:
        return (at_ns - self._context.start_ns) / NS_PER_S


def _of_measure(plan: MonitorPlan, value: float | None) -> MonitorResult:
    if value is None or not math.isfinite(value):
        detail = f"{plan.text} was not measured, or only for a part of the run"
        return _result(plan, Verdict.INCONCLUSIVE, None, None, detail)
    low, high = plan.limits
    margins = [*([] if low is None else [value - low]), *([] if high is None else [high - value])]
    margin = min(margins)
    verdict = Verdict.PASS if margin >= 0.0 else Verdict.FAIL
    return _result(plan, verdict, margin, None, f"{plan.text} is {value:.6g}")


def _result(
    plan: MonitorPlan, verdict: Verdict, margin: float | None, at_s: float | None, detail: str
) -> MonitorResult:
    if margin is not None and abs(margin) < TINY:
        margin = 0.0
    return MonitorResult(
        name=plan.name,
        verdict=verdict,
        margin=margin,
        unit=plan.unit,
        at_s=at_s,
        detail=detail,
        requirements=plan.requirements,
        asked=plan.asked,
        own=plan.own,
    )


def _join_words(*words: str) -> str:
    return "; ".join(word for word in words if word)
