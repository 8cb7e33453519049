"""`vobc run --train N --service FILE`: one train of a network in real time, in its own program."""

import json
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

from rich.console import Console

from canlog.run_names import mark_latest
from firmware_py.clock.clock import WallClock
from firmware_py.clock.realtime import die_with_parent
from firmware_py.interrupts import Interrupts
from firmware_py.program import Program
from firmware_py.radio.credentials import load_credentials
from firmware_py.settings import SettingsError
from firmware_py.storage.recorder import loss_text
from firmware_py.storage.whole_file import write_whole
from metro_hil.line.turning.networked import NetworkedTrain, no_orders
from metro_hil.line.turning.plan import FleetPlan, plan_fleet
from metro_hil.metrics.hops import hop_table, means_of
from metro_hil.model.end_condition import ARRIVED
from metro_hil.model.run_folder import make_run_folder, plain, write_config
from metro_hil.model.run_options import (
    EXIT_ENVIRONMENT,
    EXIT_FAILED,
    EXIT_INTERRUPTED,
    EXIT_OK,
    RunOptions,
    parse,
)
from metro_hil.model.terminal import console_for
from vobc.cli.line import grant_check
from vobc.train_to_train.vocabulary import T2tConfig
from zenoh_config.secured import train_name
from zenoh_config.t2t import FIRST_ARBITER
from zenoh_config.timers import TIMER_SETS

CM_PER_M: Final = 100.0
ORDER_BYTES: Final = 4096


class OrderInput:
    """Reads the orders of the bench, one a line, from standard input. It never waits."""

    def __init__(self) -> None:
        os.set_blocking(sys.stdin.fileno(), False)
        self._text = b""

    def __call__(self) -> list[str]:
        try:
            self._text += os.read(sys.stdin.fileno(), ORDER_BYTES)
        except BlockingIOError:
            return []
        *lines, self._text = self._text.split(b"\n")
        return [line.decode() for line in lines]


def run(
    options: RunOptions, console: Console, orders: Callable[[], Sequence[str]] = no_orders
) -> int:
    """Run the train and write the results. Raises SettingsError, RadioError, RunFolderError."""
    assert options.train is not None
    assert options.line_radio is not None
    assert options.line_timers is not None
    assert options.arbiters is not None
    plan = plan_fleet(options)
    number = options.train
    if number > plan.trains:
        raise SettingsError(
            f"--train {number}: the trains of the service {options.service} are numbered from 1 to "
            f"{plan.trains}; give a greater number with --trains"
        )
    clock, secure, grants = WallClock(), None, None
    if options.secure is not None:
        secure = load_credentials(options.secure, train_name(number), clock.epoch_ns())
        grants = grant_check(options.secure, options.arbiters)
    folder = make_run_folder(options.out, clock.epoch_ns(), f"{plan.network.name}_T{number}")
    write_config(folder, {"options": options, "service": plan.service}, clock.epoch_ns())
    mark_latest(folder.path)
    arbiters = tuple(range(FIRST_ARBITER, FIRST_ARBITER + options.arbiters))
    train = NetworkedTrain(
        plan,
        number,
        folder.path if options.logs else None,
        T2tConfig(timers=TIMER_SETS[options.line_timers], arbiters=arbiters, grants=grants),
        options.line_radio,
        lambda text: console.print(f"train {number} {text}", highlight=False, soft_wrap=True),
        secure,
    )
    console.print(
        f"train {number} waits for the wayside at {options.line_radio}",
        highlight=False,
        soft_wrap=True,
    )
    interrupts = Interrupts()
    with interrupts.caught():
        reason = train.run(lambda: interrupts.asked, priority=options.priority, orders=orders)
    document = _document(plan, train, reason)
    write_whole(folder.results, json.dumps(document, indent=2) + "\n")
    _show(console, plan, train, reason, folder.path)
    if options.hops:
        console.print(hop_table(document["hops"]))
    if options.json:
        print(json.dumps(document))
    if train.train.lost_log_lines:
        console.print(loss_text(train.train.lost_log_lines), highlight=False)
        return EXIT_ENVIRONMENT
    if reason != ARRIVED:
        return EXIT_INTERRUPTED
    return EXIT_FAILED if train.train.brakes else EXIT_OK


def main() -> int:
    """Run a train as a child of the bench: the words of `vobc run`, and `--parent PID`.

    It takes orders from standard input.
    """
    *words, _, parent = sys.argv[1:]
    die_with_parent(int(parent))
    return run(parse(words), console_for(), OrderInput())


def _document(plan: FleetPlan, train: NetworkedTrain, reason: str) -> dict[str, Any]:
    """The results for JSON. Times are those of the network."""
    return {
        "network": plan.network.name,
        "train": train.train.number,
        "exit_reason": reason,
        "late_s": train.late_s,
        "protection_brakes": [plain(each) for each in train.train.brakes],
        "hops": means_of([hop for trip in train.train.trips for hop in trip.hops]),
        "trips": [plain(trip) for trip in train.train.trips],
    }


def _show(
    console: Console, plan: FleetPlan, train: NetworkedTrain, reason: str, folder: Path
) -> None:
    trips = train.train.trips
    done = sum(trip.ended_s is not None for trip in trips)
    errors_m = [
        abs(stop.error_m) for trip in trips for stop in trip.stops if stop.error_m is not None
    ]
    worst = f", worst stop error {CM_PER_M * max(errors_m):.1f} cm" if errors_m else ""
    turns = sum(trip.turned for trip in trips)
    late = f", at most {train.late_s:.2f} s late" if trips else ""
    console.print(
        f"{reason}: {done} of {len(plan.trips)} trips, {turns} changes of ends{worst}, "
        f"{len(train.train.brakes)} brakes by protection{late}",
        highlight=False,
    )
    for brake in train.train.brakes:
        text = f"at {brake.at_s:.2f} s: {brake.kind} brake, {brake.cause}".replace("_", " ")
        console.print(text, style="red", highlight=False)
    console.print(f"run folder: {folder}", highlight=False, soft_wrap=True)


if __name__ == "__main__":
    sys.exit(Program("vobc", lambda: main)())
