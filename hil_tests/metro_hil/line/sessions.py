"""Sessions of many trains on one machine over real zenoh: loss, processor time and memory."""

import argparse
import json
import os
import resource
import subprocess
import sys
from collections.abc import Sequence
from statistics import median
from typing import Any, Final

from firmware_py.clock.clock import WallClock
from firmware_py.clock.realtime import die_with_parent
from firmware_py.ports import RadioPort
from firmware_py.radio.zenoh_radio import SessionRole, open_radio, pick_endpoint
from firmware_py.trackdb import load_line
from plant_emulator.wayside.line_centre import LineCentre
from zenoh_config import keys
from zenoh_config.codec import pack, unpack
from zenoh_config.messages import TrainOrders, TrainStatus

LINE: Final = "loop"
PERIOD_NS: Final = 200_000_000
"""Period of the statuses, which every train sends five times a second."""
BEAT_NS: Final = 5_000_000
NS_PER_S: Final = 1_000_000_000
NS_PER_MS: Final = 1e6
CONNECT_S: Final = 60.0
ANSWER_S: Final = 2.0
KIB_PER_MIB: Final = 1024.0
INBOX_MESSAGES: Final = 1 << 14


def seat(address: int, endpoint: str, statuses: int, parent: int) -> None:
    """One train: it waits for an answer, sends its statuses, and counts the received orders."""
    die_with_parent(parent)
    clock = WallClock()
    topic, sequence = keys.status(LINE, address), 0
    echoes: dict[int, int] = {}
    latencies_ms: list[float] = []

    def say() -> None:
        nonlocal sequence
        sequence += 1
        now_ns = clock.now_ns()
        status = TrainStatus(
            *(address, 1, sequence, now_ns, 4, 1, 0, True, True, 0.0),
            *(True, False, False, False, False, False, False),
        )
        echoes[now_ns] = sequence
        port.send(now_ns, topic, pack(status))

    def hear() -> None:
        now_ns = clock.now_ns()
        for message in port.receive(now_ns):
            heard = unpack(message.payload)
            if isinstance(heard, TrainOrders) and echoes.pop(heard.echo_stamp_ns, 0):
                latencies_ms.append((message.stamp_ns - heard.echo_stamp_ns) / NS_PER_MS)

    with open_radio(SessionRole.TRAIN, endpoint, (keys.orders(LINE, address),), clock) as port:
        end_ns = clock.now_ns() + round(CONNECT_S * NS_PER_S)
        while not latencies_ms and clock.now_ns() < end_ns:
            say()
            clock.wait_until(clock.now_ns() + PERIOD_NS)
            hear()
        print("ready", flush=True)
        sys.stdin.readline()
        echoes.clear()
        latencies_ms.clear()
        before_s = _cpu_s()
        due_ns = begun_ns = clock.now_ns()
        for _ in range(statuses):
            due_ns += PERIOD_NS
            clock.wait_until(due_ns)
            say()
            hear()
        clock.wait_until(clock.now_ns() + round(ANSWER_S * NS_PER_S))
        hear()
        span_s = (clock.now_ns() - begun_ns) / NS_PER_S
    told = {
        "sent": statuses,
        "answered": len(latencies_ms),
        "cpu_ratio": (_cpu_s() - before_s) / span_s,
        "rss_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / KIB_PER_MIB,
        "latencies_ms": latencies_ms,
    }
    print(json.dumps(told), flush=True)


def _cpu_s() -> float:
    spent = resource.getrusage(resource.RUSAGE_SELF)
    return spent.ru_utime + spent.ru_stime


def run(trains: int, seconds: float) -> dict[str, float]:
    """Run the wayside in this process and each train in its own. Raises TimeoutError."""
    clock, endpoint = WallClock(), pick_endpoint()
    statuses = round(seconds * NS_PER_S / PERIOD_NS)
    with open_radio(
        SessionRole.WAYSIDE, endpoint, (keys.statuses(LINE),), clock, inbox_messages=INBOX_MESSAGES
    ) as port:
        wayside = _Wayside(clock, port)
        seats = [_started_seat(n, endpoint, statuses) for n in range(1, trains + 1)]
        try:
            _await_all(wayside, seats)
            for each in seats:
                assert each.stdin is not None
                each.stdin.write("go\n")
                each.stdin.flush()
            before_s, begun_ns = _cpu_s(), clock.now_ns()
            wayside.serve(begun_ns + round((seconds + ANSWER_S + 1.0) * NS_PER_S))
            own_ratio = (_cpu_s() - before_s) / ((clock.now_ns() - begun_ns) / NS_PER_S)
            for each in seats:
                assert each.stdout is not None
                os.set_blocking(each.stdout.fileno(), True)
            told = [json.loads(each.communicate()[0].splitlines()[-1]) for each in seats]
        finally:
            for each in seats:
                each.kill()
                each.wait()
    return _summary(told, own_ratio)


