"""Carries packets between the networks of trains and of their wayside, as a separate process.

It prints the file of each train's network, one a line. It obeys `cut NAME`, `mute NAME`, `deafen
NAME`, `heal NAME` and `counts` on standard input, and ends with it.
"""

import argparse
import contextlib
import json
import os
import selectors
import sys
from collections.abc import Sequence
from typing import Final

from firmware_py.clock.clock import WallClock
from firmware_py.clock.realtime import die_with_parent, enter_realtime
from metro_hil.line.network.namespaces import (
    PACKET_BYTES,
    REFUSED,
    NamespaceError,
    cable_away,
    cable_here,
    destination_of,
)
from metro_hil.line.network.packet_faults import Ether, Way
from metro_hil.model.run_options import EXIT_ENVIRONMENT
from metro_hil.simulation.links import NS_PER_MS, Weather

WAYSIDE: Final = "wayside"
WAYSIDE_ADDRESS: Final = "10.144.0.1"
OWN_ENDPOINT: Final = f"tcp/{WAYSIDE_ADDRESS}:7448"
"""Endpoint of the wayside; in its own network every port is free."""
FIRST: Final = 2
"""Last number of the first train's address."""
IDLE_NS: Final = 100_000_000
NS_PER_S: Final = 1e9
ORDER_BYTES: Final = 4096
AT_ONCE: Final = 64
"""Number of packets taken from one device before the next one has its turn."""


class Cables:
    """All devices; packets are forwarded by their destination."""

    def __init__(self, trains: Sequence[str], ether: Ether) -> None:
        """Create the devices. Raises NamespaceError."""
        self._ether, self._clock = ether, WallClock()
        self._files = {WAYSIDE: cable_here("line", WAYSIDE_ADDRESS)}
        self._names = {WAYSIDE_ADDRESS: WAYSIDE}
        self.networks: dict[str, str] = {}
        """File that stands for the network of each train."""
        for number, name in enumerate(trains, start=FIRST):
            address = f"10.144.0.{number}"
            cable = cable_away("radio", address)
            self._files[name] = cable.file
            self._names[address] = name
            self.networks[name] = f"/proc/{os.getpid()}/fd/{cable.namespace}"
        self._selector = selectors.DefaultSelector()
        for name, file in self._files.items():
            self._selector.register(file, selectors.EVENT_READ, name)
        self._selector.register(sys.stdin, selectors.EVENT_READ)

    def step(self) -> bool:
        """Wait for packets, orders, or a due packet; return whether there are orders."""
        ordered = False
        now_ns = self._clock.now_ns()
        due_ns = self._ether.due_ns()
        wait_ns = IDLE_NS if due_ns is None else max(0, due_ns - now_ns)
        for key, _ in self._selector.select(wait_ns / NS_PER_S):
            if key.data is None:
                ordered = True
            else:
                self._read(key.data)
        for target, packet in self._ether.take(self._clock.now_ns()):
            # A full device loses the packet, as a full radio does.
            with contextlib.suppress(OSError):
                os.write(self._files[target], packet)
        return ordered

    def _read(self, source: str) -> None:
        for _ in range(AT_ONCE):
            try:
                packet = os.read(self._files[source], PACKET_BYTES)
            except BlockingIOError:
                return
            target = self._names.get(destination_of(packet) or "")
            if target is not None and target != source:
                self._ether.send(self._clock.now_ns(), (source, target), packet)


def ways_of(order: str, train: str) -> list[Way]:
    """Return the directions of an order. Raises ValueError."""
    out, back = (train, WAYSIDE), (WAYSIDE, train)
    chosen = {"cut": [out, back], "mute": [out], "deafen": [back], "heal": [out, back]}
    if order not in chosen:
        raise ValueError(f"{order}: unknown order")
    return chosen[order]


def _obey(words: Sequence[str], ether: Ether) -> None:
    if words == ["counts"]:
        print(json.dumps(ether.told()), flush=True)
        return
    order, train = words
    change = ether.heal if order == "heal" else ether.cut
    change(ways_of(order, train))


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m metro_hil.line.network.packet_process", description=__doc__
    )
    parser.add_argument("trains", nargs="+")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--delay-ms", type=float, default=0.0)
    parser.add_argument("--jitter-ms", type=float, default=0.0)
    parser.add_argument("--loss", type=float, default=0.0)
    parser.add_argument("--duplicate", type=float, default=0.0)
    parser.add_argument("--priority", type=int, default=0)
    parser.add_argument("--parent", type=int, required=True)
    options = parser.parse_args(argv)
    die_with_parent(options.parent)
    weather = Weather(
        delay_ns=round(options.delay_ms * NS_PER_MS),
        spread_ns=round(options.jitter_ms * NS_PER_MS),
        loss_share=options.loss,
        double_share=options.duplicate,
    )
    ether = Ether(weather, options.seed)
    try:
        cables = Cables(options.trains, ether)
    except NamespaceError as error:
        print(f"{REFUSED}: {error}", flush=True)
        return EXIT_ENVIRONMENT
    for network in cables.networks.values():
        print(network, flush=True)
    if options.priority:
        enter_realtime(options.priority)
    begun = b""
    while True:
        if cables.step():
            # Do not read by lines: a second line in the buffer would wait unseen.
            heard = os.read(sys.stdin.fileno(), ORDER_BYTES)
            if not heard:
                return 0
            *orders, begun = (begun + heard).split(b"\n")
            for each in orders:
                _obey(each.decode().split(), ether)


if __name__ == "__main__":
    sys.exit(main())
