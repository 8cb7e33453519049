"""`hil run line --service FILE`: trains of a network as processes, watched and judged."""

import argparse
import json
from contextlib import ExitStack
from math import isfinite
from pathlib import Path
from typing import Any, Final

from canlog.run_names import mark_latest
from firmware_py.clock.clock import WallClock
from firmware_py.interrupts import Interrupts
from firmware_py.radio.zenoh_radio import SessionRole, open_radio, pick_endpoint
from firmware_py.settings import SettingsError
from firmware_py.storage.whole_file import write_whole
from firmware_py.trackdb.circuit import split_route
from metro_hil.line.exercise.plan import Strike
from metro_hil.line.exercise.processes import BEFORE
from metro_hil.line.network.options import networks_of
from metro_hil.line.network.topology import Topology
from metro_hil.line.turning.plan import FleetPlan, plan_fleet
from metro_hil.line.turning.witness import NetworkWitness
from metro_hil.model.end_condition import ARRIVED, DURATION, INTERRUPTED
from metro_hil.model.run_folder import make_run_folder, plain, write_config
from metro_hil.model.run_options import (
    EXIT_ENVIRONMENT,
    EXIT_FAILED,
    EXIT_INTERRUPTED,
    EXIT_OK,
    parse,
)
from metro_hil.model.service import line_of_service
from metro_hil.model.subprocesses import Child, ChildError
from plant_emulator.wayside.network_places import places

PRIORITY_MAX: Final = 99
INBOX_MESSAGES: Final = 1 << 16
POLL_NS: Final = 20_000_000
NS_PER_S: Final = 1_000_000_000
OTHERS: Final = ("line", "watch", "commands", "secure")
"""Options of a line in one direction that a service does not have; so are all faults."""


class NetworkRun:
    """The wayside and the trains of a service as processes."""

    def __init__(self, options: argparse.Namespace, plan: FleetPlan, folder: Path) -> None:
        self.witness = NetworkWitness({each.trip.path for each in plan.trips})
        self.dropped = 0
        """Number of messages that the observer lost."""
        self._options, self._plan, self._folder = options, plan, folder
        self._clock = WallClock()
        self._trains: dict[int, Child] = {}

    def run(self) -> str:
        """Run until all trains are gone, or the time is over. Raises ChildError, RadioError."""
        options, interrupts = self._options, Interrupts()
        endpoint = options.line_radio or pick_endpoint()
        with ExitStack() as stack:
            stack.enter_context(interrupts.caught())
            wayside = self._start_wayside(endpoint)
            stack.callback(wayside.end)
            port = open_radio(
                *(SessionRole.TRAIN, endpoint, (places(self._plan.network.name),), self._clock),
                inbox_messages=INBOX_MESSAGES,
            )
            stack.callback(port.close)
            for number in range(1, self._plan.trains + 1):
                self._trains[number] = self._start_train(number, endpoint)
                stack.callback(self._trains[number].end)
            end_ns = self._clock.now_ns() + round(options.duration_s * NS_PER_S)
            while not interrupts.asked:
                self._clock.wait_until(self._clock.now_ns() + POLL_NS)
                for message in port.receive(self._clock.now_ns()):
                    self.witness.on_message(message)
                self.dropped = port.counters.dropped_in
                self._check(wayside)
                if all(child.ended for child in self._trains.values()):
                    return ARRIVED
                if self._clock.now_ns() >= end_ns:
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

    def _check(self, wayside: Child) -> None:
        """End the run if a program ends by itself, other than a train after its last trip."""
        failed = {number for number, child in self._trains.items() if child.ended}
        failed -= self.witness.gone
        ended = [self._trains[number] for number in sorted(failed)]
        for child in [*ended, *([wayside] if wayside.ended else [])]:
            raise ChildError(f"{child.name} ended {child.end_words()}:\n{child.last_words()}")

    def _start_wayside(self, endpoint: str) -> Child:
        assert self._options.service is not None
        routes = dict.fromkeys(str(split_route(each.trip.line)[1]) for each in self._plan.trips)
        words = ["wayside", "--line", line_of_service(self._options.service)]
        words += ["--routes", ",".join(routes), *self._of_line(endpoint)]
        words += ["--memory", str(self._folder / "wayside")]
        if self._options.priority:
            words += ["--priority", str(min(PRIORITY_MAX, self._options.priority + BEFORE))]
        return Child("wayside", "plant_emulator", words, self._folder / "wayside.log")

    def _start_train(self, number: int, endpoint: str) -> Child:
        words = ["run", "--train", str(number), "--service", self._options.service]
        words += ["--trains", str(self._plan.trains), *self._of_line(endpoint)]
        words += ["--priority", str(self._options.priority)]
        words += ["--seed", str(self._options.seed), "--out", str(self._folder / f"train{number}")]
        log = self._folder / f"train{number}.log"
        return Child(f"train {number}", "metro_hil.line.turning.networked_command", words, log)

    def _of_line(self, endpoint: str) -> list[str]:
        options = self._options
        words = ["--line-radio", endpoint, "--line-timers", options.line_timers]
        words += ["--arbiters", str(options.arbiters)]
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
    document = _document(plan, line, reason)
    write_whole(folder.results, json.dumps(document, indent=2) + "\n")
    show(document)
    print(f"run folder: {folder.path}")
    if reason == INTERRUPTED:
        return EXIT_INTERRUPTED
    if document["doubts"]:
        return EXIT_ENVIRONMENT
    return EXIT_FAILED if document["violations"] or document["protection_brakes"] else EXIT_OK


