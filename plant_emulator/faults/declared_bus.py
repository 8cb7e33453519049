"""Faults of the train bus. `frames` names messages of the DBC files, with * and ? as in a shell."""

import enum
from dataclasses import dataclass

from can_dbc.nodes import Node
from plant_emulator.faults.kinds import FaultPlace, Hazard, check_range, fault


class FrameDirection(enum.Enum):
    """Direction of the frames that a fault affects."""

    TO_TRAIN = "to_train"
    TO_VOBC = "to_vobc"
    BOTH = "both"


class DamagePlace(enum.Enum):
    """Place where the bits are flipped, which decides which check detects it."""

    ON_WIRE = "on_wire"
    """Bits flip on the wire: the bus detects it, sends an error frame, counts it, and the sender
    repeats."""
    AFTER_CRC = "after_crc"
    """Bits flip in a mailbox or gateway: the bus accepts the frame and the codec's CRC does not
    match."""
    BEFORE_CRC = "before_crc"
    """Bits flip in the sender's memory: every check passes and the value is wrong."""


@fault("frame_drop", FaultPlace.BUS, Hazard.OVERRUN, Hazard.LOST_SERVICE)
@dataclass(frozen=True, slots=True)
class FrameDrop:
    """Frames between the controller and the train are lost."""

    frames: str = "*"
    way: FrameDirection = FrameDirection.BOTH
    loss_ratio: float = 1.0

    def __post_init__(self) -> None:
        check_range(self, "loss_ratio", 0.0, 1.0)


@fault("frame_delay", FaultPlace.BUS, Hazard.MISLOCATED, Hazard.OVERRUN)
@dataclass(frozen=True, slots=True)
class FrameDelay:
    """Frames arrive late, each by the delay plus up to the jitter; their order does not change."""

    frames: str = "*"
    way: FrameDirection = FrameDirection.BOTH
    delay_s: float = 0.05
    jitter_s: float = 0.0

    def __post_init__(self) -> None:
        check_range(self, "delay_s", 0.0, 60.0)
        check_range(self, "jitter_s", 0.0, 60.0)


@fault("frame_duplicate", FaultPlace.BUS, Hazard.WRONG_COMMAND)
@dataclass(frozen=True, slots=True)
class FrameDuplicate:
    """Frames arrive again after a while."""

    frames: str = "*"
    way: FrameDirection = FrameDirection.BOTH
    share_ratio: float = 1.0
    copies: int = 1
    gap_s: float = 0.001
    """Time between one copy and the next."""

    def __post_init__(self) -> None:
        check_range(self, "share_ratio", 0.0, 1.0)
        check_range(self, "copies", 1, 100)
        check_range(self, "gap_s", 0.0, 60.0)


@fault("frame_reorder", FaultPlace.BUS, Hazard.MISLOCATED, Hazard.WRONG_COMMAND)
@dataclass(frozen=True, slots=True)
class FrameReorder:
    """A share of the frames is delayed so that later ones overtake them."""

    frames: str = "*"
    way: FrameDirection = FrameDirection.BOTH
    share_ratio: float = 0.5
    hold_s: float = 0.06

    def __post_init__(self) -> None:
        check_range(self, "share_ratio", 0.0, 1.0)
        check_range(self, "hold_s", 0.0, 60.0)


@fault("frame_replay", FaultPlace.BUS, Hazard.WRONG_COMMAND)
@dataclass(frozen=True, slots=True)
class FrameReplay:
    """Frames from before the fault are repeated in their old timing, in addition to the current
    ones.
    """

    frames: str = "*"
    way: FrameDirection = FrameDirection.TO_TRAIN
    memory_s: float = 1.0
    """Length of the recording that is repeated in a loop."""

    def __post_init__(self) -> None:
        check_range(self, "memory_s", 0.01, 60.0)


@fault("frame_corrupt", FaultPlace.BUS, Hazard.WRONG_COMMAND, Hazard.OVERRUN)
@dataclass(frozen=True, slots=True)
class FrameCorrupt:
    """Bits of frames are flipped."""

    frames: str = "*"
    way: FrameDirection = FrameDirection.BOTH
    share_ratio: float = 1.0
    bits: int = 1
    damage: DamagePlace = DamagePlace.AFTER_CRC

    def __post_init__(self) -> None:
        check_range(self, "share_ratio", 0.0, 1.0)
        check_range(self, "bits", 1, 64)


@fault("masquerade", FaultPlace.BUS, Hazard.WRONG_COMMAND)
@dataclass(frozen=True, slots=True)
class Masquerade:
    """A foreign node sends a message of another node, with its own values and a valid CRC."""

    frame: str = "BRAKE_CMD"
    values: dict[str, float] | None = None
    """Signals that the foreign node sets; the others keep the values of the last genuine frame."""
    period_s: float = 0.05
    twins: bool = True
    """Whether the foreign node also sends the inverted twin of a vital message."""

    def __post_init__(self) -> None:
        check_range(self, "period_s", 0.001, 60.0)


@fault("babbling_idiot", FaultPlace.BUS, Hazard.OVERRUN, Hazard.LOST_SERVICE)
@dataclass(frozen=True, slots=True)
class BabblingIdiot:
    """A node sends without pause and takes the bus from all nodes with a higher identifier."""

    can_id: int = 0
    load_ratio: float = 1.0
    """Share of the bus that the node fills while no other node wins arbitration."""

    def __post_init__(self) -> None:
        check_range(self, "can_id", 0, 0x7FF)
        check_range(self, "load_ratio", 0.01, 1.0)


@fault("bus_off", FaultPlace.BUS, Hazard.OVERRUN, Hazard.LOST_SERVICE)
@dataclass(frozen=True, slots=True)
class BusOff:
    """Every frame of a node is destroyed until its error counter takes the node off the bus.

    After the fault the node returns when it has seen 128 times 11 recessive bits, if `recovers`.
    """

    node: Node = Node.VOBC
    recovers: bool = True


@fault("link_cut", FaultPlace.BUS, Hazard.OVERRUN, Hazard.LOST_SERVICE)
@dataclass(frozen=True, slots=True)
class LinkCut:
    """The wire to one node is cut: the node can neither send nor receive."""

    node: Node = Node.VOBC
