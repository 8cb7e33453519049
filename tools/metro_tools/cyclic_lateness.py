"""Measures how late the cyclic executive begins an empty task on this host, like cyclictest."""

import argparse
import dataclasses
import json
import sys
from collections.abc import Sequence

from firmware_py.clock.clock import WallClock
from firmware_py.clock.executive import Executive, Task, TaskReport, run
from firmware_py.clock.realtime import RealtimeReport, enter_realtime, steal_ns

NS_PER_S = 1_000_000_000
NS_PER_MS = 1_000_000
START_DELAY_NS = 10 * NS_PER_MS
EXIT_OK = 0


def measure(period_ms: float, seconds: float, spin_us: float) -> TaskReport:
    """Release an empty task for some time and return its statistics."""
    clock = WallClock(spin_s=spin_us / 1e6)
    start_ns = clock.now_ns() + START_DELAY_NS
    end_ns = start_ns + round(seconds * NS_PER_S)
    executive = Executive([Task("empty", period_ms, run=lambda now_ns: None)], start_ns)
    run([executive], clock, until=lambda now_ns: now_ns >= end_ns)
    return executive.report()[0]


def as_json(report: TaskReport, host: RealtimeReport, stolen_ns: int | None) -> str:
    table = {
        **dataclasses.asdict(report),
        "granted": list(host.granted),
        "steal_ms": None if stolen_ns is None else stolen_ns / NS_PER_MS,
    }
    return json.dumps(table, indent=2)


def as_text(report: TaskReport, host: RealtimeReport, stolen_ns: int | None) -> str:
    stolen = "unknown" if stolen_ns is None else f"{stolen_ns / NS_PER_MS:.0f} ms"
    return "\n".join(
        [
            *host.lines(),
            f"releases {report.releases}, slips {report.slips}, stolen by the host {stolen}",
            f"lateness µs: p50 {report.lateness_us_p50:.0f}  p99 {report.lateness_us_p99:.0f}  "
            f"max {report.lateness_us_max:.0f}",
        ]
    )


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="cyclic_lateness", description=__doc__)
    parser.add_argument("--period-ms", type=_positive, default=50.0)
    parser.add_argument("--seconds", type=_positive, default=10.0)
    parser.add_argument("--priority", type=int, default=80, help="SCHED_FIFO priority; default: 80")
    parser.add_argument(
        "--spin-us",
        type=_not_negative,
        default=0.0,
        help="poll the clock for this time at the end of each wait",
    )
    parser.add_argument("--json", action="store_true", help="one object on standard output")
    options = parser.parse_args(argv)
    host = enter_realtime(options.priority)
    before_ns = steal_ns()
    try:
        report = measure(options.period_ms, options.seconds, options.spin_us)
    except ValueError as error:
        parser.error(str(error))
    after_ns = steal_ns()
    known = before_ns is not None and after_ns is not None
    stolen_ns = after_ns - before_ns if known else None  # type: ignore[operator]
    print((as_json if options.json else as_text)(report, host, stolen_ns))
    return EXIT_OK


def _positive(text: str) -> float:
    value = _not_negative(text)
    if value == 0.0:
        raise argparse.ArgumentTypeError(f"{text} is not positive")
    return value


def _not_negative(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text} is not a number") from None
    if not 0.0 <= value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text} is not a length of time")
    return value


if __name__ == "__main__":
    sys.exit(main())
