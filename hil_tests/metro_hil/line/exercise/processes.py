"""All programs of a line as processes: the wayside, and bus, plant and controller of each train."""

import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Final

from firmware_py.buses import open_can
from firmware_py.buses.hub_control import start_hub
from firmware_py.clock.clock import WallClock
from metro_hil.line.exercise.plan import PlannedRun
from metro_hil.line.exercise.taps import RECEIVED_IDS, ProtectionTap
from metro_hil.line.network.carrier import PacketCarrier
from metro_hil.line.network.isolated_process import words_in
from metro_hil.line.network.options import OwnNetworks
from metro_hil.line.network.topology import Topology, is_peer
from metro_hil.model.subprocesses import Child

WAYSIDE: Final = "wayside"
BEFORE: Final = 5
"""Real-time priority of the wayside above that of trains, which all wait for it."""
BEHIND: Final = 10
"""Real-time priority of plants below that of controllers; plants may be a little late."""


class LineProcesses:
    """Starts the processes, strikes them and starts them again; all end with the stack."""

    def __init__(
        self,
        folder: Path,
        line: str,
        endpoint: str,
        stack: ExitStack,
        *,
        timers: str = "A",
        arbiters: int = 1,
        relayed: bool = False,
        networks: OwnNetworks | None = None,
        trains: int = 0,
        priority: int = 0,
        secure: Path | None = None,
        topology: Topology = Topology.STAR,
    ) -> None:
        """Prepare the processes.

        Args:
            relayed: trains reach the wayside over a relay that can be cut.
            networks: each controller gets its own network, which can also be cut one way. Then this
                program must have its own network as well.
            priority: SCHED_FIFO priority of controllers if permitted; plants are a little lower; 0:
                none.
            secure: folder with the certificates and keys of all programs.
        """
        self.children: dict[str, Child] = {}
        self._folder, self._line, self._endpoint, self._stack = folder, line, endpoint, stack
        self._of_line = ["--line-timers", timers, "--arbiters", str(arbiters)]
        self._priority, self._topology = priority, topology
        # The user has confirmed an open network, or it is one of this bench alone.
        self._secure = ["--insecure"] if secure is None else ["--secure", str(secure)]
        self._ways: dict[int, PlannedRun] = {}
        self._lives: dict[int, int] = {}
        self._relay: subprocess.Popen[str] | None = None
        self._endpoints: dict[int, str] = {}
        self._carrier: PacketCarrier | None = None
        numbers = range(1, trains + 1)
        if networks is not None:
            before = min(99, priority + BEFORE) if priority else 0
            self._carrier = PacketCarrier(numbers, networks, priority=before)
            stack.callback(self._carrier.end)
        elif relayed:
            self._start_relay(numbers)

    def start_wayside(self) -> None:
        arguments = ["wayside", "--line", self._line, "--line-radio", self._endpoint]
        arguments += [*self._of_line, *self._secure, "--memory", str(self._folder / "wayside")]
        if self._priority:
            arguments += ["--priority", str(min(99, self._priority + BEFORE))]
        self._adopt(WAYSIDE, "plant_emulator", arguments, self._folder / "wayside.log")

    def start_plant(self, train: int, way: PlannedRun) -> None:
        """Start a train's bus and plant. Raises BusError if the bus cannot be started."""
        self._ways[train] = way
        hub = start_hub(_bus(train), bound=True)
        self._stack.callback(hub.stop)
        folder = self._folder_of(train)
        arguments = ["run", "--line", self._line, "--bus", f"embedded:{_bus(train)}"]
        arguments += ["--from", way.start, "--to", way.end, "--seed", str(train)]
        arguments += ["--train", str(train), "--line-radio", self._endpoint]
        arguments += ["--priority", str(max(0, self._priority - BEHIND))]
        arguments += ["--out", str(folder), *self._secure]
        self._adopt(f"plant {train}", "plant_emulator", arguments, folder / "plant.log")

    def tap(self, train: int) -> ProtectionTap:
        """Open a tap on a train's bus. Raises BusError."""
        port = open_can(
            f"embedded:{_bus(train)}", clock=WallClock(), node="TAP", accept_ids=RECEIVED_IDS
        )
        self._stack.callback(port.close)
        return ProtectionTap(train, port)

    def start_controller(self, train: int) -> None:
        """Start a controller.

        A restarted one uses its memory: position, acknowledged terms, boot count.
        """
        life = self._lives[train] = self._lives.get(train, 0) + 1
        folder, way = self._folder_of(train), self._ways[train]
        out = folder if life == 1 else folder / f"life{life}"
        arguments = ["device", "--line", self._line, "--bus", f"embedded:{_bus(train)}"]
        arguments += ["--train", str(train), "--out", str(out)]
        arguments += ["--priority", str(self._priority)]
        arguments += ["--line-radio", self._endpoints.get(train, self._endpoint), *self._of_line]
        arguments += ["--nvram", str(folder / "nvram"), "--line-memory", str(folder / "promises")]
        arguments += ["--to", way.end, *self._secure]
        if is_peer(self._topology, train):
            arguments += ["--line-peer"]
        if life == 1:
            arguments += ["--from", way.start]
        module = "vobc"
        if self._carrier is not None:
            module, first = words_in(self._carrier.namespaces[train], module)
            arguments = [*first, *arguments]
        self._adopt(f"controller {train}", module, arguments, folder / "vobc.log")

    def strike(self, name: str, number: signal.Signals) -> None:
        self.children[name].signal_group(number)

    def order(self, order: str, train: int) -> None:
        """Order `cut` or `heal`; with own networks also `mute` and `deafen`."""
        if self._carrier is not None:
            self._carrier.order(order, train)
            return
        assert self._relay is not None
        assert self._relay.stdin is not None
        self._relay.stdin.write(f"{order} T{train}\n")
        self._relay.stdin.flush()

    def carried(self) -> dict[str, dict[str, int]]:
        """Return packet counts by direction; empty without own networks."""
        return {} if self._carrier is None else self._carrier.counts()

    def ended(self) -> list[Child]:
        return [each for each in self.children.values() if each.ended]

    def _start_relay(self, trains: Sequence[int]) -> None:
        host, _, port = self._endpoint.removeprefix("tcp/").rpartition(":")
        words = [sys.executable, "-m", "metro_hil.line.exercise.relay", host, port]
        words += [*[f"T{each}" for each in trains], "--parent", str(os.getpid())]
        self._relay = subprocess.Popen(
            words,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        self._stack.callback(self._end_relay)
        assert self._relay.stdout is not None
        for train in trains:
            self._endpoints[train] = f"tcp/127.0.0.1:{self._relay.stdout.readline().split()[1]}"

    def _end_relay(self) -> None:
        assert self._relay is not None
        self._relay.kill()
        self._relay.communicate()

    def _folder_of(self, train: int) -> Path:
        folder = self._folder / f"train{train}"
        folder.mkdir(exist_ok=True)
        return folder

    def _adopt(self, name: str, module: str, arguments: list[str], log: Path) -> None:
        before = self.children.get(name)
        if before is not None:
            before.end()
        child = self.children[name] = Child(name, module, arguments, log)
        self._stack.callback(child.end)


def _bus(train: int) -> str:
    """Name of a bus that is unique on this machine."""
    return f"r{os.getpid()}t{train}"
