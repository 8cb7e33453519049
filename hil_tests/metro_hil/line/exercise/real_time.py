"""A line in real time: processes over real zenoh, watched and recorded by an own session."""

import itertools
import signal
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Final, NamedTuple

from firmware_py.clock.clock import WallClock
from firmware_py.interrupts import Interrupts
from firmware_py.ports import RadioPort
from firmware_py.radio.credentials import load_credentials
from firmware_py.radio.line_keys import line_keys
from firmware_py.radio.zenoh_radio import SessionRole, open_radio
from firmware_py.trackdb import LineMap
from firmware_py.trackdb.areas import AreaMap
from metro_hil.line.exercise.event_log import OLD, LineEvents
from metro_hil.line.exercise.observer import LAG_NS, Observer
from metro_hil.line.exercise.plan import CUTS, Fault, PlannedRun, Strike
from metro_hil.line.exercise.processes import WAYSIDE, LineProcesses
from metro_hil.line.exercise.record import LineRunFiles
from metro_hil.line.exercise.schedule import FaultSchedule
from metro_hil.line.exercise.taps import ProtectionTap
from metro_hil.line.network.options import OwnNetworks
from metro_hil.line.network.topology import Topology
from metro_hil.model.subprocesses import ChildError
from zenoh_config import t2t_keys
from zenoh_config.secured import SUPERVISION_NAME
from zenoh_config.t2t import NO_TRAIN

POLL_NS: Final = 20_000_000
NS_PER_S: Final = 1_000_000_000
START_S: Final = 60.0
RECONNECT_S: Final = 10.0
"""Time within which all programs reach a restarted wayside again."""
INBOX_MESSAGES: Final = 1 << 16


class Settings(NamedTuple):
    line: LineMap
    areas: AreaMap
    line_name: str
    """Name or file, as requested by the user."""
    ways: list[PlannedRun]
    endpoint: str
    timers: str
    arbiters: int
    faults: list[Fault]
    down_s: float
    """Time for which a struck program is down."""
    duration_s: float
    priority: int
    secure: Path | None = None
    """Certificates and keys; None: the line is not secured."""
    networks: OwnNetworks | None = None
    """None: all programs share one network."""
    topology: Topology = Topology.STAR


