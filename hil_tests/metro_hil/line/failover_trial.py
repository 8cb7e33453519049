"""Kills and stops masters over real zenoh, and measures how long the others wait for the next."""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

from firmware_py.clock.clock import WallClock
from firmware_py.clock.realtime import enter_realtime
from firmware_py.radio.zenoh_radio import SessionRole, open_radio, pick_endpoint
from firmware_py.storage.checked_store import CheckedStore
from metro_hil.line.network.carrier import PacketCarrier
from metro_hil.line.network.isolated_process import become_apart, words_in
from metro_hil.line.network.options import OwnNetworks, add_options, networks_of
from metro_hil.line.network.packet_process import OWN_ENDPOINT
from metro_hil.line.network.topology import HELP, TOPOLOGIES, Topology, is_peer
from metro_hil.line.standing_train import AXLES, LENGTH_M, LINE, SECTION_M, config_of, front_of
from metro_hil.model.run_options import EXIT_ENVIRONMENT
from metro_hil.model.subprocesses import ChildError
from plant_emulator.wayside.line_wayside import Disks, LineWayside, WaysideTruth
from plant_emulator.wayside.t2t_vocabulary import ArbiterMemory
from zenoh_config import t2t_keys
from zenoh_config.codec import pack
from zenoh_config.t2t import SUPERVISION, LineOrder, OrderKind
from zenoh_config.timers import TIMER_SETS

NS_PER_MS: Final = 1_000_000
NS_PER_S: Final = 1_000_000_000
BEAT_NS: Final = 2 * NS_PER_MS
FRESH_MS: Final = 200
"""Greatest age of any authority when the master is struck."""
SETTLE_MS: Final = 30_000
LIMIT_MS: Final = 3000
SERVICE_RATIO: Final = 0.6
"""Share of the maximum age of an authority beyond which the train brakes."""
SIGNALS: Final = {"kill": signal.SIGKILL, "stop": signal.SIGSTOP}
SWITCH: Final = "switch"
ORDERS: Final = ("cut", "mute", "deafen")
"""Orders for the packet carrier: cut both directions or one."""
NONE: Final = "none"
FAULTS: Final = (*SIGNALS, *ORDERS, SWITCH, NONE)
LATENCY_BAR_MS: Final = 100.0
"""Maximum latency, to which one cycle of the master is added."""
MS_PER_S: Final = 1000.0
BEFORE: Final = 5
"""Real-time priority of the wayside above that of trains, which all wait for it."""
SWITCH_MS: Final = 50


class TakenAuthority(NamedTuple):
    """One authority that a train accepted."""

    at_ns: int
    term: int
    echo_ns: int
    role: str


