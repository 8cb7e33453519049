"""One case on the lockstep bench, from its start to its verdict."""

import math
import traceback
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from can_dbc.nodes import Node
from firmware_py.clock.clock import WallClock
from firmware_py.expression import compile_expression
from firmware_py.settings import SettingsError
from firmware_py.storage.errors import RecorderError
from firmware_py.storage.recorder import loss_text
from metro_hil.external_controller import ControllerDiedError
from metro_hil.foreign_plant.plant import PlantDiedError
from metro_hil.metrics.brake_reports import BrakeReports
from metro_hil.metrics.case import MemoryLog, motion_measures
from metro_hil.metrics.comfort import CommandLog, inertia_of
from metro_hil.metrics.fastest_run import journey_fastest_s
from metro_hil.metrics.notches import NotchLog
from metro_hil.model.case import (
    Case,
    CaseEvent,
    CaseResult,
    ControllerSpec,
    FaultResult,
    Host,
    Verdict,
)
from metro_hil.model.case_setup import NO_FILES, CaseParts, Files, parts_of
from metro_hil.model.end_condition import ARRIVED
from metro_hil.model.frame_hash import FrameHash
from metro_hil.model.run_folder import RunFolder
from metro_hil.model.verdict import RunEvidence, judge
from metro_hil.monitors import Context, MonitorSet, plans_of
from metro_hil.run.lockstep import Lockstep, Taps
from plant_emulator.faults.declared_process import ClockStep
from plant_emulator.faults.fitting import check_provided
from plant_emulator.faults.kinds import BENCH_PLACES, FaultPlace
from plant_emulator.faults.plan import FaultPlan
from plant_emulator.power.box import J_PER_KWH
from plant_emulator.truth import SIGNALS, Truth
from plant_emulator.wayside.interlocking import Interlocking, SharedNetwork
from plant_emulator.world import STEP_NS
from vobc.vocabulary import CycleOutput
from zenoh_config.messages import MovementAuthority

if TYPE_CHECKING:
    # Only trains that command themselves need this module.
    from vobc.process.line_command import LineCommand

NS_PER_S: Final = 1_000_000_000
MS_PER_S: Final = 1000.0
INPUT_AGE_S: Final = 0.25
"""Greatest delay by which faults may age an input that the controller still accepts, s."""
STUCK_S: Final = 60.0
"""Time after the longest dwell for which a train may stand without a pending fault, s; it counts as
stuck then."""
AFTER_DEATH_S: Final = 180.0
"""How long the run follows the train after its controller died, until it stands, s."""
EVENTS_MAX: Final = 500

CONTROLLER_MODULE: Final = "vobc."
BENCH_MODULES: Final = ("metro_hil.", "plant_emulator.")

STUCK: Final = "stands for good"
DURATION: Final = "duration over"
VIOLATION: Final = "stopped at the first violation"
DIED: Final = "the controller died"


def run_alone(
    case: Case, *, files: Files = NO_FILES, folder: RunFolder | None = None
) -> CaseResult:
    """Run one case on the lockstep bench to its end and judge it."""
    began_ns = WallClock().now_ns()
    try:
        run = CaseRun(case, parts_of(case, files), folder)
    except SettingsError as error:
        return blocked(case, error)
    try:
        try:
            if run.bench.foreign is not None:
                check_provided(run.parts.faults, run.bench.foreign)
            if case.branch is not None:
                run.to_branch()
                run.become(case, run.parts.faults)
            run.to_end()
        finally:
            run.close()
    except (PlantDiedError, SettingsError) as error:
        return blocked(case, error)
    if lost := run.bench.lost_log_lines:
        raise RecorderError(loss_text(lost))
    return run.result(began_ns)


def blocked(case: Case, error: Exception) -> CaseResult:
    """The result of a case that cannot run."""
    return CaseResult(case_id=case.id, index=case.index, verdict=Verdict.BLOCKED, reason=str(error))


