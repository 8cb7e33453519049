"""A line in real time: processes over real zenoh, watched and recorded by a session of its own."""

import itertools
import signal
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Final, NamedTuple

from can_dbc.vobc import Cause
from firmware_py.clock.clock import WallClock
from firmware_py.interrupts import Interrupts
from firmware_py.ports import RadioPort
from firmware_py.radio.credentials import load_credentials
from firmware_py.radio.zenoh_radio import SessionRole, open_radio
from firmware_py.trackdb import LineMap
from firmware_py.trackdb.areas import AreaMap
from metro_hil.line.exercise.event_log import LineEvents
from metro_hil.line.exercise.observer import LAG_NS, Observer
from metro_hil.line.exercise.plan import Fault, PlannedRun, Strike
from metro_hil.line.exercise.processes import WAYSIDE, LineProcesses
from metro_hil.line.exercise.record import LineRunFiles
from metro_hil.line.exercise.taps import ProtectionTap
from metro_hil.line.network.options import OwnNetworks
from metro_hil.line.network.topology import Topology
from metro_hil.model.subprocesses import ChildError
from zenoh_config import t2t_keys
from zenoh_config.codec import BENCH_KEY, safety_key
from zenoh_config.secured import SUPERVISION_NAME
from zenoh_config.t2t import NOBODY

POLL_NS: Final = 20_000_000
NS_PER_S: Final = 1_000_000_000
START_S: Final = 60.0
RECONNECT_S: Final = 10.0
"""Within this all programs have reached a wayside again that came back."""
INBOX_MESSAGES: Final = 1 << 16
OLD: Final = Cause.AUTHORITY_OLD.name.lower().replace("_", " ")
"""Without arbiters nobody may command, and authorities grow old: trains brake, as they must."""


CUTS: Final = {
    Strike.CUT_MASTER: ("cut", "is cut"),
    Strike.MUTE_MASTER: ("mute", "lets nothing out"),
    Strike.DEAFEN_MASTER: ("deafen", "lets nothing in"),
}
"""What the carrier of packets is told, and what the story says."""


class Settings(NamedTuple):
    line: LineMap
    areas: AreaMap
    line_name: str
    """As it was asked for: a name or a file."""
    ways: list[PlannedRun]
    endpoint: str
    timers: str
    arbiters: int
    faults: list[Fault]
    down_s: float
    """So long a program that was struck stays away."""
    duration_s: float
    priority: int
    secure: Path | None = None
    """Certificates and keys; None: the line is open."""
    networks: OwnNetworks | None = None
    """None: all programs share one network."""
    topology: Topology = Topology.STAR


