"""Messages between a bench in virtual time and a controller in another process.

Each message is one line of JSON. The bench sends first, and every line of it has one answer:

    {"type": "hello", ...}  ->  {"type": "ready", ...} or {"type": "refuse", ...}
    {"type": "grant", ...}  ->  {"type": "yield", ...}
    {"type": "stop", ...}   ->  {"type": "yield", ...}, and then the controller ends

Bytes are hexadecimal; instants are whole nanoseconds of the bench's virtual time. A side must
ignore unknown members. `docs/reference/lockstep_interface.md` is the contract. A controller may ask
in `ready` for the binary form of the messages after it (`firmware_py.binary_grants`).
"""

from collections.abc import Iterable
from typing import Any, Final, NamedTuple, Protocol, TypeVar

import msgspec

from firmware_py.handed_ports import SentOutputs
from firmware_py.ports import CanFrame, RadioMessage, SerialChunk

VERSION: Final = 1
LINE_BYTES_MAX: Final = 1 << 20
STANDARD_ID_MAX: Final = 0x7FF
FRAME_BYTES_MAX: Final = 8
JSON: Final = "json"
BINARY: Final = "binary"

HeardFrame = tuple[int, int, str]
"""Instant of the frame's end, identifier, data."""
HeardChunk = tuple[int, str]
"""Instant of the last byte, bytes."""
HeardMessage = tuple[int, str, str]
"""Instant, key, payload."""


class Hello(msgspec.Struct, frozen=True, tag="hello"):
    version: int
    told: dict[str, Any]
    """Line, parameters, mission, memory and start of the train; see the document."""
    forms: tuple[str, ...] = (JSON, BINARY)
    """Forms of the later messages that the controller may choose."""


class Grant(msgspec.Struct, frozen=True, tag="grant"):
    """Time grant: the instant is `now_ns`, with the inputs since the last grant."""

    now_ns: int
    frames: tuple[HeardFrame, ...] = ()
    serial: tuple[HeardChunk, ...] = ()
    radio: tuple[HeardMessage, ...] = ()


class Stop(msgspec.Struct, frozen=True, tag="stop"):
    """The run is over; the controller may send its final outputs."""

    now_ns: int


class Ready(msgspec.Struct, frozen=True, tag="ready"):
    version: int
    next_wakeup_ns: int
    name: str = ""
    """Name of the controller, for reports."""
    form: str = JSON
    """Form of all messages after this one."""


class Refuse(msgspec.Struct, frozen=True, tag="refuse"):
    reason: str


class Yield(msgspec.Struct, frozen=True, tag="yield"):
    """Outputs sent now; the controller does nothing more before `next_wakeup_ns`."""

    now_ns: int
    """Instant of the answered message, so that answers cannot be confused."""
    next_wakeup_ns: int
    """Next wake-up; an instant not later than now means at once."""
    frames: tuple[tuple[int, str], ...] = ()
    serial: tuple[str, ...] = ()
    radio: tuple[tuple[str, str], ...] = ()


OfBench = Hello | Grant | Stop
OfController = Ready | Refuse | Yield

M = TypeVar("M")

_encoder: Final = msgspec.json.Encoder()
_of_bench: Final[msgspec.json.Decoder[OfBench]] = msgspec.json.Decoder(OfBench)
_of_controller: Final[msgspec.json.Decoder[OfController]] = msgspec.json.Decoder(OfController)


class GrantProtocolError(Exception):
    """A line that violates the protocol; the text says how."""


class Answer(NamedTuple):
    """A yield, decoded."""

    now_ns: int
    next_wakeup_ns: int
    said: SentOutputs


class Form(Protocol):
    """How messages after `ready` become bytes."""

    def grant(
        self,
        now_ns: int,
        frames: Iterable[CanFrame],
        chunks: Iterable[SerialChunk],
        messages: Iterable[RadioMessage],
    ) -> bytes: ...

    def stop(self, now_ns: int) -> bytes: ...

    def end(self, received: bytearray) -> int:
        """Length of the first message of what was received; 0 while it is incomplete.

        Raises GrantProtocolError for a message that is too long.
        """
        ...

    def answer(self, message: bytes) -> Answer:
        """Read a yield. Raises GrantProtocolError."""
        ...