def _plan(options: argparse.Namespace) -> FleetPlan:
    given = [name for name in OTHERS if getattr(options, name, None)]
    given += [each.value for each in Strike if getattr(options, each.value.replace("-", "_"))]
    given += ["networks"] if networks_of(options, needed=False) is not None else []
    given += ["topology"] if Topology(options.topology) is not Topology.STAR else []
    if options.bench != "processes":
        raise SettingsError(
            "--service: in virtual time `vobc run --lockstep --service FILE --masters` runs it"
        )
    if given:
        raise SettingsError(f"--{given[0]}: not with --service, which runs without faults")
    words = ["run", "--service", options.service, "--train", "1"]
    words += [] if options.trains is None else ["--trains", str(options.trains)]
    return plan_fleet(parse(words))


def _document(plan: FleetPlan, line: NetworkRun, reason: str) -> dict[str, Any]:
    witness, found = line.witness, line.results()
    doubts = [
        text
        for is_so, text in (
            (line.dropped > 0, f"the observer lost {line.dropped} messages"),
            (
                len(found) < plan.trains,
                f"trains without results: {plan.trains - len(found)} of {plan.trains}",
            ),
            (
                plan.trains > 1 and witness.checked_count == 0,
                "no two trains were on the network together",
            ),
            (
                witness.skewed_count > witness.checked_count,
                f"{witness.skewed_count} pairs of places were of different instants",
            ),
        )
        if is_so
    ]
    gap_m = witness.least_gap_m
    return {
        "network": plan.network.name,
        "trains": plan.trains,
        "exit_reason": reason,
        "checked_count": witness.checked_count,
        "skewed_count": witness.skewed_count,
        "least_gap_m": gap_m if isfinite(gap_m) else None,
        "violations": [plain(each) for each in witness.violations],
        "protection_brakes": [brake for each in found for brake in each["protection_brakes"]],
        "late_s": max((each["late_s"] for each in found), default=None),
        "trips": [trip for each in found for trip in each["trips"]],
        "doubts": doubts,
    }


def show(document: dict[str, Any]) -> None:
    """Print the verdict and what it rests on."""
    trips = document["trips"]
    # What never happened is left out of the results.
    done = [trip for trip in trips if "ended_s" in trip]
    errors_m = [
        abs(stop["error_m"]) for trip in done for stop in trip["stops"] if "error_m" in stop
    ]
    worst = f", worst stop error {100.0 * max(errors_m):.1f} cm" if errors_m else ""
    turns, gap_m = sum(trip["turned"] for trip in trips), document["least_gap_m"]
    gap = "" if gap_m is None else f", least gap {gap_m:.0f} m"
    print(f"{document['exit_reason']}: {len(done)} trips, {turns} changes of ends{worst}{gap}")
    print(
        f"{document['checked_count']} checks of two trains, {len(document['violations'])} "
        f"violations, {len(document['protection_brakes'])} brakes by protection"
    )
    for each in document["violations"]:
        print(f"at {each['at_s']:.2f} s, {' and '.join(each['trains'])}: {each['kind']}")
    for brake in document["protection_brakes"]:
        text = f"at {brake['at_s']:.2f} s, train {brake['train']}: {brake['kind']} brake"
        print(f"{text}, {brake['cause']}".replace("_", " "))
    for text in document["doubts"]:
        print(f"invalid: {text}")
