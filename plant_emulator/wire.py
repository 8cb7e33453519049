"""The train's nodes on the bus: the timetable of their frames and the commands that they
receive.
"""

from collections import Counter
from collections.abc import Callable, Collection, Mapping
from typing import Final, NamedTuple, Protocol

from can_dbc.alarms import TrainAlarms
from can_dbc.analogue import AnalogueCommand
from can_dbc.binding import Frame, binding_of, can_id, period_s, sender
from can_dbc.brake import BrakeCommand, BrakeStatus
from can_dbc.cab import Desk
from can_dbc.codec import Decoder, Encoder, Rejected
from can_dbc.diagnostics import EMERGENCIES, HEARTBEATS, TcmsStatus, TimeOfDay
from can_dbc.doors import DoorCars, DoorCommand, DoorStatus
from can_dbc.energy import EnergyMeter, LineSupply
from can_dbc.nodes import Node
from can_dbc.odometer import ColdMovement, Doppler, Imu, Tacho
from can_dbc.tags import TagReaderHealth
from can_dbc.traction import TractionCommand, TractionStatus
from firmware_py.ports import CanPort

GRID_MS: Final = 10
"""Step of the plant, ms. The nodes send only at its multiples."""
ROUND_MS: Final = 1000
"""Length of the timetable, ms; every period divides it."""
COMMANDS: Final[tuple[type[Frame], ...]] = (
    BrakeCommand,
    TractionCommand,
    DoorCommand,
    DoorCars,
    AnalogueCommand,
)
COMMAND_IDS: Final = frozenset(
    message.frame_id for kind in COMMANDS for message in binding_of(kind).messages
)
"""Identifiers that a port for all nodes must receive."""
EARS: Final = Node.BCU
"""The node whose port receives all commands. On a real bus every node receives every frame."""
PLANT_NODES: Final[tuple[Node, ...]] = tuple(node for node in Node if node is not Node.VOBC)

PHASES_MS: Final[Mapping[type[Frame], int]] = {
    Tacho: 0,
    BrakeStatus: 10,
    TractionStatus: 20,
    Doppler: 30,
    Imu: 40,
    DoorStatus: 30,
    Desk: 70,
    LineSupply: 50,
    TagReaderHealth: 60,
    TcmsStatus: 90,
    TrainAlarms: 80,
    ColdMovement: 360,
    EnergyMeter: 350,
    TimeOfDay: 550,
    **{HEARTBEATS[node]: 100 * node.value - 30 for node in PLANT_NODES},
}
"""Offset of each frame within its period. The offsets differ so that the nodes do not all send at
once."""

OpenPort = Callable[[Node, frozenset[int]], CanPort]
"""Opens a port for a node that receives these identifiers; one port may serve several nodes."""


class ReceivedCommand(NamedTuple):
    """A command that passed every check, and the instant at which its last bit was received."""

    command: Frame
    heard_ns: int


class Sending(NamedTuple):
    """One entry of the timetable: a frame and the node that sends it."""

    kind: type[Frame]
    node: Node


class CommandSink(Protocol):
    def __call__(self, command: Frame, heard_ns: int) -> None: ...


class Wire:
    """Sends frames through each node's own port and receives all commands through one port."""

    def __init__(self, open_port: OpenPort, also: tuple[type[Frame], ...] = ()) -> None:
        """Args:
        also: frames that the sink receives besides the commands; they are not counted as commands.
        """
        self._decoder = Decoder((*COMMANDS, *also))
        self._also = also
        self._encoder = Encoder((*PHASES_MS, *(EMERGENCIES[node] for node in PLANT_NODES)))
        ids = self._decoder.ids
        self._ports: dict[Node, CanPort] = {
            node: open_port(node, ids if node is EARS else frozenset()) for node in PLANT_NODES
        }
        self._listener = self._ports[EARS]
        self.refused = 0
        """Number of rejected frames; `refusals` lists the reasons."""
        self.commands = 0

    @property
    def refusals(self) -> Mapping[str, int]:
        """Rejection counts by identifier and reason."""
        counted: Counter[str] = Counter()
        for (identifier, reason), count in self._decoder.rejections.items():
            counted[f"{identifier:#05x} {reason.name.lower().replace('_', ' ')}"] += count
        return counted

    def hear(self, now_ns: int, sink: CommandSink) -> None:
        """Pass each complete command to `sink`, in the order in which the bus carried them."""
        frames = self._listener.receive(now_ns)
        if not frames:
            return
        decode = self._decoder.decode
        for frame in frames:
            if frame.extended or frame.remote or frame.error:
                self.refused += 1
                continue
            heard = decode(frame.can_id, frame.data, frame.stamp_ns)
            if heard is None:
                continue
            if isinstance(heard, Rejected):
                self.refused += 1
                continue
            if not isinstance(heard, self._also):
                self.commands += 1
            sink(heard, frame.stamp_ns)

    def restart(self, node: Node) -> None:
        """The node has restarted: the alive counters of all its frames begin again."""
        for kind in PHASES_MS:
            if Node[sender(kind)] is node:
                self._encoder.restart(kind)

    def forward(self, now_ns: int, node: Node, can_id: int, data: bytes) -> None:
        """Send a frame that another program has encoded, through the port of its node."""
        self._ports[node].send(now_ns, can_id, data)

    def send(self, now_ns: int, node: Node, frame: Frame) -> None:
        port = self._ports[node]
        for identifier, data in self._encoder.encode(frame):
            port.send(now_ns, identifier, data)


def timetable(absent: Collection[Node] = ()) -> tuple[tuple[Sending, ...], ...]:
    """Return the frames to send in each slot of GRID_MS, lower identifiers first.

    `absent` nodes send nothing. Raises ValueError for a period in the DBC files that is not a
    multiple of the grid.
    """
    slots: list[list[Sending]] = [[] for _ in range(ROUND_MS // GRID_MS)]
    for kind in sorted(PHASES_MS, key=can_id):
        period_ms = round(1000.0 * period_s(kind))
        if period_ms <= 0 or period_ms % GRID_MS or ROUND_MS % period_ms:
            raise ValueError(
                f"{kind.__name__}: period of {period_ms} ms is not on the plant's grid"
            )
        if Node[sender(kind)] in absent:
            continue
        for at_ms in range(PHASES_MS[kind] % period_ms, ROUND_MS, period_ms):
            slots[at_ms // GRID_MS].append(Sending(kind, Node[sender(kind)]))
    return tuple(tuple(slot) for slot in slots)
