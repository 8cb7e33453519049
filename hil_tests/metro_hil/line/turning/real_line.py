"""`hil run line --service FILE`: trains of a network as processes, watched and judged."""

import argparse
import json
import signal
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final

from canlog.run_names import mark_latest
from firmware_py.clock.clock import WallClock
from firmware_py.interrupts import Interrupts
from firmware_py.radio.credentials import load_credentials
from firmware_py.radio.line_keys import line_keys
from firmware_py.radio.zenoh_radio import SessionRole, open_radio, pick_endpoint
from firmware_py.settings import SettingsError
from firmware_py.storage.whole_file import write_whole
from firmware_py.trackdb.circuit import split_route
from metro_hil.line.exercise.plan import CUTS, Fault, Strike, faults_of
from metro_hil.line.exercise.processes import BEFORE
from metro_hil.line.exercise.record import LineRunFiles, told
from metro_hil.line.exercise.schedule import FaultSchedule
from metro_hil.line.network.options import networks_of
from metro_hil.line.network.topology import Topology
from metro_hil.line.turning.network_events import NetworkEvents
from metro_hil.line.turning.network_verdict import document_of, failed, show
from metro_hil.line.turning.plan import FleetPlan, plan_fleet
from metro_hil.model.end_condition import ARRIVED, DURATION, INTERRUPTED
from metro_hil.model.run_folder import make_run_folder, write_config
from metro_hil.model.run_options import (
    EXIT_ENVIRONMENT,
    EXIT_FAILED,
    EXIT_INTERRUPTED,
    EXIT_OK,
    parse,
)
from metro_hil.model.service import line_of_service
from metro_hil.model.subprocesses import Child, ChildError
from metro_hil.supervision.access import refuse_insecure
from plant_emulator.wayside.network_places import places
from plant_emulator.wayside.route_objects import divided, shared_tracks
from zenoh_config import t2t_keys
from zenoh_config.secured import SUPERVISION_NAME

PRIORITY_MAX: Final = 99
INBOX_MESSAGES: Final = 1 << 16
POLL_NS: Final = 20_000_000
NS_PER_S: Final = 1_000_000_000
START_NS: Final = 60 * NS_PER_S
"""Time after which a run counts as begun, although no train has entered the network."""
OTHERS: Final = ("line", "watch", "commands")
"""Options of a line in one direction that a service does not have."""
ORDERS: Final = {
    Strike.KILL_MASTER: ("kill", "the controller of train {} is killed", "", ""),
    Strike.STOP_MASTER: (
        "stop",
        "the controller of train {} is stopped",
        "go-on",
        "the controller of train {} goes on",
    ),
    **{
        strike: (order, f"the radio of train {{}} {text}", "heal", "the radio of train {} works")
        for strike, (order, text) in CUTS.items()
    },
}
"""By fault: the order to the program of the train and its text, and those that end the fault. A
controller that was killed stays dead."""