class RealLine:
    """Starts everything, strikes as planned, and ends everything that it started."""

    def __init__(self, settings: Settings, folder: Path, say: Callable[[float, str], None]) -> None:
        self._settings, self._folder = settings, folder
        self._clock = WallClock()
        self._start_ns = self._clock.now_ns()
        self._secure = None
        if settings.secure is not None:
            self._secure = load_credentials(
                settings.secure, SUPERVISION_NAME, self._clock.epoch_ns()
            )
        key = line_keys(self._secure)
        self.record = LineRunFiles(folder, say)
        self._tell = self.record.tell
        self.story = LineEvents(settings.line, settings.areas, self._tell, key)
        self.dropped = 0
        """Messages that the recorder lost."""
        self.doubts: list[str] = []
        """Reasons why the run proves nothing, whatever the event log says."""
        self._observer = Observer(self.story, len(settings.ways))
        self._emergencies = 0
        """Number of emergency brakes before the run begins."""
        self._back_ns: int | None = None
        """Instant of the wayside's return, until all trains are received again."""
        self.carried: dict[str, dict[str, int]] = {}
        """Packet counts by direction, if trains had own networks."""
        self._schedule = FaultSchedule(settings.faults, settings.down_s)
        self._absent: set[str] = set()
        """Struck programs that are not back yet."""
        self._stopped: dict[str, int] = {}
        """Trains whose controllers were stopped for a while, by process name."""

    def run(self) -> bool:
        """Run the line; return whether it ran to its end.

        Raises BusError, RadioError, ChildError.
        """
        settings, interrupts = self._settings, Interrupts()
        with ExitStack() as stack:
            stack.enter_context(interrupts.caught())
            stack.callback(self.record.close)
            crew = LineProcesses(
                *(self._folder, settings.line_name, settings.endpoint, stack),
                timers=settings.timers,
                arbiters=settings.arbiters,
                relayed=any(each.strike is Strike.CUT_MASTER for each in settings.faults),
                trains=len(settings.ways),
                priority=settings.priority,
                secure=settings.secure,
                networks=settings.networks,
                topology=settings.topology,
            )
            crew.start_wayside()
            topics = t2t_keys.of_line(settings.areas.name)
            port = open_radio(
                *(SessionRole.TRAIN, settings.endpoint, topics, self._clock),
                inbox_messages=INBOX_MESSAGES,
                secure=self._secure,
            )
            stack.callback(port.close)
            for number, way in enumerate(settings.ways, start=1):
                crew.start_plant(number, way)
            numbers = range(1, len(settings.ways) + 1)
            taps = [crew.tap(number) for number in numbers]
            for number in numbers:
                crew.start_controller(number)
            return self._watch(crew, port, taps, interrupts)

    def _watch(
        self,
        crew: LineProcesses,
        port: RadioPort,
        taps: Sequence[ProtectionTap],
        interrupts: Interrupts,
    ) -> bool:
        """Watch the run; return whether it ran to its end."""
        began_ns: int | None = None
        done = False
        while not (done or interrupts.asked):
            self._clock.wait_until(self._clock.now_ns() + POLL_NS)
            now_ns = self._clock.now_ns()
            self._receive(port, taps, now_ns)
            self._check_processes(crew)
            if began_ns is None:
                self._observe_start(now_ns)
                began_ns = self._beginning(now_ns)
                if began_ns is not None:
                    self._observer.expects_from(now_ns)
                continue
            self._observe(now_ns)
            # Judging takes time, too, while the messages grow older.
            self._observe(self._clock.now_ns())
            done = now_ns - began_ns >= self._settings.duration_s * NS_PER_S
            if not done:
                self._schedule.step(now_ns, began_ns, lambda fault: self._apply_fault(crew, fault))
        if done:
            self._receive_rest(port, taps, self._clock.now_ns())
            self.carried = crew.carried()
        lost = {f"the tap on the bus of train {n}": tap.dropped for n, tap in enumerate(taps, 1)}
        self.doubts = self._observer.doubts({"the recorder": self.dropped, **lost})
        return done

    def _receive(self, port: RadioPort, taps: Sequence[ProtectionTap], now_ns: int) -> None:
        heard = port.receive(now_ns)
        self.record.on_message(heard)
        self.story.on_message(heard)
        for said in itertools.chain.from_iterable([tap.on_message(now_ns) for tap in taps]):
            self.story.tells(said.train, said.supervision, said.cause, said.at_ns)
        self.dropped = port.counters.dropped_in

    def _observe_start(self, now_ns: int) -> None:
        """Judge only emergency brakes while programs are starting."""
        emergencies = sum(len(train.emergencies) for train in self.story.trains.values())
        if emergencies > self._emergencies and self.story.newest_ns:
            self._observer.looks_at_newest(now_ns)
        self._emergencies = emergencies

    def _observe(self, now_ns: int) -> None:
        """Judge the run. The wayside carries all messages, so none is expected while it is away."""
        if WAYSIDE in self._absent:
            self._observer.expects_from(now_ns)
        elif self._back_ns is not None:
            late = now_ns - self._back_ns > RECONNECT_S * NS_PER_S
            if late or self._observer.has_all_until(self._back_ns):
                self._back_ns = None
            else:
                self._observer.expects_from(now_ns)
        self._observer.looks(now_ns)

    def _receive_rest(self, port: RadioPort, taps: Sequence[ProtectionTap], end_ns: int) -> None:
        """Take the messages that were sent before the end and are still on their way."""
        while not self._observer.has_all_until(end_ns) and self._clock.now_ns() < end_ns + LAG_NS:
            self._clock.wait_until(self._clock.now_ns() + POLL_NS)
            self._receive(port, taps, self._clock.now_ns())
        self._observer.ends(end_ns)

    def _beginning(self, now_ns: int) -> int | None:
        """Return the start of the run: all trains are commanded, or the time for that is over."""
        trains = len(self._settings.ways)
        commanded = sum(bool(each.given) for each in self.story.trains.values())
        if commanded == trains:
            begins = "the run begins: faults and --for count from here"
            self._tell(now_ns, f"all {trains} trains are commanded; {begins}")
            return now_ns
        if now_ns - self._start_ns > START_S * NS_PER_S:
            self._tell(now_ns, f"only {commanded} of {trains} trains are commanded; the run begins")
            return now_ns
        return None

    def _check_processes(self, crew: LineProcesses) -> None:
        """End the run if a program ends by itself; a watchdog may end one that was stopped."""
        for child in crew.ended():
            if child.name in self._absent:
                continue
            train = self._stopped.pop(child.name, NO_TRAIN)
            if train == NO_TRAIN:
                raise ChildError(f"{child.name} ended {child.end_words()}:\n{child.last_words()}")
            now_ns = self._clock.now_ns()
            self._tell(now_ns, f"train {train}: its watchdog ended it, {child.end_words()}")
            self._restart_controller(crew, train)

    # Faults.

    def _apply_fault(self, crew: LineProcesses, fault: Fault) -> bool:
        """Begin a fault; without a master to strike it is missed. Returns True."""
        now_ns, strike = self._clock.now_ns(), fault.strike
        if strike is Strike.CRASH_WAYSIDE:
            self._tell(now_ns, "the wayside with its arbiters is killed")
            self.story.excused.add(OLD)
            self._take_down(crew, WAYSIDE, signal.SIGKILL, lambda: self._restart_wayside(crew))
            return True
        area, train = self._master()
        if strike is Strike.RESTART_TRAIN:
            train = fault.train
        elif train == NO_TRAIN:
            words = f"{strike.value.removesuffix('-at')}: no train commands, so none is struck"
            self._tell(now_ns, words)
            self.story.missed_strikes.append(words)
            return True
        else:
            self.story.orders_takeover(area, train)
        self.story.strikes(train)
        name = f"controller {train}"
        if strike in CUTS:
            order, words = CUTS[strike]
            self._tell(now_ns, f"the radio of train {train} {words}")
            crew.order(order, train)
            self._schedule.ends(now_ns, lambda: self._heal(crew, train))
        elif strike is Strike.STOP_MASTER:
            self._tell(now_ns, f"the controller of train {train} is stopped by SIGSTOP")
            self._take_down(
                crew, name, signal.SIGSTOP, lambda: self._continue_controller(crew, train)
            )
        else:
            by = signal.SIGKILL if strike is Strike.KILL_MASTER else signal.SIGTERM
            self._tell(now_ns, f"the controller of train {train} is ended by {by.name}")
            self._take_down(crew, name, by, lambda: self._restart_controller(crew, train))
        return True

    def _take_down(
        self, crew: LineProcesses, name: str, number: signal.Signals, back: Callable[[], None]
    ) -> None:
        self._absent.add(name)
        crew.strike(name, number)

        def come_back() -> None:
            back()
            self._absent.discard(name)

        self._schedule.ends(self._clock.now_ns(), come_back)

    def _restart_wayside(self, crew: LineProcesses) -> None:
        self._back_ns = self._clock.now_ns()
        self._tell(self._clock.now_ns(), "the wayside with its arbiters is started again")
        crew.start_wayside()

    def _restart_controller(self, crew: LineProcesses, train: int) -> None:
        self._tell(self._clock.now_ns(), f"the controller of train {train} is started again")
        crew.start_controller(train)

    def _continue_controller(self, crew: LineProcesses, train: int) -> None:
        self._tell(self._clock.now_ns(), f"the controller of train {train} goes on")
        self._stopped[f"controller {train}"] = train
        crew.strike(f"controller {train}", signal.SIGCONT)

    def _heal(self, crew: LineProcesses, train: int) -> None:
        self._tell(self._clock.now_ns(), f"the radio of train {train} works again")
        crew.order("heal", train)

    def _master(self) -> tuple[int, int]:
        """Return the rearmost commanded area and its master."""
        for number, area in sorted(self.story.areas.items()):
            return number, area.heartbeat.source
        return 0, NO_TRAIN
