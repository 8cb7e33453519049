"""Runs a case in real time to its end: receives, judges and applies faults without long waits."""

import select
import signal
import socket
from collections.abc import Callable, Mapping
from typing import Final

from can_dbc.vobc import AtoPhase
from firmware_py.clock.clock import Clock
from metro_hil.model.case import Case, CaseEvent
from metro_hil.model.case_setup import CaseParts
from metro_hil.model.subprocesses import Process
from metro_hil.monitors import MonitorSet
from metro_hil.realtime.actors import ControllerActor
from metro_hil.realtime.attribution import START_UP_S, RunWindow
from metro_hil.realtime.ends import STUCK_S, Pulse, TrueMotion, over
from metro_hil.realtime.fault_watch import FaultWatch
from metro_hil.realtime.feed_socket import tell
from metro_hil.realtime.host import HostRecord
from metro_hil.realtime.observer import BRAKE_ID, STATUS_ID, RunObserver
from metro_hil.realtime.process_faults import ProcessFaults
from metro_hil.realtime.setup import PreparedCase
from metro_hil.realtime.wires import Blocked
from plant_emulator.faults.feed import FaultChange, pack_change, read_message
from plant_emulator.faults.kinds import FaultPlace
from plant_emulator.faults.plan import FaultPlan
from plant_emulator.faults.schedule import Schedule
from plant_emulator.truth import Truth

TICK_S: Final = 0.02
START_S: Final = 20.0
"""Time within which train and controller have to send their first frames."""
DRAIN_S: Final = 0.1
"""Time after an end in which the taps receive the last frames."""
RADIO_TRIES: Final = 3
ENVIRONMENT_EXIT: Final = 3
VITAL_MS: Final = 50.0
EVENTS_MAX: Final = 500
SAMPLE_GAP_S: Final = 0.015
"""Longest gap between two samples of truth; the plant takes a step every 10 ms."""
EXCUSED_AFTER_S: Final = 1.0
NS_PER_S: Final = 1_000_000_000