class NetworkRun:
    """The wayside and the trains of a service as processes."""

    def __init__(self, options: argparse.Namespace, plan: FleetPlan, folder: Path) -> None:
        paths = {each.trip.path.line.name: each.trip.path for each in plan.trips}
        shared = shared_tracks(paths.values())
        areas = {name: divided(plan.network, path, shared) for name, path in paths.items()}
        self._record = LineRunFiles(folder, _print)
        self._clock, self._secure = WallClock(), None
        if options.secure is not None:
            epoch_ns = self._clock.epoch_ns()
            self._secure = load_credentials(options.secure, SUPERVISION_NAME, epoch_ns)
        key = line_keys(self._secure)
        self.events = NetworkEvents(
            *(plan.network.name, paths.values(), areas, self._record.tell, key)
        )
        self.schedule = FaultSchedule(faults_of(options), options.down_s)
        self.crashed_s: float | None = None
        """When the wayside was killed first, in the time of the network."""
        self.dropped = 0
        """Number of messages that the observer lost."""
        self._options, self._plan, self._folder = options, plan, folder
        self._trains: dict[int, Child] = {}
        self._wayside: Child | None = None
        """None while it is killed."""

    def run(self) -> str:
        """Run until all trains are gone, or the time is over. Raises ChildError, RadioError."""
        options, interrupts = self._options, Interrupts()
        endpoint = options.line_radio or pick_endpoint()
        with ExitStack() as stack:
            stack.enter_context(interrupts.caught())
            stack.callback(self._record.close)
            self._start_wayside(endpoint, stack)
            topics = [key for name in self.events.lines for key in t2t_keys.of_line(name)]
            port = open_radio(
                *(SessionRole.TRAIN, endpoint, (places(self._plan.network.name), *topics)),
                self._clock,
                inbox_messages=INBOX_MESSAGES,
                secure=self._secure,
            )
            stack.callback(port.close)
            for number in range(1, self._plan.trains + 1):
                self._trains[number] = self._start_train(number, endpoint)
                stack.callback(self._trains[number].end)
            latest_ns = self._clock.now_ns() + START_NS
            while not interrupts.asked:
                self._clock.wait_until(self._clock.now_ns() + POLL_NS)
                now_ns = self._clock.now_ns()
                messages = port.receive(now_ns)
                self.events.on_message(messages)
                self._record.on_message(messages)
                self.dropped = port.counters.dropped_in
                self._check()
                if self.events.began_ns is not None:
                    # The event log is in the time of the network from its first train on.
                    self._record.zero_ns = self.events.zero_ns
                    self.schedule.step(
                        now_ns,
                        self.events.began_ns,
                        lambda fault: self._apply(fault, endpoint, stack),
                    )
                if all(child.ended for child in self._trains.values()):
                    return ARRIVED
                began_ns = self.events.began_ns or latest_ns
                if now_ns >= began_ns + options.duration_s * NS_PER_S:
                    return DURATION
        return INTERRUPTED

    def results(self) -> list[dict[str, Any]]:
        """Results of each train, as its program wrote them at its end."""
        found = []
        for number in self._trains:
            path = self._folder / f"train{number}" / "results.json"
            if path.exists():
                found.append(json.loads(path.read_text(encoding="utf-8")))
        return found

    def _apply(self, fault: Fault, endpoint: str, stack: ExitStack) -> bool:
        """Begin a fault; return False if no train can be struck yet."""
        now_ns, strike = self._clock.now_ns(), fault.strike
        if strike is Strike.CRASH_WAYSIDE:
            if self._wayside is None:
                return False
            self._record.tell(now_ns, "the wayside with its arbiters is killed")
            self._wayside.signal_group(signal.SIGKILL)
            self._wayside = None
            if self.crashed_s is None:
                self.crashed_s = self.events.second_of(now_ns)

            def restart() -> None:
                text = "the wayside with its arbiters is started again"
                self._record.tell(self._clock.now_ns(), text)
                self._start_wayside(endpoint, stack)

            self.schedule.ends(now_ns, restart)
            return True
        struck = self.events.strike(strike.value.removesuffix("-at"), now_ns)
        if struck is None:
            return False
        child = self._trains[struck.train]
        order, text, back, back_text = ORDERS[strike]
        self._record.tell(now_ns, text.format(struck.train))
        child.order(order)

        def end() -> None:
            self._record.tell(self._clock.now_ns(), back_text.format(struck.train))
            child.order(back)

        if back:
            self.schedule.ends(now_ns, end)
        return True

    def _check(self) -> None:
        """End the run if a program ends by itself, other than a train after its last trip."""
        numbers = {number for number, child in self._trains.items() if child.ended}
        programs = [self._trains[number] for number in sorted(numbers - self.events.witness.gone)]
        if self._wayside is not None and self._wayside.ended:
            programs.append(self._wayside)
        for child in programs:
            raise ChildError(f"{child.name} ended {child.end_words()}:\n{child.last_words()}")

    def _start_wayside(self, endpoint: str, stack: ExitStack) -> None:
        assert self._options.service is not None
        routes = dict.fromkeys(str(split_route(each.trip.line)[1]) for each in self._plan.trips)
        words = ["wayside", "--line", line_of_service(self._options.service)]
        words += ["--routes", ",".join(routes), *self._of_line(endpoint)]
        words += ["--memory", str(self._folder / "wayside")]
        if self._options.priority:
            words += ["--priority", str(min(PRIORITY_MAX, self._options.priority + BEFORE))]
        log = self._folder / "wayside.log"
        self._wayside = Child("wayside", "plant_emulator", words, log)
        stack.callback(self._wayside.end)

    def _start_train(self, number: int, endpoint: str) -> Child:
        words = ["run", "--train", str(number), "--service", self._options.service]
        words += ["--trains", str(self._plan.trains), *self._of_line(endpoint)]
        words += ["--priority", str(self._options.priority)]
        words += ["--seed", str(self._options.seed), "--out", str(self._folder / f"train{number}")]
        log = self._folder / f"train{number}.log"
        module = "metro_hil.line.turning.networked_command"
        return Child(f"train {number}", module, words, log, takes_orders=True)

    def _of_line(self, endpoint: str) -> list[str]:
        options = self._options
        words = ["--line-radio", endpoint, "--line-timers", options.line_timers]
        words += ["--arbiters", str(options.arbiters)]
        if options.secure is not None:
            return [*words, "--secure", str(options.secure)]
        return [*words, "--insecure"] if options.insecure else words