class _Wayside:
    """Answers the status of every train."""

    def __init__(self, clock: WallClock, port: RadioPort) -> None:
        self.clock, self._port = clock, port
        self._centre = LineCentre(load_line(LINE), boot=1)

    def serve(self, end_ns: int) -> None:
        while (now_ns := self.clock.now_ns()) < end_ns:
            for message in self._port.receive(now_ns):
                status = unpack(message.payload)
                if isinstance(status, TrainStatus):
                    answer = self._centre.answer(message, status, self.clock.now_ns())
                    if answer is not None:
                        self._port.send(now_ns, *answer)
            self.clock.wait_until(self.clock.now_ns() + BEAT_NS)


def _started_seat(number: int, endpoint: str, statuses: int) -> "subprocess.Popen[str]":
    """The process of one train."""
    module = [sys.executable, "-m", "metro_hil.line.sessions", "--seat"]
    return subprocess.Popen(
        [*module, str(number), endpoint, str(statuses), str(os.getpid())],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )


def _await_all(wayside: _Wayside, seats: Sequence["subprocess.Popen[str]"]) -> None:
    """Serve until every train got its first answer. Raises TimeoutError."""
    for each in seats:
        assert each.stdout is not None
        os.set_blocking(each.stdout.fileno(), False)
    clock, waiting = wayside.clock, set(range(len(seats)))
    end_ns = clock.now_ns() + round(CONNECT_S * NS_PER_S)
    while waiting and clock.now_ns() < end_ns:
        wayside.serve(clock.now_ns() + PERIOD_NS)
        waiting -= {n for n in waiting if _said(seats[n])}
    if waiting:
        raise TimeoutError(f"{len(waiting)} of {len(seats)} trains never got an answer")


def _summary(told: Sequence[dict[str, Any]], own_ratio: float) -> dict[str, float]:
    latencies_ms = sorted([ms for each in told for ms in each["latencies_ms"]])
    return {
        "sent": sum(each["sent"] for each in told),
        "lost": sum(each["sent"] - each["answered"] for each in told),
        "latency_p50_ms": latencies_ms[len(latencies_ms) // 2],
        "latency_p99_ms": latencies_ms[len(latencies_ms) * 99 // 100],
        "cpu_ratio": median(each["cpu_ratio"] for each in told),
        "rss_mib": median(each["rss_mib"] for each in told),
        "wayside_cpu_ratio": own_ratio,
    }


def _said(seat_process: "subprocess.Popen[str]") -> str:
    assert seat_process.stdout is not None
    return seat_process.stdout.readline()


def main(argv: Sequence[str] | None = None) -> int:
    """Run the measurement and print its result. Exit code 1 if a message was lost."""
    parser = argparse.ArgumentParser(prog="python -m metro_hil.line.sessions", description=__doc__)
    parser.add_argument("--trains", type=int, default=50)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--seat", nargs=4, help=argparse.SUPPRESS)
    options = parser.parse_args(argv)
    if options.seat is not None:
        address, endpoint, statuses, parent = options.seat
        seat(int(address), endpoint, int(statuses), int(parent))
        return 0
    found = run(options.trains, options.seconds)
    print(
        f"{options.trains} trains at 5 Hz for {options.seconds:g} s: {found['sent']:.0f} statuses, "
        f"{found['lost']:.0f} lost; answered after {found['latency_p50_ms']:.1f} ms (p50), "
        f"{found['latency_p99_ms']:.1f} ms (p99); each train {found['cpu_ratio'] * 100.0:.1f} % of "
        f"a processor and {found['rss_mib']:.0f} MiB, the wayside "
        f"{found['wayside_cpu_ratio'] * 100.0:.1f} %"
    )
    return 1 if found["lost"] else 0


if __name__ == "__main__":
    sys.exit(main())