class Conduct:
    """Runs one case from its first frame to its last."""

    def __init__(
        self,
        case: Case,
        made: CaseParts,
        stage: PreparedCase,
        monitors: MonitorSet,
        host: HostRecord,
        clock: Clock,
    ) -> None:
        self._case, self._stage, self._monitors = case, stage, monitors
        self._host, self._clock = host, clock
        slow_status = case.controller.kind != "command" and case.setup.cycle_ms > VITAL_MS
        self.hearing = RunObserver(
            monitors,
            train=stage.train_tap,
            controller=stage.controller_tap,
            # A slow controller repeats its commands between its cycles, but not its status.
            cycle_id=STATUS_ID if slow_status else BRAKE_ID,
            on_cycle=self._cycle_heard,
        )
        journey = made.journey
        dwell_s = max((station.dwell_s for station in journey.stops), default=0.0)
        self.motion = TrueMotion(stop_m=journey.end.stop_m, patience_s=STUCK_S + dwell_s)
        self.pulse = Pulse()
        self.faults = FaultWatch(made.faults)
        self.events: list[CaseEvent] = []
        self.blind: list[RunWindow] = []
        self.excused: list[RunWindow] = []
        """Stretches in which a fault of the process acted."""
        self.reason = ""
        self._sender = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._plant: Process | None = None
        self.controller: ControllerActor | None = None
        self._process_faults: ProcessFaults | None = None
        self._restarted_ns: int | None = None
        self._truth_s: float | None = None
        self._began_ns = self._looked_ns = clock.now_ns()
        self._second_ns = self._began_ns
        self._excused_second = False
        self._lost_to_fault = False
        self._state = ""
        self.ended_by: signal.Signals | int | None = None
        """Signal or exit code of a controller that ended by itself."""
        recording = made.scenario.desk_recording
        self._desk_until_s = 0.0 if recording is None else recording.end_s
        self._schedule = Schedule(made.faults)
        self._schedule.listen(self._changed_by_time)

    def run(self) -> None:
        """Run the case. Raises Blocked when it cannot start or the bench itself fails."""
        try:
            self._bring_up()
            self._began_ns = self._second_ns = self._looked_ns = self._clock.now_ns()
            while not self.reason:
                self._turn()
                self._check_bench()
                self.reason = self._over()
            self._note(f"over: {self.reason}")
            # A disturbance by the host just before the end may have caused the end.
            self._close_second(self._looked_ns)
            self.hearing.finish()
        finally:
            self._bring_down()
            self._sender.close()

    def _bring_up(self) -> None:
        stage = self._stage
        early = self._case.controller.kind != "command"
        for attempt in range(RADIO_TRIES):
            if stage.parts.plant:
                self._plant = stage.start_plant()
            if stage.parts.controller and (early or self._plant is None):
                self._take_controller(stage.start_controller())
            if self._await(self._truth_there, may_fail=attempt < RADIO_TRIES - 1):
                break
            # Another case took the radio's port after it was chosen and before its use.
            if self.controller is not None:
                self.controller.kill()
        if stage.parts.controller and self.controller is None:
            self._take_controller(stage.start_controller())
        self._await(lambda: self.hearing.controller_heard)
        if self.hearing.origin_ns is None:
            self.hearing.origin_ns = self._clock.now_ns()

    def _take_controller(self, controller: ControllerActor) -> None:
        self.controller = controller
        self._process_faults = ProcessFaults(controller)

    def _truth_there(self) -> bool:
        return self._plant is None or self.hearing.origin_ns is not None

    def _await(self, there: Callable[[], bool], *, may_fail: bool = False) -> bool:
        """Wait until `there` holds.

        Return False only if the radio's port was taken and may be tried again.
        """
        until_ns = self._clock.now_ns() + round(START_S * NS_PER_S)
        while not there():
            self._turn()
            plant, controller = self._plant, self.controller
            if plant is not None and plant.ended:
                if may_fail and plant.returncode == ENVIRONMENT_EXIT:
                    self._stage.cast.end(plant)
                    return False
                raise Blocked(f"the plant emulator did not start: {plant.failure_words()}")
            if controller is not None and controller.ended_by is not None and not self._killed:
                raise Blocked(f"the controller did not start: {controller.end_words()}")
            if self._clock.now_ns() > until_ns:
                if plant is not None and self.hearing.origin_ns is None:
                    raise Blocked(f"no truth came from the plant within {START_S:.0f} s")
                if self._killed:
                    break
                words = "" if controller is None else f": {controller.last_words()}"
                raise Blocked(f"the controller sent nothing within {START_S:.0f} s{words}")
        return True

    @property
    def _killed(self) -> bool:
        return self._process_faults is not None and self._process_faults.killed

    def _turn(self) -> None:
        """Process everything that has arrived; wait for truth, but at most one tick."""
        faults, feed = self._process_faults, self._stage.feed
        waiting: list[int] = [] if feed is None else [feed.fileno()]
        wait_s = TICK_S
        if faults is not None:
            if faults.slow:
                waiting.append(getattr(self._stage.controller_tap.port, "fileno")())  # noqa: B009
            if faults.next_ns is not None:
                left_ns = faults.next_ns - self._clock.now_ns()
                wait_s = min(wait_s, max(0.0, left_ns / NS_PER_S))
        select.select(waiting, [], [], wait_s)
        now_ns = self._clock.now_ns()
        self._host.bench_late(max(0, now_ns - self._looked_ns - round(TICK_S * NS_PER_S)))
        self._looked_ns = now_ns
        if feed is not None:
            for sent_ns, message in feed.receive(now_ns):
                self._take_message(message, sent_ns, now_ns)
        elif self.hearing.origin_ns is not None:
            self._tell_time(now_ns)
        self.hearing.frames(now_ns)
        if faults is not None:
            faults.poll(now_ns)
            if faults.started_ns != self._restarted_ns:
                self._restarted_ns = faults.started_ns
                self.hearing.await_start()
            self._excused_second = self._excused_second or faults.acting(now_ns)
        self.hearing.judge(now_ns)
        self._tell_state()
        if now_ns - self._second_ns >= NS_PER_S:
            self._close_second(now_ns)

    def _take_message(self, message: bytes, sent_ns: int, now_ns: int) -> None:
        heard = read_message(message)
        if heard is None:
            return
        if isinstance(heard, FaultChange):
            plan = self.faults.plan(heard.index)
            if plan is not None:
                self._change(plan, heard.active, now_ns, message)
            return
        truth, stamp_ns = heard.truth, heard.now_ns
        self._host.truth(truth.t_s, max(0, sent_ns - stamp_ns))
        self.motion.take(truth)
        self._note_blindness(truth)
        self.hearing.truth(truth, stamp_ns)

    def _note_blindness(self, truth: Truth) -> None:
        last_s, self._truth_s = self._truth_s, truth.t_s
        at_rest = truth.t_s < START_UP_S and self.motion.moved_m == 0.0
        # Starting processes delay each other, which does not matter while the train stands.
        if last_s is not None and truth.t_s - last_s > SAMPLE_GAP_S and not at_rest:
            self.blind.append(RunWindow(last_s, truth.t_s))

    def _tell_time(self, now_ns: int) -> None:
        """Let faults begin and end by the bench's own time if the bench does not run the plant."""
        clock, hearing = Truth(), self.hearing
        clock.t_s = self._run_s(now_ns)
        status, position = hearing.status, hearing.position
        self.motion.believe(
            clock.t_s,
            None if position is None else position.front_m,
            doors_open=status is not None and status.ato_phase is AtoPhase.DOORS_OPEN,
        )
        self._schedule.step(clock, now_ns)
        # Monitors of bus frames receive the time as their only truth.
        self.hearing.truth(clock, now_ns)

    def _changed_by_time(self, plan: FaultPlan, active: bool, now_ns: int) -> None:
        message = pack_change(plan.index, active, now_ns)
        self._change(plan, active, now_ns, message)

    def _change(self, plan: FaultPlan, active: bool, now_ns: int, message: bytes) -> None:
        self.faults.change(plan, active)
        self._note(f"fault {plan.kind.name} {'begins' if active else 'ends'}")
        if plan.kind.place is FaultPlace.BUS and not tell(
            self._sender, self._stage.gateway_control, message
        ):
            raise Blocked(
                f"the gateway did not take the message that {plan.kind.name} begins or ends"
            )
        if self._process_faults is not None:
            try:
                self._process_faults.change(plan, active, now_ns)
            except Blocked as problem:
                self._note(str(problem))

    def _cycle_heard(self, stamp_ns: int) -> None:
        if self._process_faults is not None:
            self._process_faults.cycle_heard(self._clock.now_ns())

    def _check_bench(self) -> None:
        """Raise Blocked if the plant, the gateway or a bus has gone."""
        stage = self._stage
        for process in (self._plant, stage.gateway):
            if process is not None and process.ended:
                raise Blocked(f"the {process.name} ended by itself: {process.failure_words()}")
        for tap in (stage.controller_tap, stage.train_tap):
            if not tap.alive:
                raise Blocked("the bus is gone: its hub ended, or its interface went down")

    def _over(self) -> str:
        now_ns, faults, controller = self._looked_ns, self._process_faults, self.controller
        ended = controller is not None and controller.ended_by is not None
        excused = faults is not None and faults.acting(now_ns)
        if ended and excused and controller is not None:
            # A process that a fault delayed may be ended by its own watchdog; that is the fault's
            # effect.
            self._note(f"the controller ended while it was held up ({controller.end_words()})")
            controller.end()
            self._lost_to_fault = True
            ended = False
        found_dead = self.pulse.check(
            now_ns,
            ended=controller.end_words() if ended and controller is not None else "",
            last_ns=self.hearing.controller_last_ns,
            restarted_ns=None if faults is None else faults.started_ns,
            excused=excused or self._lost,
        )
        if found_dead:
            self.ended_by = None if controller is None else controller.ended_by
            self._note(f"the controller died: {self.pulse.died}")
        return over(
            self.motion,
            self.pulse,
            now_ns,
            began_ns=self._began_ns,
            duration_s=self._case.setup.duration_s,
            violated=self._case.stop_at_violation and self._monitors.violated is not None,
            killed_for_good=self._lost,
            pending=self.faults.pending or self._run_s(now_ns) < self._desk_until_s,
            truth_known=self._stage.parts.plant,
        )

    @property
    def touched(self) -> Mapping[int, int]:
        """How often each fault delayed or ended the controller's process, by index of the fault."""
        return {} if self._process_faults is None else self._process_faults.touched

    @property
    def died_s(self) -> float:
        """Time at which the controller was found dead, in the plant's time."""
        return self._run_s(self.pulse.died_ns)

    @property
    def crashed(self) -> bool:
        """Whether the controller's process ended, and not by its own watchdog."""
        return self.ended_by is not None and self.ended_by is not signal.SIGALRM

    @property
    def _lost(self) -> bool:
        """Whether a fault of the scenario ended the controller and will not start it again."""
        faults = self._process_faults
        return self._lost_to_fault or (faults is not None and faults.for_good)

    def _tell_state(self) -> None:
        """Record the state that the controller reports whenever it changes."""
        status = self.hearing.status
        if status is None:
            return
        words = (
            f"protection {_spoken(status.supervision.name)}; "
            f"operation {_spoken(status.ato_phase.name)}"
        )
        if words != self._state:
            self._state = words
            self._note(words)

    def _close_second(self, now_ns: int) -> None:
        run_s = self._run_s(now_ns)
        if self.hearing.origin_ns is None:
            self._second_ns = now_ns
            return
        if self._excused_second:
            begin_s = self._run_s(self._second_ns)
            self.excused.append(RunWindow(begin_s - 1.0, run_s + EXCUSED_AFTER_S))
        pid = None if self.controller is None else self.controller.pid
        self._host.sample(run_s, pid, self._carriers, excused=self._excused_second)
        self._second_ns, self._excused_second = now_ns, False

    @property
    def _carriers(self) -> tuple[int, ...]:
        """Processes that carry frames between controller and train."""
        gateway = self._stage.gateway
        return (*self._stage.segments.hubs, *([] if gateway is None else [gateway.pid]))

    def _run_s(self, now_ns: int) -> float:
        origin_ns = self.hearing.origin_ns
        return 0.0 if origin_ns is None else (now_ns - origin_ns) / NS_PER_S

    def _note(self, words: str) -> None:
        if len(self.events) < EVENTS_MAX:
            self.events.append(CaseEvent(round(self._run_s(self._clock.now_ns()), 3), words))

    def _bring_down(self) -> None:
        """End the controller first, so that the taps still receive its safe output."""
        if self.controller is not None:
            self.controller.end()
        self._drain()
        for process in (self._plant, self._stage.gateway):
            if process is not None:
                self._stage.cast.end(process)
                self._drain()

    def _drain(self) -> None:
        self._clock.wait_until(self._clock.now_ns() + round(DRAIN_S * NS_PER_S))
        self.hearing.frames(self._clock.now_ns())


def _spoken(name: str) -> str:
    return name.lower().replace("_", " ")
