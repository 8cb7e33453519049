"""The file of LS-BUS nodes: the FMUs on the bus, and the times of destroyed frames."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from firmware_py import settings
from firmware_py.settings import SettingsError, nearest
from metro_hil.foreign_plant.node_messages import NodeHello
from metro_hil.foreign_plant.node_process import NodeProcess
from metro_hil.foreign_plant.node_wire import NodeErrors

NS_PER_MS: Final = 1_000_000
NS_PER_S: Final = 1_000_000_000
STEP_MIN_MS: Final = 0.01
STEP_MAX_MS: Final = 1000.0
TIME_MAX_S: Final = 86_400.0
MAX_ID: Final = 0x7FF


@dataclass(frozen=True, slots=True)
class NodeKeys:
    """Keys of one node."""

    fmu: str
    """Path of the FMU, from the folder of the file."""
    name: str = ""
    """Name of the node on the bus; empty: that of the FMU's file."""
    terminal: str = ""
    """Network terminal of FMI-LS-BUS; empty: the only one of the FMU."""
    receives: tuple[int, ...] = ()
    """Identifiers that its acceptance filter lets through; empty: all."""
    step_ms: float = 1.0
    """Greatest step of a node whose transmit clock is a triggered output, ms."""
    parameters: dict[str, float] = field(default_factory=dict)
    """Values of variables before the start."""

    def __post_init__(self) -> None:
        settings.check_ranges(self, {"step_ms": (STEP_MIN_MS, STEP_MAX_MS)})
        for can_id in self.receives:
            if not 0 <= can_id <= MAX_ID:
                raise ValueError(f"receives {can_id:#x} is not within 0..{MAX_ID:#x}")


@dataclass(frozen=True, slots=True)
class ErrorKeys:
    """Keys of a time in which every frame of a node is destroyed."""

    node: str
    from_s: float
    until_s: float

    def __post_init__(self) -> None:
        settings.check_ranges(self, {"from_s": (0.0, TIME_MAX_S), "until_s": (0.0, TIME_MAX_S)})
        if self.until_s <= self.from_s:
            raise ValueError(f"until_s {self.until_s:g} is not after from_s {self.from_s:g}")


@dataclass(frozen=True, slots=True)
class NodesFile:
    """Keys of a file of nodes."""

    node: tuple[NodeKeys, ...] = ()
    error: tuple[ErrorKeys, ...] = ()


@dataclass(frozen=True, slots=True)
class BusNodes:
    """The nodes of one bus, checked; `start` starts their processes."""

    hellos: dict[str, NodeHello]
    filters: dict[str, frozenset[int]]
    errors: tuple[NodeErrors, ...]

    def start(self, lease_s: float) -> list[NodeProcess]:
        """Start the processes side by side. Raises PlantStartError."""
        started: list[NodeProcess] = []
        try:
            for name, hello in self.hellos.items():
                started.append(NodeProcess(name, hello, lease_s))
            for each in started:
                each.greet()
        except BaseException:
            for each in started:
                each.close()
            raise
        return started


def read_nodes(path: Path) -> BusNodes:
    """Read a file of nodes. Raises SettingsError that names file, line, key and value."""
    table = settings.parse(path)
    with settings.located(str(path), settings.text_of(path)):
        keys = settings.build(NodesFile, table, str(path))
        if not keys.node:
            raise SettingsError(f"{path}: node: missing; the file needs at least one [[node]]")
        return nodes_of(keys, path.parent, str(path))


def nodes_of(keys: NodesFile, folder: Path, source: str) -> BusNodes:
    """Name the nodes, and check what the keys say about each other. Raises SettingsError.

    Args:
        source: path of the file; empty for nodes without a file.
    """
    hellos: dict[str, NodeHello] = {}
    filters: dict[str, frozenset[int]] = {}
    for index, each in enumerate(keys.node):
        where = f"{source}: node[{index}]" if source else each.fmu
        name = each.name or Path(each.fmu).stem
        if name in hellos:
            raise SettingsError(f"{where}.name: two nodes are called {name!r}; give one a name")
        hellos[name] = NodeHello(
            source=where,
            fmu=str(folder / each.fmu),
            terminal=each.terminal,
            parameters=dict(each.parameters),
            step_ns=round(each.step_ms * NS_PER_MS),
        )
        if each.receives:
            filters[name] = frozenset(each.receives)
    for index, error in enumerate(keys.error):
        if error.node not in hellos:
            hint = nearest(error.node, list(hellos), "node")
            raise SettingsError(f"{source}: error[{index}].node: {error.node!r}: {hint}")
    return BusNodes(hellos, filters, tuple(_errors(keys.error)))


def _errors(keys: Sequence[ErrorKeys]) -> list[NodeErrors]:
    return [
        NodeErrors(each.node, round(each.from_s * NS_PER_S), round(each.until_s * NS_PER_S))
        for each in keys
    ]