class RealLine:
    """Brings everything up, strikes as planned, and ends everything that it started."""

    def __init__(self, settings: Settings, folder: Path, say: Callable[[float, str], None]) -> None:
        self._settings, self._folder = settings, folder
        self._clock = WallClock()
        self._start_ns = self._clock.now_ns()
        self._secure, key = None, BENCH_KEY
        if settings.secure is not None:
            self._secure = load_credentials(
                settings.secure, SUPERVISION_NAME, self._clock.epoch_ns()
            )
            key = safety_key(self._secure.key_hex)
        self.record = LineRunFiles(folder, say)
        self._tell = self.record.tell
        self.story = LineEvents(settings.line, settings.areas, self._tell, key)
        self.dropped = 0
        """Messages that the recorder missed."""
        self.doubts: list[str] = []
        """Why the run proves nothing, whatever the story says."""
        self._observer = Observer(self.story, len(settings.ways))
        self._emergencies = 0
        """That were told of before the run begins."""
        self._back_ns: int | None = None
        """When the wayside came back, until all are heard again."""
        self.carried: dict[str, dict[str, int]] = {}
        """What became of packets by direction, where trains had networks of their own."""
        self._faults = list(settings.faults)
        self._later: list[tuple[int, Callable[[], None]]] = []
        self._absent: set[str] = set()
        """Programs that were struck and are not back yet."""
        self._stopped: dict[str, int] = {}
        """Trains whose controllers were stopped for a while, by the names of these."""

    def run(self) -> bool:
        """Whether it ran to its end. Raises BusError, RadioError, ChildError."""
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
        """Whether it came to its end."""
        began_ns: int | None = None
        done = False
        while not (done or interrupts.asked):
            self._clock.wait_until(self._clock.now_ns() + POLL_NS)
            now_ns = self._clock.now_ns()
            self._look(port, taps, now_ns)
            self._look_after(crew)
            if began_ns is None:
                self._observe_start(now_ns)
                began_ns = self._beginning(now_ns)
                if began_ns is not None:
                    self._observer.expects_from(now_ns)
                continue
            self._observe(now_ns)
            # Judging itself takes time, too, and what is judged by grows old meanwhile.
            self._observe(self._clock.now_ns())
            done = now_ns - began_ns >= self._settings.duration_s * NS_PER_S
            if not done:
                self._strike(crew, now_ns, began_ns)
        if done:
            self._hear_out(port, taps, self._clock.now_ns())
            self.carried = crew.carried()
        lost = {f"the tap on the bus of train {n}": tap.dropped for n, tap in enumerate(taps, 1)}
        self.doubts = self._observer.doubts({"the recorder": self.dropped, **lost})
        return done

    def _look(self, port: RadioPort, taps: Sequence[ProtectionTap], now_ns: int) -> None:
        heard = port.receive(now_ns)
        self.record.on_message(heard)
        self.story.on_message(heard)
        for said in itertools.chain.from_iterable([tap.on_message(now_ns) for tap in taps]):
            self.story.tells(said.train, said.supervision, said.cause, said.at_ns)
        self.dropped = port.counters.dropped_in

    def _observe_start(self, now_ns: int) -> None:
        """While programs are starting only an emergency brake is judged."""
        emergencies = sum(len(train.emergencies) for train in self.story.trains.values())
        if emergencies > self._emergencies and self.story.newest_ns:
            self._observer.looks_at_newest(now_ns)
        self._emergencies = emergencies

    def _observe(self, now_ns: int) -> None:
        """Nothing is due while the wayside is away, over which all messages go."""
        if WAYSIDE in self._absent:
            self._observer.expects_from(now_ns)
        elif self._back_ns is not None:
            late = now_ns - self._back_ns > RECONNECT_S * NS_PER_S
            if late or self._observer.has_all_until(self._back_ns):
                self._back_ns = None
            else:
                self._observer.expects_from(now_ns)
        self._observer.looks(now_ns)

    def _hear_out(self, port: RadioPort, taps: Sequence[ProtectionTap], end_ns: int) -> None:
        """Take what was sent before the end and is on its way yet."""
        while not self._observer.has_all_until(end_ns) and self._clock.now_ns() < end_ns + LAG_NS:
            self._clock.wait_until(self._clock.now_ns() + POLL_NS)
            self._look(port, taps, self._clock.now_ns())
        self._observer.ends(end_ns)

    def _beginning(self, now_ns: int) -> int | None:
        """When all trains are commanded, or have had long enough for it."""
        trains = len(self._settings.ways)
        commanded = sum(bool(each.given) for each in self.story.trains.values())
        if commanded == trains:
            begins = "the run begins: faults and --for count from here"
            self._tell(now_ns, f"all {trains} trains are commanded; {begins}")
            return now_ns
        if now_ns - self._start_ns > START_S * NS_PER_S:
            self._tell(now_ns, f"only {commanded} of {trains} trains are commanded; it begins")
            return now_ns
        return None

    def _look_after(self, crew: LineProcesses) -> None:
        """A program that ends unasked ends the run; a watchdog may end one that was stopped."""
        for child in crew.ended():
            if child.name in self._absent:
                continue
            train = self._stopped.pop(child.name, NOBODY)
            if train == NOBODY:
                raise ChildError(f"{child.name} ended {child.end_words()}:\n{child.last_words()}")
            now_ns = self._clock.now_ns()
            self._tell(now_ns, f"train {train}: its watchdog ended it, {child.end_words()}")
            self._anew(crew, train)

    # Faults.

    def _strike(self, crew: LineProcesses, now_ns: int, began_ns: int) -> None:
        for due_ns, action in list(self._later):
            if now_ns >= due_ns:
                self._later.remove((due_ns, action))
                action()
        while self._faults and now_ns - began_ns >= self._faults[0].at_s * NS_PER_S:
            self._bring_about(crew, self._faults.pop(0), now_ns)

    def _bring_about(self, crew: LineProcesses, fault: Fault, now_ns: int) -> None:
        strike = fault.strike
        if strike is Strike.CRASH_WAYSIDE:
            self._tell(now_ns, "the wayside with its arbiters is killed")
            self.story.excused.add(OLD)
            self._away(crew, WAYSIDE, signal.SIGKILL, lambda: self._wayside_anew(crew))
            return
        area, train = self._master()
        if strike is Strike.RESTART_TRAIN:
            train = fault.train
        elif train == NOBODY:
            words = f"{strike.value.removesuffix('-at')}: no train commands, so none is struck"
            self._tell(now_ns, words)
            self.story.missed_strikes.append(words)
            return
        else:
            self.story.orders_takeover(area, train)
        self.story.strikes(train)
        name = f"controller {train}"
        if strike in CUTS:
            order, words = CUTS[strike]
            self._tell(now_ns, f"the radio of train {train} {words}")
            crew.order(order, train)
            self._in(lambda: self._heal(crew, train))
        elif strike is Strike.STOP_MASTER:
            self._tell(now_ns, f"the controller of train {train} is stopped by SIGSTOP")
            self._away(crew, name, signal.SIGSTOP, lambda: self._go_on(crew, train))
        else:
            by = signal.SIGKILL if strike is Strike.KILL_MASTER else signal.SIGTERM
            self._tell(now_ns, f"the controller of train {train} is ended by {by.name}")
            self._away(crew, name, by, lambda: self._anew(crew, train))

    def _away(
        self, crew: LineProcesses, name: str, number: signal.Signals, back: Callable[[], None]
    ) -> None:
        self._absent.add(name)
        crew.strike(name, number)

        def come_back() -> None:
            back()
            self._absent.discard(name)

        self._in(come_back)

    def _in(self, action: Callable[[], None]) -> None:
        due_ns = self._clock.now_ns() + round(self._settings.down_s * NS_PER_S)
        self._later.append((due_ns, action))

    def _wayside_anew(self, crew: LineProcesses) -> None:
        self._back_ns = self._clock.now_ns()
        self._tell(self._clock.now_ns(), "the wayside with its arbiters is started again")
        crew.start_wayside()

    def _anew(self, crew: LineProcesses, train: int) -> None:
        self._tell(self._clock.now_ns(), f"the controller of train {train} is started again")
        crew.start_controller(train)

    def _go_on(self, crew: LineProcesses, train: int) -> None:
        self._tell(self._clock.now_ns(), f"the controller of train {train} goes on")
        self._stopped[f"controller {train}"] = train
        crew.strike(f"controller {train}", signal.SIGCONT)

    def _heal(self, crew: LineProcesses, train: int) -> None:
        self._tell(self._clock.now_ns(), f"the radio of train {train} works again")
        crew.order("heal", train)

    def _master(self) -> tuple[int, int]:
        """The rearmost area that is commanded, and by which train."""
        for number, area in sorted(self.story.areas.items()):
            return number, area.heartbeat.source
        return 0, NOBODY
