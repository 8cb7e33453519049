"""`python -m metro_hil.realtime.gateway`: joins two bus segments and applies bus faults."""

import argparse
import json
import select
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Final

from firmware_py.assertions import require_assertions
from firmware_py.buses import BusError, open_can
from firmware_py.clock.clock import Clock, WallClock
from firmware_py.clock.realtime import collect_garbage, die_with_parent, enter_realtime
from firmware_py.interrupts import Interrupts
from firmware_py.ports import CanPort
from firmware_py.settings import SettingsError, parse
from firmware_py.storage.errors import RecorderError
from firmware_py.storage.recorder import LineLog
from firmware_py.storage.whole_file import write_whole
from metro_hil.faults.gateway import GatewayFaults
from metro_hil.model.run_options import EXIT_ENVIRONMENT, EXIT_OK, EXIT_USAGE
from metro_hil.realtime.feed_socket import FeedSocket
from metro_hil.realtime.gateway.forwarding import Forwarding
from plant_emulator.faults.feed import FaultChange, read_message
from plant_emulator.faults.kinds import FaultPlace
from plant_emulator.faults.plan import FaultPlan, read_faults

TICK_S: Final = 0.05
WINDOW_NS: Final = 1_000_000_000
NS_PER_S: Final = 1_000_000_000
COLUMNS: Final = ("t_s", "wait_max_us", "to_train", "to_vobc")

DESCRIPTION: Final = "Joins two bus segments and applies bus faults between them."
EPILOG: Final = """\
exit codes: 0 ended by SIGTERM or Ctrl-C; 2 wrong usage or faults; 3 a bus or a folder missing
"""


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    top = argparse.ArgumentParser(
        prog="python -m metro_hil.realtime.gateway",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    top.add_argument("--a", required=True, metavar="SPEC", help="the controller's segment")
    top.add_argument("--b", required=True, metavar="SPEC", help="the train's segment")
    top.add_argument("--faults", metavar="FILE", help="a scenario's [[fault]] tables")
    top.add_argument("--seed", type=int, default=1, help="seed of all random values; default: 1")
    top.add_argument(
        "--feed",
        metavar="PATH",
        help="create a Unix datagram socket there that receives fault changes",
    )
    top.add_argument("--out", metavar="FOLDER", help="for gateway.csv and gateway.json")
    top.add_argument("--priority", type=int, default=0, help="SCHED_FIFO priority; 0: none")
    top.add_argument("--parent", type=int, metavar="PID", help="end when that process ends")
    return top


def main(argv: Sequence[str] | None = None) -> int:
    """Run the gateway; every error of the user becomes one line, never a traceback."""
    require_assertions("gateway")
    options = parser().parse_args(argv)
    if options.parent is not None:
        die_with_parent(options.parent)
    try:
        faults = _faults(options.faults)
        return _serve(options, faults)
    except SettingsError as error:
        return _complain(error, EXIT_USAGE)
    except (BusError, RecorderError, OSError) as error:
        return _complain(error, EXIT_ENVIRONMENT)


def _faults(name: str | None) -> tuple[FaultPlan, ...]:
    """Read the faults of the bus. Raises SettingsError."""
    if name is None:
        return ()
    tables = parse(Path(name)).get("fault", [])
    return tuple(plan for plan in read_faults(tables, name) if plan.kind.place is FaultPlace.BUS)


def _serve(options: argparse.Namespace, faults: Sequence[FaultPlan]) -> int:
    ending = Interrupts()
    with ending.caught(), ExitStack() as stack:
        clock = WallClock()
        a = open_can(options.a, clock=clock, node="GATEWAY_A")
        stack.callback(a.close)
        b = open_can(options.b, clock=clock, node="GATEWAY_B")
        stack.callback(b.close)
        core = GatewayFaults(options.seed)
        log = None
        if options.out is not None:
            log = LineLog(Path(options.out) / "gateway.csv", COLUMNS)
            stack.callback(log.close)
        still = options.priority > 0
        if still:
            enter_realtime(options.priority)
        feed = None
        if options.feed is not None:
            # Create the socket last: its path tells waiting processes that the gateway is ready.
            feed = FeedSocket(Path(options.feed), clock)
            stack.callback(feed.close)
        forwarding = Forwarding(a, b, core)
        _Loop(forwarding, core, faults, (a, b), feed, log, clock, still=still).run(ending)
        if not forwarding.alive:
            raise BusError(f"{options.a} or {options.b} is gone")
        if options.out is not None:
            struck = {f"{kind} {message}": n for (kind, message), n in sorted(core.done.items())}
            touched = {str(index): count for index, count in sorted(core.touched.items())}
            counts = {**forwarding.summary(), "struck": struck, "touched": touched}
            write_whole(Path(options.out) / "gateway.json", json.dumps(counts, indent=2) + "\n")
    return EXIT_OK


class _Loop:
    """Waits for frames, for due frames and for changes of faults."""

    def __init__(
        self,
        forwarding: Forwarding,
        core: GatewayFaults,
        plans: Sequence[FaultPlan],
        ports: tuple[CanPort, CanPort],
        feed: FeedSocket | None,
        log: LineLog | None,
        clock: Clock,
        *,
        still: bool,
    ) -> None:
        """`still`: only this loop collects garbage."""
        self._still = still
        self._forwarding, self._core, self._feed, self._log = forwarding, core, feed, log
        self._plans = {plan.index: plan for plan in plans}
        self._clock = clock
        self._waiting = [getattr(port, "fileno")() for port in ports]  # noqa: B009
        if feed is not None:
            self._waiting.append(feed.fileno())
        self._window_ns = clock.now_ns()

    def run(self, ending: Interrupts) -> None:
        while not ending.asked and self._forwarding.alive:
            select.select(self._waiting, [], [], self._wait_s())
            now_ns = self._clock.now_ns()
            if self._feed is not None:
                for _, message in self._feed.receive(now_ns):
                    self._take(message, now_ns)
            self._forwarding.step(now_ns)
            if now_ns - self._window_ns >= WINDOW_NS:
                self._close_window(now_ns)

    def _wait_s(self) -> float:
        next_ns = self._forwarding.next_due_ns
        if next_ns is None:
            return TICK_S
        return min(TICK_S, max(0.0, (next_ns - self._clock.now_ns()) / NS_PER_S))

    def _take(self, message: bytes, now_ns: int) -> None:
        heard = read_message(message)
        if isinstance(heard, FaultChange) and heard.index in self._plans:
            self._core.change(self._plans[heard.index], heard.active, now_ns)

    def _close_window(self, now_ns: int) -> None:
        self._window_ns = now_ns
        forwarding = self._forwarding
        longest_us = forwarding.longest_wait_us()
        if self._log is not None:
            seconds = f"{now_ns / NS_PER_S:.3f}"
            self._log.row(seconds, f"{longest_us:.0f}", *forwarding.sent.values())
        if self._still:
            collect_garbage(now_ns)


def _complain(error: Exception, code: int) -> int:
    print(f"gateway: {error}", file=sys.stderr, flush=True)
    return code