class TrainProcess:
    """A train's process and its output."""

    def __init__(
        self,
        address: int,
        endpoint: str,
        folder: Path,
        timers: str,
        priority: int,
        network: str | None = None,
        *,
        peer: bool = False,
    ) -> None:
        """`network` is the file of the network that the process joins; None: this program's."""
        self.address = address
        self.taken: list[TakenAuthority] = []
        module, first = "metro_hil.line.standing_train", list[str]()
        if network is not None:
            module, first = words_in(network, module)
        command = [sys.executable, "-m", module, *first, str(address), endpoint]
        self.process = subprocess.Popen(  # Its own module with its own words.
            [
                *(*command, str(folder / f"train{address}"), "--timers", timers),
                *("--priority", str(priority), *(["--peer"] if peer else [])),
            ],
            stdout=subprocess.PIPE,
            text=True,
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.taken.append(TakenAuthority(*json.loads(line)))

    @property
    def last(self) -> TakenAuthority | None:
        return self.taken[-1] if self.taken else None

    def end(self) -> None:
        self.process.kill()
        self.process.wait()
        self._reader.join()


class Round(NamedTuple):
    """Result of one fault; None if not all trains were served."""

    all_served_ms: float | None
    """Time from the fault until every other train had an authority of a new term."""
    oldest_ms: float
    """Greatest age that any other train's authority reached meanwhile."""


class FailoverTrial:
    """The wayside in this process, and trains at rest on one area in their own processes."""

    def __init__(
        self,
        trains: int,
        timers: str,
        folder: Path,
        priority: int = 0,
        networks: OwnNetworks | None = None,
        topology: Topology = Topology.STAR,
    ) -> None:
        """Start the wayside and the trains.

        Raises ChildError if trains cannot have own networks.
        """
        self.clock = WallClock()
        self.seats: dict[int, TrainProcess] = {}
        self._timers, self._folder, self._priority = timers, folder, priority
        self._topology = topology
        self._asked = 0
        self._carrier: PacketCarrier | None = None
        self._endpoint = pick_endpoint() if networks is None else OWN_ENDPOINT
        if networks is not None:
            before = priority + BEFORE if priority else 0
            self._carrier = PacketCarrier(range(1, trains + 1), networks, priority=before)
        config = config_of(timers)
        stores = {
            each: CheckedStore(folder / f"arbiter{each}", ArbiterMemory) for each in config.arbiters
        }
        disks = Disks(
            {each: store.value or ArbiterMemory() for each, store in stores.items()},
            {},
            lambda each, memory: stores[each].put(memory),
            lambda _, memory: True,
        )
        self._wayside = LineWayside(
            config.timers, LINE, disks, boot=1, start_ns=self.clock.now_ns()
        )
        self._truth = WaysideTruth(_axles(range(1, trains + 1)))
        self._beat_ns = self.clock.now_ns()
        self._port = open_radio(
            SessionRole.WAYSIDE, self._endpoint, self._wayside.subscriptions, self.clock
        )
        for address in range(1, trains + 1):
            self.start(address)

    def start(self, address: int) -> None:
        network = None if self._carrier is None else self._carrier.namespaces[address]
        self.seats[address] = TrainProcess(
            *(address, self._endpoint, self._folder, self._timers, self._priority, network),
            peer=is_peer(self._topology, address),
        )

    def close(self) -> None:
        for seat in self.seats.values():
            seat.end()
        self._port.close()
        if self._carrier is not None:
            self._carrier.end()

    def carried(self) -> dict[str, dict[str, int]]:
        """Return packet counts by direction if trains have own networks."""
        return {} if self._carrier is None else self._carrier.counts()

    def run(self, ms: float) -> None:
        """Run the wayside for a while."""
        end_ns = self.clock.now_ns() + round(ms * NS_PER_MS)
        while self.clock.now_ns() < end_ns:
            self._beat_ns = max(self._beat_ns + BEAT_NS, self.clock.now_ns() - BEAT_NS)
            self.clock.wait_until(self._beat_ns)
            now_ns = self.clock.now_ns()
            for key, payload in self._wayside.step(now_ns, self._port.receive(now_ns), self._truth):
                self._port.send(now_ns, key, payload)

    def settle(self) -> int:
        """Wait until one master commands all trains; return its address. Raises TimeoutError."""
        for _ in range(SETTLE_MS // 100):
            self.run(100)
            last = [seat.last for seat in self.seats.values()]
            taken = [each for each in last if each is not None]
            # A train that was struck last reports an old authority until it accepts its next one.
            fresh_ns = self.clock.now_ns() - FRESH_MS * NS_PER_MS
            masters = [a for a, s in self.seats.items() if s.last and s.last.role == "master"]
            if (
                len(taken) == len(last)
                and len({each.term for each in taken}) == 1
                and min(each.echo_ns for each in taken) > fresh_ns
                and len(masters) == 1
            ):
                return masters[0]
        raise TimeoutError("the trains did not settle under one master")

    def fault(self, kind: str) -> Round:
        """Strike the master, wait for the next one, and start the struck one again."""
        if kind == SWITCH:
            return self._switch()
        master = self.settle()
        seat = self.seats[master]
        assert seat.last is not None
        term = seat.last.term
        at_ns = self.clock.now_ns()
        if kind in SIGNALS:
            os.kill(seat.process.pid, SIGNALS[kind])
        else:
            assert self._carrier is not None
            self._carrier.order(kind, master)
        others = [each for a, each in self.seats.items() if a != master]
        for _ in range(LIMIT_MS // 20):
            self.run(20)
            if all(_first_of(each, term) is not None for each in others):
                break
        self.run(200)
        served = [_first_of(each, term) for each in others]
        oldest_ns = max(_oldest_ns(each, at_ns, self.clock.now_ns()) for each in others)
        if kind in SIGNALS:
            seat.end()
            self.start(master)
        else:
            assert self._carrier is not None
            self._carrier.order("heal", master)
        times_ms = [(each - at_ns) / NS_PER_MS for each in served if each is not None]
        complete = len(times_ms) == len(served)
        return Round(max(times_ms) if complete else None, oldest_ns / NS_PER_MS)

    def _switch(self) -> Round:
        """Let supervision request another master until that one commands all trains."""
        master = self.settle()
        last = self.seats[master].last
        assert last is not None
        successor = next(a for a in self.seats if a != master)
        at_ns = self.clock.now_ns()
        for _ in range(LIMIT_MS // SWITCH_MS):
            self._ask(master, successor, last.term)
            self.run(SWITCH_MS)
            if all(_first_of(each, last.term) is not None for each in self.seats.values()):
                break
        self.run(200)
        served = [_first_of(each, last.term) for each in self.seats.values()]
        now_ns = self.clock.now_ns()
        oldest_ns = max(_oldest_ns(each, at_ns, now_ns) for each in self.seats.values())
        times_ms = [(each - at_ns) / NS_PER_MS for each in served if each is not None]
        complete = len(times_ms) == len(served)
        return Round(max(times_ms) if complete else None, oldest_ns / NS_PER_MS)

    def _ask(self, master: int, successor: int, term: int) -> None:
        self._asked += 1
        now_ns = self.clock.now_ns()
        boot = self.clock.epoch_ns() // NS_PER_S
        head = (SUPERVISION, master, 1, term, boot, self._asked, now_ns)
        order = LineOrder(*head, OrderKind.SWITCH_MASTER, successor)
        self._port.send(now_ns, t2t_keys.key_of(LINE.name, order), pack(order))


def _axles(addresses: Sequence[int]) -> dict[int, int]:
    counted: dict[int, int] = {}
    for address in addresses:
        section = int((front_of(address) - LENGTH_M / 2.0) // SECTION_M) + 1
        counted[section] = counted.get(section, 0) + AXLES
    return counted


def _first_of(seat: TrainProcess, term: int) -> int | None:
    return next((each.at_ns for each in seat.taken if each.term > term), None)


def _oldest_ns(seat: TrainProcess, from_ns: int, to_ns: int) -> int:
    """Return the greatest age of a train's authority between two instants."""
    oldest_ns = 0
    following = [each.at_ns for each in seat.taken[1:]] + [to_ns]
    for each, until_ns in zip(seat.taken, following, strict=True):
        if until_ns > from_ns:
            oldest_ns = max(oldest_ns, min(until_ns, to_ns) - each.echo_ns)
    return oldest_ns


def _p99(values_ms: Sequence[float]) -> float:
    return values_ms[min(len(values_ms) - 1, len(values_ms) * 99 // 100)]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the trial and print its result.

    Exit code 1: a train stayed without authority or got it too late. Exit code 3: trains cannot
    have own networks.
    """
    parser = argparse.ArgumentParser(
        prog="python -m metro_hil.line.failover_trial", description=__doc__
    )
    parser.add_argument("--trains", type=int, default=5)
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--fault", choices=sorted(FAULTS), default="kill")
    parser.add_argument(
        "--seconds", type=float, default=20.0, help="duration of `--fault none`; default: 20"
    )
    parser.add_argument("--timers", choices=sorted(TIMER_SETS), default="A")
    parser.add_argument(
        "--priority",
        type=int,
        default=40,
        help="SCHED_FIFO priority of trains; 0: none; default: 40",
    )
    parser.add_argument("--seed", type=int, default=1, help="seed of packet faults; default: 1")
    parser.add_argument("--topology", choices=TOPOLOGIES, default=Topology.STAR.value, help=HELP)
    add_options(parser)
    words = [*(sys.argv[1:] if argv is None else argv)]
    options = parser.parse_args(words)
    networks = networks_of(options, needed=options.fault in ORDERS)
    topology = Topology(options.topology)
    if networks is not None and topology is not Topology.STAR:
        parser.error(f"--topology {options.topology}: own networks lead to the wayside only")
    if networks is not None and not options.apart:
        become_apart("metro_hil.line.failover_trial", [*words, "--apart"])
    with tempfile.TemporaryDirectory() as folder:
        try:
            trial = FailoverTrial(
                *(options.trains, options.timers, Path(folder), options.priority, networks),
                topology,
            )
        except ChildError as error:
            print(error, file=sys.stderr)
            return EXIT_ENVIRONMENT
        if options.priority:
            enter_realtime(options.priority + BEFORE)
        try:
            told = _watch(trial, options) if options.fault == NONE else _strike(trial, options)
            for way, counts in trial.carried().items():
                print(f"{way}: {counts}")
        finally:
            trial.close()
    return told


def _watch(trial: FailoverTrial, options: argparse.Namespace) -> int:
    """Measure, without a fault, the time from a report to the authority that answers it."""
    trial.settle()
    from_ns = trial.clock.now_ns()
    trial.run(options.seconds * MS_PER_S)
    # The master's own authority needs no radio.
    taken = [
        each
        for seat in trial.seats.values()
        for each in seat.taken
        if each.at_ns > from_ns and each.role != "master"
    ]
    latencies_ms = sorted([(each.at_ns - each.echo_ns) / NS_PER_MS for each in taken])
    bar_ms = LATENCY_BAR_MS + TIMER_SETS[options.timers].cycle_ms
    p99_ms = _p99(latencies_ms)
    print(
        f"position to authority, {options.trains} trains, {options.topology}, timers "
        f"{options.timers}, "
        f"{options.seconds:g} s: {len(latencies_ms)} authorities, "
        f"{latencies_ms[len(latencies_ms) // 2]:.0f} ms (p50), {p99_ms:.0f} ms (p99), "
        f"{latencies_ms[-1]:.0f} ms at most; bar: p99 of {bar_ms:.0f} ms"
    )
    return 0 if p99_ms <= bar_ms else 1


def _strike(trial: FailoverTrial, options: argparse.Namespace) -> int:
    rounds = [trial.fault(options.fault) for _ in range(options.rounds)]
    service_ms = TIMER_SETS[options.timers].authority_ms * SERVICE_RATIO
    latencies_ms = sorted(
        [(each.at_ns - each.echo_ns) / NS_PER_MS for s in trial.seats.values() for each in s.taken]
    )
    served_ms = sorted([each.all_served_ms for each in rounds if each.all_served_ms is not None])
    if len(served_ms) < len(rounds):
        print(f"{len(rounds) - len(served_ms)} of {len(rounds)} rounds left a train without")
        return 1
    braked = sum(each.oldest_ms > service_ms for each in rounds)
    half = len(served_ms) // 2
    print(
        f"{options.fault} of the master, {options.trains} trains, {options.topology}, timers "
        f"{options.timers}, "
        f"{len(rounds)} rounds: all others served after {served_ms[0]:.0f} to "
        f"{served_ms[-1]:.0f} ms, median {served_ms[half]:.0f}, p99 {_p99(served_ms):.0f}; "
        f"oldest authority {max(each.oldest_ms for each in rounds):.0f} ms (brakes over "
        f"{service_ms:.0f}); rounds that would have braked: {braked}; report to authority "
        f"{latencies_ms[len(latencies_ms) // 2]:.0f} ms (p50), {_p99(latencies_ms):.0f} ms (p99)"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