class CaseRun:
    """A running case."""

    def __init__(
        self,
        case: Case,
        parts: CaseParts,
        folder: RunFolder | None,
        places: frozenset[FaultPlace] = frozenset(),
        shared: SharedNetwork | None = None,
        command: "LineCommand | None" = None,
    ) -> None:
        """Args:
        places: places where faults of other cases may act that continue from a copy of this run.
        shared: the network that the train shares with others.
        command: train-to-train control. Authorities then come only from it.
        """
        self.case = case
        self.parts = parts
        self.truth = Truth()
        """True state of the train after the last step of the plant."""
        self._chain = FrameHash()
        self.rows = MemoryLog()
        self.metered_before_j = (0.0, 0.0)
        """Energies drawn and returned that the train's meter counted before this run."""
        self._commands = CommandLog(inertia_of(parts.scenario.train))
        self._notches = NotchLog()
        self._brake_reports = BrakeReports()
        self._bounds: list[tuple[float, float]] = []
        own_port, input_age_s = hearing_of(parts.faults, places)
        later = bool(places)
        places |= {plan.kind.place for plan in parts.faults}
        context = _context(case, parts, input_age_s=input_age_s, commanded=command is not None)
        self._monitors = MonitorSet(plans_of(case), context, own_port=own_port)
        self.bench = Lockstep(
            parts.config,
            parts.scenario,
            parts.journey,
            folder,
            faults=() if case.branch else parts.faults,
            places=places,
            reports=later,
            taps=Taps(
                frame=self._frame,
                said=self._monitors.said if own_port else None,
                truth=self._truth,
                rows=self.rows,
                radio=self._monitors.radio,
            ),
            controller=case.controller,
            plant=case.plant,
            shared=shared,
            command=command,
        )
        self._events: list[CaseEvent] = []
        self._output: CycleOutput | None = None
        self._said: object = None
        self._start_m = parts.journey.start.stop_m
        self._moved_m = 0.0
        self._still_s: float | None = None
        when = None if case.branch is None else case.branch.when
        self._branch = None if when is None else compile_expression(when, SIGNALS)
        self._branched = False
        self._wall = WallClock()
        self._stepping_ns = 0
        self._reason = ""
        self._died = ""
        self._patience_s = _patience_s(parts)
        self.bench.plant.schedule.listen(self._fault_changed)

    def _frame(self, stamp_ns: int, can_id: int, data: bytes) -> None:
        self._chain.frame(stamp_ns, can_id, data)
        self._monitors.frame(stamp_ns, can_id, data)
        self._notches.frame(stamp_ns, can_id, data)
        self._brake_reports.frame(stamp_ns, can_id, data)

    def obeys(self, authority: MovementAuthority) -> None:
        """Take an authority of masters, on which the controller may act from now on."""
        self._monitors.authority(authority)

    def _truth(self, truth: Truth, now_ns: int) -> None:
        self.truth = truth
        self._monitors.sample(truth, now_ns)
        if truth.speed_mps == 0.0:
            if self._still_s is None:
                self._still_s = truth.t_s
        else:
            self._still_s = None
        moved_m = abs(truth.front_m - self._start_m)
        if moved_m > self._moved_m:
            self._moved_m = moved_m
        output = self.bench.vobc.output
        if output is not self._output:
            self._output = output
            self._commands.output(truth.t_s, output)
            if output.motion is not None:
                front = output.motion.front_m
                self._bounds.append((truth.t_s, (front.high - front.low) / 2.0))
            self._note_state(truth.t_s, output)
        if self._branch is not None and not self._branched and self._branch(truth):
            self._branched = True

    def _note_state(self, t_s: float, output: CycleOutput) -> None:
        said = (output.supervision, output.cause, output.ato_phase)
        if said == self._said:
            return
        self._said = said
        state = output.supervision.name.lower().replace("_", " ")
        phase = output.ato_phase.name.lower().replace("_", " ")
        cause = f": {output.cause}" if output.cause else ""
        self._note(t_s, f"protection {state}{cause}; operation {phase}")

    def _note(self, t_s: float, words: str) -> None:
        if len(self._events) < EVENTS_MAX:
            self._events.append(CaseEvent(t_s, words))

    def _fault_changed(self, plan: FaultPlan, active: bool, now_ns: int) -> None:
        words = f"fault {plan.kind.name} {'begins' if active else 'ends'}"
        self._note(now_ns / NS_PER_S, words)

    def to_branch(self) -> bool:
        """Run to the branch; False if the run never reaches it."""
        limit_ns = round(self.case.setup.duration_s * NS_PER_S)
        self._run_until(
            lambda now_ns: (
                self._over(now_ns, limit_ns) or (self._branched and now_ns % STEP_NS == 0)
            )
        )
        return self._branched

    def become(self, case: Case, faults: Sequence[FaultPlan]) -> None:
        """At the branch: continue as the run of the given case."""
        self.case = case
        self._stepping_ns = 0
        if self._branched:
            self.bench.reseed(case.seed)
            self.bench.plant.schedule.plan(faults)

    def warm_up(self) -> None:
        """Load modules that only the end of a run needs, so that copies of this process have
        them."""
        self._measures()

    def to_end(self) -> None:
        """Run until the case is over. If the controller dies, the train rolls on without it."""
        if self._died:
            return
        limit_ns = round(self.case.setup.duration_s * NS_PER_S)
        self._run_until(lambda now_ns: self._over(now_ns, limit_ns))

    def _run_until(self, over: Callable[[int], bool]) -> None:
        began_ns = self._wall.now_ns()
        try:
            self.bench.run_until(over)
        except Exception as error:
            self.bury(error)
            self._follow_to_standstill()
        self._stepping_ns += self._wall.now_ns() - began_ns

    def bury(self, error: Exception) -> None:
        """Record that the controller died and continue without it; raise errors of the bench
        again."""
        if not _raised_by_controller(error):
            raise error
        self._died = _last_line(error)
        self._reason = DIED
        self._note(self.bench.clock.now_ns() / NS_PER_S, self._died)
        self.bench.without_controller()

    @property
    def reason(self) -> str:
        """How the run ended; empty while it goes on."""
        return self._reason

    @property
    def violated(self) -> bool:
        """Whether a violation ends the run."""
        return self.case.stop_at_violation and self._monitors.violated is not None

    def end(self, reason: str) -> None:
        """Record how the run ended, unless its controller died."""
        self._reason = self._reason or reason

    @property
    def moved_m(self) -> float:
        """Greatest distance of the train from its start."""
        return self._moved_m

    @property
    def died(self) -> str:
        """How the controller ended by itself; empty while it runs."""
        return self._died

    def _follow_to_standstill(self) -> None:
        bench = self.bench
        limit_ns = bench.clock.now_ns() + round(AFTER_DEATH_S * NS_PER_S)
        bench.run_until(lambda now_ns: now_ns >= limit_ns or self._still_s is not None)

    def _over(self, now_ns: int, limit_ns: int) -> bool:
        if now_ns % STEP_NS:
            # A run ends only at steps of the plant, so that no other task decides when.
            return False
        if self.violated:
            self._reason = VIOLATION
        elif self.bench.arrived:
            self._reason = ARRIVED
        elif now_ns >= limit_ns:
            self._reason = DURATION
        elif (
            self._still_s is not None
            and now_ns / NS_PER_S - self._still_s > self._patience_s
            and not self.bench.plant.pending
        ):
            self._reason = STUCK
        return self._reason != ""

    def close(self) -> None:
        try:
            self.bench.close()
        except Exception as error:
            try:
                self.bury(error)
            finally:
                # Close processes and logs, whichever side raised.
                self.bench.without_controller()
                self.bench.close()
        self._monitors.finish(self._reason == VIOLATION)

    def result(self, began_ns: int | None = None) -> CaseResult:
        """Judge the run. Call it after `close`.

        Args:
            began_ns: start of the run on the wall clock.
        """
        case, bench = self.case, self.bench
        measures = self._measures()
        monitors = self._monitors.results(measures)
        faults = self._faults()
        judgement = judge(
            case,
            RunEvidence(
                monitors=monitors,
                faults=faults,
                died=self._died,
                branched=self._branch is None or self._branched,
                moved_m=self._moved_m,
                violated=self._reason == VIOLATION,
            ),
        )
        return CaseResult(
            case_id=case.id,
            index=case.index,
            verdict=judgement.verdict,
            reason=judgement.reason,
            lacking=judgement.lacking,
            died=self._died,
            exit_reason=self._reason,
            sim_s=bench.clock.now_ns() / NS_PER_S,
            frames=self._chain.frames,
            chain=self._chain.value,
            monitors=monitors,
            faults=faults,
            measures=measures,
            events=self._all_events(),
            host=self._host(began_ns),
        )

    def _faults(self) -> tuple[FaultResult, ...]:
        schedule, touched = self.bench.plant.schedule, self.bench.touched
        idle = {plan.index for plan in schedule.never_began}
        return tuple(
            FaultResult(
                kind=plan.kind.name,
                began=plan.index not in idle,
                touched=touched[plan.index],
            )
            for plan in schedule.plans
        )

    def _host(self, began_ns: int | None) -> Host:
        if began_ns is None:
            return Host()
        wall_s = (self._wall.now_ns() - began_ns) / NS_PER_S
        return Host(wall_s=wall_s, stepping_s=self._stepping_ns / NS_PER_S)

    def _all_events(self) -> tuple[CaseEvent, ...]:
        """All recorded events, in order of time."""
        told = [CaseEvent(at_ns / NS_PER_S, what) for at_ns, what in self.bench.bus_story()]
        told += [CaseEvent(*report) for report in self._brake_reports.found]
        both = sorted([*self._events, *told], key=lambda event: event.at_s)
        return tuple(both[:EVENTS_MAX])

    def _measures(self) -> dict[str, float | None]:
        bench, parts = self.bench, self.parts
        truth = self.rows.columns()
        journey, fastest_s = parts.journey, journey_fastest_s(parts.journey, parts.config.ato)
        measures = motion_measures(
            truth, journey.stops, journey.planned_run_s, fastest_s, self._bounds
        )
        measures |= self._notches.measures(truth)
        power, elapsed_ns = bench.plant.world.power, bench.clock.now_ns()
        if self.case.controller.kind == ControllerSpec().kind:
            # Of an external controller only the frames are known, not its internal demand.
            asked_mps2, asked_mps3 = self._commands.worst()
            measures["commanded_accel_max_mps2"] = asked_mps2
            measures["commanded_jerk_max_mps3"] = asked_mps3
        measures["arrived_count"] = float(bench.arrived)
        foreign = bench.foreign
        metered = foreign is None or foreign.nodes.isdisjoint({Node.TCU, Node.BCU, Node.HVB})
        drawn_j, returned_j = self.metered_before_j
        drawn_j, returned_j = power.drawn_j - drawn_j, power.returned_j - returned_j
        measures["energy_drawn_kwh"] = drawn_j / J_PER_KWH if metered else None
        measures["energy_returned_kwh"] = returned_j / J_PER_KWH if metered else None
        measures["brake_reports_count"] = float(len(self._brake_reports.found))
        measures["controller_slips_count"] = float(getattr(bench.vobc, "slips", 0))
        measures["rejected_frames_count"] = float(sum(bench.plant.wire.refusals.values()))
        measures["bus_load_ratio"] = bench.bus.statistics().load_ratio(max(1, elapsed_ns))
        return measures | _route_measures(bench.plant.railway.interlocking)


