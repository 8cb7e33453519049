"""A run in real time: controller and plant as processes on a bus, observed through a tap."""

import hashlib
import itertools
import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from can_dbc.binding import can_id, kinds, sender
from can_dbc.nodes import Node
from firmware_py import rendezvous
from firmware_py.buses import (
    BusError,
    BusKind,
    is_virtual,
    open_can,
    parse_spec,
    resolve_auto,
)
from firmware_py.buses.hub_control import hub_status, start_hub
from firmware_py.clock.clock import WallClock
from firmware_py.interrupts import Interrupts
from firmware_py.ports import CanPort
from firmware_py.radio.zenoh_radio import DEFAULT_ENDPOINT, pick_endpoint
from firmware_py.settings import SettingsError
from firmware_py.storage.recorder import CandumpWriter
from metro_hil.foreign_plant.choice import read_plant
from metro_hil.model.case import PlantSpec, plant_text
from metro_hil.model.end_condition import INTERRUPTED, Ending
from metro_hil.model.mission import Journey
from metro_hil.model.run_folder import RunFolder
from metro_hil.model.run_options import BROWSER, EXTERNAL, RunOptions
from metro_hil.model.subprocesses import Child, ChildError, plant_module
from metro_hil.realtime.bus_watch import BusWatch
from metro_hil.realtime.commands import again
from metro_hil.realtime.line_hints import LineHints
from metro_hil.realtime.live_display import BusPicture, Hints, LiveDisplay, no_hints
from plant_emulator.cli.by_hand import DESK_KEYS, DESK_RECORDING
from zenoh_config.sessions import LINE_ENDPOINT

BIT_RATE = 250_000
BUS_NAME_CHARS = 15
AUTO_NAME = "vcan0"
DESK_LINE = "loop"
"""Line that the supervision commands assume when the user names none."""
PLANT_ANSWER_S = 1.0
PLANT_START_S = 20.0
RESTART_S = 5.0
"""Least duration of a run of the controller after which it is started again."""
CONTROLLER = "controller"
POLL_NS = 20_000_000
NS_PER_S = 1_000_000_000