def run(options: argparse.Namespace) -> int:
    """Run the trains, print and write the verdict. Raises SettingsError, ChildError."""
    plan = _plan(options)
    clock = WallClock()
    folder = make_run_folder(options.out, clock.epoch_ns(), f"line_{plan.network.name}")
    write_config(folder, {"service": plan.service, "trains": plan.trains}, clock.epoch_ns())
    mark_latest(folder.path)
    line = NetworkRun(options, plan, folder.path)
    reason = line.run()
    document = document_of(
        *(line.events, line.results()),
        network=plan.network.name,
        trains=plan.trains,
        exit_reason=reason,
        dropped=line.dropped,
        crashed_s=line.crashed_s,
        missed=[
            f"{each.strike.value.removesuffix('-at')}: the run ended before, or no train commanded "
            "an area with another train in it"
            for each in line.schedule.waiting
        ],
    )
    write_whole(folder.results, json.dumps(document, indent=2) + "\n")
    show(document)
    print(f"run folder: {folder.path}")
    if reason == INTERRUPTED:
        return EXIT_INTERRUPTED
    if document["doubts"]:
        return EXIT_ENVIRONMENT
    return EXIT_FAILED if failed(document) else EXIT_OK


def _print(at_s: float, text: str) -> None:
    print(told(at_s, text), flush=True)


def _plan(options: argparse.Namespace) -> FleetPlan:
    if options.line_radio is not None:
        refuse_insecure(options)
    given = [name for name in OTHERS if getattr(options, name, None)]
    given += ["networks"] if networks_of(options, needed=False) is not None else []
    given += ["topology"] if Topology(options.topology) is not Topology.STAR else []
    if options.bench != "processes":
        raise SettingsError(
            "--service: in virtual time `vobc run --lockstep --service FILE --masters` runs it"
        )
    if given:
        raise SettingsError(f"--{given[0]}: not with --service")
    if options.restart_train_at:
        raise SettingsError(
            "--restart-train-at: not with --service, where a controller that ended does not enter "
            "the network again; --kill-master-at kills one, and its train stays as an obstacle"
        )
    words = ["run", "--service", options.service, "--train", "1"]
    words += [] if options.trains is None else ["--trains", str(options.trains)]
    return plan_fleet(parse(words))
