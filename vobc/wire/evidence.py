"""Evidence for the facts of a cycle: the frame, telegram or message that carried them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from can_dbc.alarms import TrainAlarms
from can_dbc.binding import Frame, can_id
from can_dbc.brake import BrakeStatus
from can_dbc.cab import Desk
from can_dbc.doors import DoorStatus
from can_dbc.energy import LineSupply
from can_dbc.odometer import ColdMovement, Doppler, Imu, Tacho
from can_dbc.tags import TagReaderHealth
from can_dbc.traction import TractionStatus
from vobc.vocabulary import Source

SOURCE_KINDS: Final[Mapping[Source, type[Frame]]] = {
    Source.TACHO: Tacho,
    Source.DOPPLER: Doppler,
    Source.IMU: Imu,
    Source.COLD: ColdMovement,
    Source.BRAKE: BrakeStatus,
    Source.TRACTION: TractionStatus,
    Source.DOORS: DoorStatus,
    Source.DESK: Desk,
    Source.TAG_READER: TagReaderHealth,
    Source.ALARMS: TrainAlarms,
    Source.SUPPLY: LineSupply,
}
"""Sources that are frames of the train bus."""
SOURCE_IDS: Final[Mapping[Source, int]] = {
    source: can_id(kind) for source, kind in SOURCE_KINDS.items()
}


@dataclass(frozen=True, slots=True)
class Evidence:
    """Last message of one source, as it was on the wire."""

    source: Source
    number: int
    """Identifier of the frame, id of the tag, or sequence number of the message."""
    payload: bytes
    """Complete bytes, including alive counter, CRC and safety envelope."""
    received_at_ns: int