class JsonForm:
    """Lines of JSON."""

    def grant(
        self,
        now_ns: int,
        frames: Iterable[CanFrame],
        chunks: Iterable[SerialChunk],
        messages: Iterable[RadioMessage],
    ) -> bytes:
        return encode(grant(now_ns, frames, chunks, messages))

    def stop(self, now_ns: int) -> bytes:
        return encode(Stop(now_ns))

    def end(self, received: bytearray) -> int:
        end = received.find(b"\n") + 1
        if not end and len(received) > LINE_BYTES_MAX:
            raise GrantProtocolError(f"a line of over {LINE_BYTES_MAX} bytes")
        return end

    def answer(self, message: bytes) -> Answer:
        answer = read_controller(message)
        if not isinstance(answer, Yield):
            raise GrantProtocolError("answers with no yield")
        return Answer(answer.now_ns, answer.next_wakeup_ns, said(answer))


def encode(message: OfBench | OfController) -> bytes:
    return _encoder.encode(message) + b"\n"


def read_bench(line: bytes) -> OfBench:
    """Read a line of the bench. Raises GrantProtocolError."""
    return decoded(_of_bench, line)


def read_controller(line: bytes) -> OfController:
    """Read a line of the controller. Raises GrantProtocolError."""
    return decoded(_of_controller, line)


def decoded(decoder: msgspec.json.Decoder[M], line: bytes) -> M:
    """Decode a line of this or a related protocol. Raises GrantProtocolError, which shows it."""
    try:
        return decoder.decode(line)
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise GrantProtocolError(f"{_shown(line)}: {error}") from error


def grant(
    now_ns: int,
    frames: Iterable[CanFrame],
    chunks: Iterable[SerialChunk],
    messages: Iterable[RadioMessage],
) -> Grant:
    """Build a grant.

    Only classic data frames with 11-bit identifiers are passed on; a controller ignores all others.
    """
    return Grant(
        now_ns,
        tuple(
            [
                (frame.stamp_ns, frame.can_id, frame.data.hex())
                for frame in frames
                if not (frame.extended or frame.remote or frame.error)
            ]
        ),
        tuple([(chunk.stamp_ns, chunk.data.hex()) for chunk in chunks]),
        tuple([(heard.stamp_ns, heard.key, heard.payload.hex()) for heard in messages]),
    )


def heard_frames(message: Grant) -> list[CanFrame]:
    return [
        CanFrame(stamp_ns, can_id, bytes.fromhex(data)) for stamp_ns, can_id, data in message.frames
    ]


def heard_chunks(message: Grant) -> list[SerialChunk]:
    return [SerialChunk(stamp_ns, bytes.fromhex(data)) for stamp_ns, data in message.serial]


def heard_messages(message: Grant) -> list[RadioMessage]:
    return [RadioMessage(at_ns, key, bytes.fromhex(data)) for at_ns, key, data in message.radio]


def yielded(now_ns: int, next_wakeup_ns: int, said: SentOutputs) -> Yield:
    return Yield(
        now_ns,
        next_wakeup_ns,
        tuple([(can_id, data.hex()) for can_id, data in said.frames]),
        tuple([data.hex() for data in said.serial]),
        tuple([(key, payload.hex()) for key, payload in said.radio]),
    )


def said(message: Yield) -> SentOutputs:
    """Decode the outputs of a yield.

    Raises GrantProtocolError for outputs that no link can carry.
    """
    for can_id, _ in message.frames:
        if not 0 <= can_id <= STANDARD_ID_MAX:
            raise GrantProtocolError(f"frames: identifier {can_id} is not in 0..{STANDARD_ID_MAX}")
    frames = [(can_id, _bytes("frames", data)) for can_id, data in message.frames]
    for can_id, payload in frames:
        if len(payload) > FRAME_BYTES_MAX:
            raise GrantProtocolError(f"frames: {can_id:03X} has {len(payload)} bytes, over 8")
    return SentOutputs(
        tuple(frames),
        tuple([_bytes("serial", data) for data in message.serial]),
        tuple([(checked_key(key), _bytes("radio", data)) for key, data in message.radio]),
    )


def checked_key(key: str) -> str:
    """Return the key of a radio message. Raises GrantProtocolError for one that is none."""
    if not key or set(key) & set("*$#? \n"):
        raise GrantProtocolError(f"radio: {key!r} is not a key")
    return key


def _bytes(where: str, data: str) -> bytes:
    try:
        return bytes.fromhex(data)
    except ValueError:
        raise GrantProtocolError(f"{where}: {data!r} is not hexadecimal") from None


def _shown(line: bytes) -> str:
    text = line.decode("utf-8", "replace").strip()
    return repr(text if len(text) <= 60 else f"{text[:57]}...")
