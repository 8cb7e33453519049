"""Faults of the train bus. `frames` names messages of the DBC files, with * and ? as in a shell."""

import enum
from dataclasses import dataclass

from can_dbc.nodes import Node
from plant_emulator.faults.kinds import FaultPlace, Hazard, check_range, fault


class FrameDirection(enum.Enum):
    """Which frames, seen from the controller."""

    TO_TRAIN = "to_train"
    TO_VOBC = "to_vobc"
    BOTH = "both"


class DamagePlace(enum.Enum):
    """Where the bits are flipped, and so who can see it."""

    ON_WIRE = "on_wire"
    """The bus's own check sees it: error frame, error counters, the sender repeats."""
    AFTER_CRC = "after_crc"
    """In a mailbox or gateway: the bus sees a good frame, the codec's CRC does not fit."""
    BEFORE_CRC = "before_crc"
    """In the sender's memory: every check passes and the value is wrong."""


@fault("frame_drop", FaultPlace.BUS, Hazard.OVERRUN, Hazard.LOST_SERVICE)
@dataclass(frozen=True, slots=True)
class FrameDrop:
    """Frames vanish between the controller and the train."""

    frames: str = "*"
    way: FrameDirection = FrameDirection.BOTH
    loss_ratio: float = 1.0

    def __post_init__(self) -> None:
        check_range(self, "loss_ratio", 0.0, 1.0)


@fault("frame_delay", FaultPlace.BUS, Hazard.MISLOCATED, Hazard.OVERRUN)
@dataclass(frozen=True, slots=True)
class FrameDelay:
    """Frames arrive late, each by the delay and up to the jitter more; their order stays."""

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
    """Between one copy and the next."""

    def __post_init__(self) -> None:
        check_range(self, "share_ratio", 0.0, 1.0)
        check_range(self, "copies", 1, 100)
        check_range(self, "gap_s", 0.0, 60.0)


@fault("frame_reorder", FaultPlace.BUS, Hazard.MISLOCATED, Hazard.WRONG_COMMAND)
@dataclass(frozen=True, slots=True)
class FrameReorder:
    """A share of the frames is held back so that later ones overtake them."""

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
    """What was said before the fault is said again, in its old rhythm, beside what is said now."""

    frames: str = "*"
    way: FrameDirection = FrameDirection.TO_TRAIN
    memory_s: float = 1.0
    """How much of the past is repeated, over and over."""

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
    """A stranger sends a message of another node, with values of its own and a valid CRC."""

    frame: str = "BRAKE_CMD"
    values: dict[str, float] | None = None
    """Signals that the stranger sets; the rest is as in the last genuine frame."""
    period_s: float = 0.05
    twins: bool = True
    """Whether it also sends the inverted twin of a vital message."""

    def __post_init__(self) -> None:
        check_range(self, "period_s", 0.001, 60.0)


@fault("babbling_idiot", FaultPlace.BUS, Hazard.OVERRUN, Hazard.LOST_SERVICE)
@dataclass(frozen=True, slots=True)
class BabblingIdiot:
    """A node sends without pause and takes the bus from all with a higher identifier."""

    can_id: int = 0
    load_ratio: float = 1.0
    """Share of the bus that it fills when nobody else wins."""

    def __post_init__(self) -> None:
        check_range(self, "can_id", 0, 0x7FF)
        check_range(self, "load_ratio", 0.01, 1.0)


@fault("bus_off", FaultPlace.BUS, Hazard.OVERRUN, Hazard.LOST_SERVICE)
@dataclass(frozen=True, slots=True)
class BusOff:
    """A node's every frame is destroyed until its error counter takes it off the bus.

    After the fault it comes back when it has seen 128 times 11 recessive bits, if `recovers`.
    """

    node: Node = Node.VOBC
    recovers: bool = True


@fault("link_cut", FaultPlace.BUS, Hazard.OVERRUN, Hazard.LOST_SERVICE)
@dataclass(frozen=True, slots=True)
class LinkCut:
    """The wire to one node is cut: it is neither heard nor does it hear."""

    node: Node = Node.VOBC