class RealtimeRun:
    """Starts what is missing, observes, and ends everything that it started."""

    def __init__(
        self,
        options: RunOptions,
        journey: Journey,
        folder: RunFolder,
        console: Console,
        *,
        check_train: Callable[[], None],
    ) -> None:
        """Args:
        check_train: called before this bench starts a plant; raises SettingsError if the train does
        not fit the controller.
        """
        self._options, self._journey, self._folder = options, journey, folder
        self._check_train = check_train
        self._plant = read_plant(options.plant)
        self._clock = WallClock()
        self._interrupts = Interrupts()
        self._picture = BusPicture(BIT_RATE)
        self._display = LiveDisplay(console, self._picture, self._title(), hints_of(options))
        self._children: list[Child] = []
        self._starts = 0
        """Number of starts of the controller."""
        self._started_ns = 0
        """Instant of the last one."""

    def _title(self) -> str:
        journey = self._journey
        return f"{journey.line.name} {journey.start.name} → {journey.end.name}"

    def run(self) -> Ending:
        """Run. Raises BusError, ChildError or RendezvousError if the run cannot take place."""
        with ExitStack() as stack:
            stack.enter_context(self._interrupts.caught())
            if self._options.memory is not None:
                Path(self._options.memory).mkdir(parents=True, exist_ok=True)
            spec = self._choose_bus(stack)
            tap = open_can(spec, clock=self._clock, node="TAP")
            stack.callback(tap.close)
            log = CandumpWriter(self._folder.bus_log, spec.partition(":")[2])
            stack.callback(log.close)
            tags, radio, emulated = self._find_or_start_plant(stack, spec, tap)
            watch = BusWatch(
                tap,
                log,
                self._folder.host_log,
                self._picture,
                self._display,
                self._clock,
                watched=self._options.watch,
            )
            if self._interrupts.asked:
                return watch.ending(INTERRUPTED, truth_known=False)
            if self._options.desk == BROWSER and not emulated:
                self._start_desk(stack, spec)
            wires = ["--bus", spec, "--tags", tags, "--radio", radio]
            self._start_controller(stack, wires)
            reason = watch.run(
                self._children,
                self._journey.end.stop_m,
                self._options.duration_s,
                lambda: self._interrupts.asked,
                unattended=emulated and self._desk_unattended(),
                centre=self._options.train is not None,
                restart=lambda child: self._restart(stack, child, wires),
            )
            self._end_children(watch)
            ending = watch.ending(reason, truth_known=emulated, realtime=self._realtime_grants())
            lost = ending.lost_log_lines + self._lost_by_children()
            return replace(ending, lost_log_lines=lost)

    def _choose_bus(self, stack: ExitStack) -> str:
        if self._options.bus != "auto":
            return self._options.bus
        if self._options.train is not None:
            return self._own_bus(own_bus_name(self._options), stack)
        choice = resolve_auto(AUTO_NAME)
        name, reason = AUTO_NAME, choice.reason
        if choice.spec is not None and not (is_embedded(choice.spec) and is_of_a_run(AUTO_NAME)):
            self._display.say(f"bus: {choice.spec}")
            return choice.spec
        if choice.spec is not None:
            name = next(each for each in spare_names() if hub_status(each) is None)
            reason = f"embedded:{AUTO_NAME} belongs to another run"
        hub = start_hub(name, bound=True)
        stack.callback(hub.stop)
        self._display.say(f"bus: embedded:{name}, started for this run ({reason})")
        return f"embedded:{name}"

    def _own_bus(self, name: str, stack: ExitStack) -> str:
        """Bus of one train among several; it has the train's name and is started if it is
        missing."""
        if hub_status(name) is None:
            hub = start_hub(name, bound=True)
            stack.callback(hub.stop)
            self._display.say(f"bus: embedded:{name}, started for this run")
        return f"embedded:{name}"

    def _find_or_start_plant(
        self, stack: ExitStack, spec: str, tap: CanPort
    ) -> tuple[str, str, bool]:
        """Addresses of tags and radio, and whether a plant of this bench logs the true values."""
        options, folder = self._options, rendezvous.bench_dir(spec.partition(":")[2])
        heard = self._listen(tap, PLANT_ANSWER_S)
        if Node.VOBC in heard:
            raise BusError(
                f"{spec}: another VOBC is sending on this bus; two cannot drive one train"
            )
        if self._plant != PlantSpec():
            self._refuse_plant_on(spec, heard)
        if options.plant == "none" or not is_virtual(spec) or heard:
            if options.allow_faults:
                raise SettingsError(
                    f"--allow-faults: this run does not emulate the train on {spec}; leave it out, "
                    "or choose a bus without a train"
                )
            self._display.say(self._plant_text(spec, heard))
            tags = str(folder / "tags") if options.tags == "auto" else options.tags
            radio = options.radio
            if radio == "auto" and options.train is None:
                radio = self._known_radio(spec)
            return tags, radio, False
        self._check_train()
        radio = options.radio
        if radio == "auto" and options.train is None:
            radio = pick_endpoint()
        words = plant_text(self._plant)
        self._display.say(
            f"plant: none answered within a second; starting the plant emulator {words}".rstrip()
        )
        module, *first = plant_module(self._plant)
        arguments = [*first, *self._plant_arguments(spec, radio)]
        child = Child("plant", module, arguments, self._log("plant"))
        self._adopt(stack, child)
        self._await_plant(tap, child, spec)
        tags = str(folder / "tags") if options.tags == "auto" else options.tags
        return tags, radio, True

    def _refuse_plant_on(self, spec: str, heard: set[Node]) -> None:
        """Raise BusError if a plant of the user's own cannot be started on this bus."""
        if heard:
            names = ", ".join(sorted(node.name for node in heard))
            raise BusError(
                f"--plant {self._options.plant}: {names} already send on {spec}; end that train "
                "first, or leave out --plant"
            )
        if not is_virtual(spec):
            raise BusError(
                f"--plant {self._options.plant}: {spec} is a physical bus, on which no train is "
                "emulated; choose a virtual one"
            )

    def _plant_text(self, spec: str, heard: set[Node]) -> str:
        if heard:
            names = ", ".join(sorted(node.name for node in heard))
            return f"plant: {names} already send on {spec}; no emulator is started"
        return f"plant: none started; the controller stays braked and waits for a train on {spec}"

    def _known_radio(self, spec: str) -> str:
        return rendezvous.read_radio(spec.partition(":")[2]) or DEFAULT_ENDPOINT

    def _listen(self, tap: CanPort, wait_s: float) -> set[Node]:
        """The nodes that send something within the given time."""
        names = {can_id(kind): Node[sender(kind)] for kind in kinds()}
        until_ns = self._clock.now_ns() + int(wait_s * NS_PER_S)
        heard: set[Node] = set()
        while (now_ns := self._clock.now_ns()) < until_ns and not self._interrupts.asked:
            self._clock.wait_until(now_ns + POLL_NS)
            frames = tap.receive(self._clock.now_ns())
            heard |= {names[frame.can_id] for frame in frames if frame.can_id in names}
        return heard

    def _await_plant(self, tap: CanPort, child: Child, spec: str) -> None:
        until_ns = self._clock.now_ns() + int(PLANT_START_S * NS_PER_S)
        while not self._interrupts.asked:
            if child.ended:
                raise ChildError(f"the plant emulator did not start: {child.failure_words()}")
            if self._listen(tap, 0.1) - {Node.VOBC}:
                return
            if self._clock.now_ns() > until_ns:
                raise ChildError(
                    f"the plant emulator sent nothing on {spec} within {PLANT_START_S:.0f} s:\n"
                    f"{child.last_words()}"
                )

    def _plant_arguments(self, spec: str, radio: str) -> list[str]:
        options, journey = self._options, self._journey
        arguments = ["run", "--bus", spec, "--line", options.line, "--consist", options.consist]
        arguments += ["--seed", str(options.seed), "--from", journey.start.name]
        arguments += ["--to", journey.end.name, "--radio", radio, "--out", str(self._folder.path)]
        arguments += line_arguments(options)
        if options.load_ratio is not None:
            arguments += ["--load-ratio", str(options.load_ratio)]
        if options.odometer_error is not None:
            arguments += ["--odometer-error", str(options.odometer_error)]
        arguments += ["--desk", "manual" if options.desk == BROWSER else options.desk]
        if options.by_hand:
            arguments += ["--by-hand", *options.by_hand]
        if options.driver is not None:
            arguments += ["--driver", options.driver]
        if options.desk_recording is not None:
            arguments += ["--desk-recording", options.desk_recording]
        return arguments

    def _restart(self, stack: ExitStack, child: Child, wires: Sequence[str]) -> bool:
        """Start the controller of a train on a line again, so that its train stays there.

        One that ended soon after its start has a reason that would only come again.
        """
        ran_ns = self._clock.now_ns() - self._started_ns
        ours = self._options.train is not None and child.name == CONTROLLER
        if not ours or ran_ns < RESTART_S * NS_PER_S:
            return False
        self._display.say(
            f"the controller ended by itself ({child.end_words()}); it is started again"
        )
        self._children.remove(child)
        child.end()
        self._start_controller(stack, wires)
        return True

    def _start_controller(self, stack: ExitStack, wires: Sequence[str]) -> None:
        options, journey = self._options, self._journey
        out = again(self._folder.path, self._starts)
        self._starts += 1
        self._started_ns = self._clock.now_ns()
        arguments = [*wires, "--line", options.line, "--consist", options.params]
        arguments += ["--from", journey.start.name, "--to", journey.end.name]
        arguments += ["--cycle-ms", str(options.cycle_ms), "--priority", str(options.priority)]
        arguments += ["--out", str(out), *line_arguments(options)]
        arguments += controller_line_arguments(options)
        arguments += memory_arguments(options, self._folder.path)
        if options.ato is not None:
            arguments += ["--ato", options.ato]
        if options.output is not None:
            arguments += ["--output", options.output]
        self._adopt(stack, Child(CONTROLLER, "vobc", arguments, self._log("vobc")))

    def _start_desk(self, stack: ExitStack, spec: str) -> None:
        """Start the desk whose keys come from the page of the run; it records what is done."""
        path = self._folder.path
        arguments = ["desk", "--bus", spec, "--keys", str(path / DESK_KEYS)]
        arguments += ["--record", str(path / DESK_RECORDING)]
        self._adopt(stack, Child("desk", "plant_emulator", arguments, self._log("desk")))

    def _log(self, name: str) -> Path:
        return self._folder.path / f"{name}.log"

    def _adopt(self, stack: ExitStack, child: Child) -> None:
        # Callbacks run in reverse order, so the controller, which starts last, ends first.
        self._children.append(child)
        stack.callback(child.end)

    def _end_children(self, watch: BusWatch) -> None:
        """End the controller first, so that the plant receives its safe output; the tap records
        all."""
        for child in reversed(self._children):
            child.end()
            watch.drain(self._clock.now_ns())

    def _desk_unattended(self) -> bool:
        """Whether no person works the desk and no duration is given: a stuck run may then end."""
        options = self._options
        by_hand = options.desk in ("manual", EXTERNAL, BROWSER)
        worked = options.desk_recording or options.driver or by_hand
        return options.duration_s is None and not worked

    def _lost_by_children(self) -> int:
        """Number of log lines that the disk refused, as controller and plant recorded them."""
        lost = 0
        for name in ("vobc.json", "plant.json"):
            with suppress(OSError, ValueError, KeyError):
                noted = json.loads((self._folder.path / name).read_text(encoding="utf-8"))
                lost += noted["lost_log_lines"]
        return lost

    def _realtime_grants(self) -> list[str]:
        """What the host granted the controller for real time, as the controller recorded it."""
        try:
            granted = json.loads((self._folder.path / "realtime.json").read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return []
        return [f"{name}: {words}" for name, words in granted.items()]


def hints_of(options: RunOptions) -> Hints:
    """Hints beside the display, with the commands for the train's line."""
    if options.train is None or options.line_radio is None:
        return no_hints
    where = [] if options.line == DESK_LINE else ["--line", options.line]
    if options.line_radio != LINE_ENDPOINT:
        where += ["--line-radio", options.line_radio]
    if options.secure is not None:
        where += ["--secure", options.secure]
    where += ["--insecure"] if options.insecure else []
    return LineHints(options.train, options.line_radio, where)


def is_embedded(spec: str) -> bool:
    return parse_spec(spec).kind is BusKind.EMBEDDED


def is_of_a_run(name: str) -> bool:
    """Return whether another run started this bus for itself, so that no other may join it."""
    status = hub_status(name)
    return status is not None and status.bound


def spare_names() -> Iterator[str]:
    """Names for the bus of a run while another one has the usual name."""
    return (f"{AUTO_NAME}-{number}" for number in itertools.count(2))


def own_bus_name(options: RunOptions) -> str:
    """Name of the bus of a train on a line: each train of each wayside has one of its own."""
    name = f"train{options.train}"
    if options.line_radio in (None, LINE_ENDPOINT):
        return name
    digest = hashlib.sha256(str(options.line_radio).encode()).hexdigest()
    return f"{name}-{digest}"[:BUS_NAME_CHARS]


def memory_arguments(options: RunOptions, folder: Path) -> list[str]:
    """Arguments by which a restarted controller of a train on a line finds its memory."""
    if options.train is None:
        return []
    folder = folder if options.memory is None else Path(options.memory)
    return ["--nvram", str(folder / "nvram"), "--line-memory", str(folder / "terms")]


def line_arguments(options: RunOptions) -> list[str]:
    """Arguments for plant and controller of a train that commands itself."""
    if options.train is None or options.line_radio is None:
        return []
    secure = [] if options.secure is None else ["--secure", options.secure]
    secure += ["--insecure"] if options.insecure else []
    return ["--train", str(options.train), "--line-radio", options.line_radio, *secure]


def controller_line_arguments(options: RunOptions) -> list[str]:
    """Arguments about the line that only the controller needs."""
    peer = options.line_peer
    words = [] if peer is None else ["--line-peer", *([peer] if peer else [])]
    if options.line_timers is not None and options.arbiters is not None:
        words += ["--line-timers", options.line_timers, "--arbiters", str(options.arbiters)]
    return words
