"""A CAN bus of LS-BUS nodes alone, in virtual time."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from firmware_py.buses.bus_node import WireEvent
from firmware_py.buses.inproc import open_bus
from firmware_py.interrupts import never
from firmware_py.settings import SettingsError
from firmware_py.storage.recorder import CandumpWriter
from metro_hil.external_controller.link import LEASE_S
from metro_hil.foreign_plant import ls_bus
from metro_hil.foreign_plant.ls_bus import LsBusError
from metro_hil.foreign_plant.node_process import NodeProcess
from metro_hil.foreign_plant.node_wire import NodeCounts, NodeWire
from metro_hil.foreign_plant.nodes_file import BusNodes

BUS_NAME: Final = "can0"
BIT_RATE: Final = 250_000
"""Bit rate of a bus whose nodes configure none, bit/s: that of the train bus."""
BIT_RATE_MAX: Final = 1_000_000
"""Highest bit rate of classic CAN, bit/s."""
CHUNK_NS: Final = 100_000_000


@dataclass(frozen=True, slots=True)
class BusRun:
    """What happened on the bus."""

    bit_rate: int
    frames: int
    load_ratio: float
    nodes: dict[str, tuple[NodeCounts, int, int]]
    """Counts and the two error counters (TEC, REC) of each node at the end."""
    events: Sequence[WireEvent]
    interrupted: bool


def run_nodes(
    nodes: BusNodes,
    duration_ns: int,
    log: Path | None,
    *,
    bit_rate: int | None = None,
    lease_s: float = LEASE_S,
    interrupted: Callable[[], bool] = never,
) -> BusRun:
    """Run the nodes for this time. Raises SettingsError, PlantDiedError and RecorderError.

    Args:
        log: receives the frames as a candump log.
        bit_rate: of the bus, bit/s; None: that which the nodes configure.
    """
    writer = None if log is None else CandumpWriter(log, BUS_NAME)
    try:
        processes = nodes.start(lease_s)
        try:
            rate = bit_rate or _configured(processes)
            bus = open_bus(BUS_NAME, rate, log=None if writer is None else writer.lines)
            wire = NodeWire(bus, processes, nodes.errors, nodes.filters)
            now_ns = 0
            while now_ns < duration_ns and not interrupted():
                now_ns = min(duration_ns, now_ns + CHUNK_NS)
                bus.advance(now_ns)
        finally:
            for each in processes:
                each.close()
        statistics = bus.statistics()
        return BusRun(
            bit_rate=rate,
            frames=statistics.frames,
            load_ratio=statistics.load_ratio(max(1, now_ns)),
            nodes={
                name: (node.tally(), node.state.errors.tec, node.state.errors.rec)
                for name, node in wire.nodes.items()
            },
            events=wire.events,
            interrupted=now_ns < duration_ns,
        )
    finally:
        if writer is not None:
            writer.close()


def _configured(processes: Sequence[NodeProcess]) -> int:
    """Return the bit rate that the nodes ask for at the start. Raises SettingsError."""
    rates: dict[int, str] = {}
    for each in processes:
        rate = configured_rate(each.sent)
        if rate is not None:
            rates[rate] = each.name
    if len(rates) > 1:
        texts = [f"{name} {rate} bit/s" for rate, name in rates.items()]
        raise SettingsError(f"the nodes want different bit rates: {', '.join(texts)}")
    rate = next(iter(rates), BIT_RATE)
    if rate > BIT_RATE_MAX:
        raise SettingsError(f"node {rates[rate]} wants {rate} bit/s; at most {BIT_RATE_MAX} work")
    return rate


def configured_rate(sent: bytes) -> int | None:
    """Return the last bit rate in these operations; what is malformed is counted elsewhere."""
    found = None
    try:
        for operation in ls_bus.operations(sent):
            if operation.code == ls_bus.CONFIGURATION:
                kind, value = ls_bus.configuration_of(operation)
                found = value if kind == ls_bus.BIT_RATE else found
    except LsBusError:
        pass
    return found
