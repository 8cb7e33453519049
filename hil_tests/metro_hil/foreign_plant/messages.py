"""Messages between the bench and a program that emulates parts of the train.

Each message is one line of JSON. The bench sends first, and every line of it has one answer:

    {"type": "hello", "role": "plant", ...}  ->  {"type": "ready", ...} or {"type": "refuse", ...}
    {"type": "grant", ...}  ->  {"type": "yield", ...}
    {"type": "stop", ...}   ->  {"type": "yield", ...}, and then the program ends
"""

from typing import Any, Final

import msgspec

from firmware_py.grants import decoded

VERSION: Final = 1


class PlantHello(msgspec.Struct, frozen=True, tag="hello"):
    version: int
    told: dict[str, Any]
    """Line, train, mission and start; see the document."""
    role: str = "plant"


class PlantGrant(msgspec.Struct, frozen=True, tag="grant"):
    """The program advances its parts to `now_ns`."""

    now_ns: int
    inputs: dict[str, float]
    """What the bench's own actuators and line do to the train."""
    frames: list[tuple[int, int, str]] = []
    """Frames of the controller since the last grant: instant of the end, identifier, data."""


class PlantStop(msgspec.Struct, frozen=True, tag="stop"):
    now_ns: int


class PlantReady(msgspec.Struct, frozen=True, tag="ready"):
    version: int
    provides: tuple[str, ...]
    """Parts that the program emulates: `motion` and names of nodes."""
    name: str = ""
    frames: tuple[tuple[int, str], ...] = ()
    """Frames that its nodes send at the start."""
    serial: tuple[str, ...] = ()
    """What its tag reader sends at the start."""


class PlantRefuse(msgspec.Struct, frozen=True, tag="refuse"):
    reason: str


class PlantYield(msgspec.Struct, frozen=True, tag="yield"):
    now_ns: int
    """Instant of the answered message."""
    truth: dict[str, float | bool] = {}
    """Truth of the provided parts at `now_ns`."""
    frames: tuple[tuple[int, str], ...] = ()
    serial: tuple[str, ...] = ()


OfBench = PlantHello | PlantGrant | PlantStop
OfPlant = PlantReady | PlantRefuse | PlantYield

_encoder: Final = msgspec.json.Encoder()
_of_plant: Final[msgspec.json.Decoder[OfPlant]] = msgspec.json.Decoder(OfPlant)
_of_bench: Final[msgspec.json.Decoder[OfBench]] = msgspec.json.Decoder(OfBench)


def encode(message: OfBench | OfPlant) -> bytes:
    return _encoder.encode(message) + b"\n"


def read_plant(line: bytes) -> OfPlant:
    """Read a line of the program. Raises GrantProtocolError."""
    return decoded(_of_plant, line)


def read_bench(line: bytes) -> OfBench:
    """Read a line of the bench. Raises GrantProtocolError."""
    return decoded(_of_bench, line)
