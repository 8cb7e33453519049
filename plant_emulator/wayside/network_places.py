"""True places of trains on a network, from the emulated rails to the interlocking; not a radio
message.

Key `m/<network>/p/<train>`: the place of a train on the path of its trip, as a JSON list. Key
`m/<network>/e/<train>`: the answer to that train.
"""

import enum
import math
from typing import Final

import msgspec

from firmware_py.ports import RadioMessage
from zenoh_config.keys import line_chunk
from zenoh_config.t2t import LAST_TRAIN

KEY_CHUNKS: Final = 4


class TrainPresence(enum.IntEnum):
    """Whether a train is on the network."""

    AHEAD = 0
    """It enters later; it asks for the time of the network."""
    DUE = 1
    """It waits for room to enter at this place."""
    PRESENT = 2
    GONE = 3
    """It has made its last trip."""


class TrainPlace(msgspec.Struct, frozen=True, array_like=True):
    """Where a train is, with what the interlocking needs to know of its trip."""

    presence: TrainPresence
    trip: int
    """Number of the trip from 0."""
    path: str
    """Name of the path's line, such as `ferry-out`. All chainages are of this path."""
    front_m: float
    rear_m: float
    end_m: float
    """End of the authority of the train; its front before the first one."""
    to_m: float
    """Last stopping point of the trip."""
    stops_m: tuple[float, ...]
    """Stopping points of the trip in running order."""
    wait_s: float
    """Time until the train may depart; 0 once that is over."""
    at_s: float = 0.0
    """Time of the network at which the train was there; 0 for a train that is not on it."""

    @property
    def is_possible(self) -> bool:
        """Whether all numbers are finite, and the rear is behind the front."""
        numbers = (self.front_m, self.rear_m, self.end_m, self.to_m, self.wait_s, self.at_s)
        finite = all(math.isfinite(each) for each in (*numbers, *self.stops_m))
        return finite and self.rear_m < self.front_m


class WaysideAnswer(msgspec.Struct, frozen=True, array_like=True):
    """Answer to each place of a train."""

    now_ns: int
    """Time of the network."""
    trip: int
    """Number of the trip in the place."""
    is_known: bool
    """Whether the train is on the network."""
    enters: bool
    """The place at which the train waits is kept for it; it enters now."""
    waits: bool
    """A standing train does not depart yet, because a train of another path is before it."""


def key_of_place(network: str, train: int) -> str:
    return f"m/{line_chunk(network)}/p/{train}"


def places(network: str) -> str:
    """Subscription of the wayside."""
    return f"m/{line_chunk(network)}/p/*"


def key_of_answer(network: str, train: int) -> str:
    return f"m/{line_chunk(network)}/e/{train}"


def train_of(key: str) -> int | None:
    """The train that a key of `places` names; None if it names none."""
    chunks = key.split("/")
    number = chunks[-1]
    if len(chunks) != KEY_CHUNKS or not (number.isascii() and number.isdecimal()):
        return None
    return int(number) if 0 < int(number) <= LAST_TRAIN else None


def read_place(message: RadioMessage) -> TrainPlace | None:
    """The place in a message; None if it is not one."""
    try:
        place = msgspec.json.decode(message.payload, type=TrainPlace)
    except msgspec.MsgspecError:
        return None
    return place if place.is_possible else None


def read_answer(message: RadioMessage) -> WaysideAnswer | None:
    """The answer in a message; None if it is not one."""
    try:
        return msgspec.json.decode(message.payload, type=WaysideAnswer)
    except msgspec.MsgspecError:
        return None