def _route_measures(routes: Interlocking | None) -> dict[str, float | None]:
    """Measures of an interlocking; None without switches."""
    moved = None if routes is None else float(sum(each.moves for each in routes.machines.values()))
    refused = None if routes is None else float(routes.refusals)
    return {"switches_moved_count": moved, "routes_refused_count": refused}


def _patience_s(parts: CaseParts) -> float:
    """Time for which a train may stand before it counts as stuck."""
    dwells_s = [station.dwell_s for station in parts.journey.stops]
    return STUCK_S + parts.scenario.layover_s + max(dwells_s, default=0.0)


def hearing_of(
    faults: Sequence[FaultPlan], places: frozenset[FaultPlace] = frozenset()
) -> tuple[bool, float]:
    """Whether monitors listen at the controller's own port, and the greatest age of its inputs, s.

    They listen there if a fault may change what the controller sends. A clock that jumps ahead
    makes all earlier inputs older.

    Args:
        places: further places where faults may act.
    """
    if BENCH_PLACES.isdisjoint({*places, *(plan.kind.place for plan in faults)}):
        return False, 0.0
    jumps = (plan.parameters for plan in faults if isinstance(plan.parameters, ClockStep))
    return True, INPUT_AGE_S + math.fsum(jump.step_s for jump in jumps)


def _raised_by_controller(error: BaseException) -> bool:
    """Whether the controller raised the error, and not the bench that it called."""
    if isinstance(error, ControllerDiedError):
        return True
    innermost = ""
    for frame, _ in traceback.walk_tb(error.__traceback__):
        name: str = frame.f_globals.get("__name__", "")
        if name.startswith((CONTROLLER_MODULE, *BENCH_MODULES)):
            innermost = name
    return innermost.startswith(CONTROLLER_MODULE)


def _last_line(error: BaseException) -> str:
    if isinstance(error, ControllerDiedError):
        return str(error)
    return traceback.format_exception_only(error)[-1].strip()


def _context(case: Case, parts: CaseParts, *, input_age_s: float, commanded: bool) -> Context:
    """What the monitors know of the run."""
    context = Context(
        line=parts.scenario.line,
        train=parts.scenario.train,
        cycle_s=case.setup.cycle_ms / MS_PER_S,
        input_age_s=input_age_s,
        localisation_limit_m=parts.config.odometry.localisation_limit_m,
    )
    if commanded:
        # The line agrees on a maximum age of its own.
        context = replace(context, authority_age_s=parts.config.atp.authority_age_max_s)
    return context
