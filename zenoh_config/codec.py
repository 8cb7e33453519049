"""Converts messages to bytes and back, in a safety envelope as in [EN 50159] for open networks.

The envelope contains sender, receiver, type, order and time. It ends in a cryptographic safety code
(HMAC-SHA256, truncated to 16 bytes) over everything before it. docs/reference/radio_interface.md
has the layout and the table of threats and defences. Order and age, which only a receiver can
check, are in sequencing.py.
"""

import hmac
import struct
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Final, NamedTuple

import msgspec

from zenoh_config.bodies import AUTHORITY_BODY, ORDERS_BODY, REPORT_BODY, STATUS_BODY
from zenoh_config.messages import (
    Message,
    MovementAuthority,
    PositionReport,
    Refused,
    RefusedReason,
    SpeedRestriction,
    TrainOrders,
    TrainStatus,
)
from zenoh_config.soundness import problem_of
from zenoh_config.t2t import T2tMessage
from zenoh_config.t2t_codec import TYPE_NUMBERS, knows, opened, packed_body, problem_of_t2t

VERSION: Final = 3
VERSION_BITS: Final = 4
"""Bits of the version in the first byte. The upper ones hold the identifier of the key."""
TYPE_POSITION_REPORT: Final = 1
TYPE_MOVEMENT_AUTHORITY: Final = 2
TYPE_TRAIN_STATUS: Final = 3
TYPE_TRAIN_ORDERS: Final = 4
HEADER: Final = struct.Struct(">BBHHIQ")
"""Version and key, type, source, destination, sequence, stamp in ns of the sender's clock."""
DATABASE_BYTES: Final = 8
"""Length of the sender's track database version, which follows the header."""
BODY_AT: Final = HEADER.size + DATABASE_BYTES
NO_DATABASE: Final = 0
"""Version in messages of a sender without a track database, such as a load test."""
CODE_BYTES: Final = 16
MAX_BYTES: Final = 4096
"""Longest accepted message; longer ones are refused before any computation."""
MIN_KEY_BYTES: Final = 16

BENCH_KEY: Final = b"metro bench, public key of no use"
"""Public default key. On a bench it detects accidents, not attackers; a network that others can
reach needs a key of its own."""

KEY_NUMBERS: Final = 16
"""Number of key identifiers. They share the first byte with the version: the identifier is in its
upper four bits. Key 0 gives the envelopes of a line that never changed its key."""
KEYS_MAX: Final = 2
"""Maximum number of keys that a program accepts at a time: those before and after a change."""

AnyMessage = Message | T2tMessage

_encode: Final = msgspec.msgpack.Encoder().encode


def safety_key(text: str) -> bytes:
    """Parse one key, in hexadecimal. Raises ValueError with the reason."""
    try:
        key = bytes.fromhex(text)
    except ValueError as error:
        raise ValueError(f"safety key: not hexadecimal: {error}") from error
    if len(key) < MIN_KEY_BYTES:
        raise ValueError(f"safety key: {len(key)} bytes, at least {MIN_KEY_BYTES} are needed")
    return key


class LineKeys:
    """Keys of a line's safety codes: one to send with, and one more to accept during a change.

    Every envelope names the identifier of its key. Another thread may call `take`; a message is
    sealed or opened with the keys from before it or after it.
    """

    def __init__(self, text: str) -> None:
        """Take the text of a key file. Raises ValueError with the reason."""
        self.text = ""
        self.sending = (0, b"")
        """Identifier and key with which messages are sent."""
        self.accepted: Mapping[int, bytes] = {}
        """Keys of received messages by identifier."""
        self.take(text)

    def take(self, text: str) -> None:
        """Replace the keys. Raises ValueError with the reason, and then changes nothing."""
        keys = parsed_keys(text)
        self.accepted = dict(keys)
        self.sending, self.text = keys[0], text


SafetyKey = bytes | LineKeys
"""A key that stays, with identifier 0, or the keys of a line."""


def parsed_keys(text: str) -> list[tuple[int, bytes]]:
    """Return identifiers and keys of a key file. The first one is to send with.

    A line of the file is a key in hexadecimal, after its identifier unless that is 0. Raises
    ValueError with the reason.
    """
    found: list[tuple[int, bytes]] = []
    for line in text.split("\n"):
        words = line.split()
        if not words:
            continue
        number = words[0] if len(words) > 1 else "0"
        if not (number.isascii() and number.isdecimal()) or int(number) >= KEY_NUMBERS:
            raise ValueError(f"key identifier {number!r} is not in 0..{KEY_NUMBERS - 1}")
        found.append((int(number), safety_key("".join(words[1:] or words))))
    if not 0 < len(found) <= KEYS_MAX or len(dict(found)) < len(found):
        raise ValueError(f"{len(found)} keys; 1 or 2 with different identifiers are needed")
    return found


def pack(
    message: AnyMessage, key: SafetyKey = BENCH_KEY, *, database: int | None = NO_DATABASE
) -> bytes:
    """Return the message in its envelope. Raises ValueError that names the invalid field.

    Args:
        database: version of the sender's track database, by which the message gives places.
    """
    number, secret = (0, key) if isinstance(key, bytes) else key.sending
    assert len(secret) >= MIN_KEY_BYTES
    problem = _problem(message)
    if problem:
        raise ValueError(f"{type(message).__name__}: {problem}")
    packed = _sealed(message)
    version = (database or NO_DATABASE).to_bytes(DATABASE_BYTES, "big")
    sealed = packed[: HEADER.size] + version + packed[HEADER.size :]
    if number:
        sealed = bytes((number << VERSION_BITS | VERSION,)) + sealed[1:]
    return sealed + _code(sealed, secret)


def _problem(message: AnyMessage) -> str:
    return problem_of_t2t(message) if isinstance(message, T2tMessage) else problem_of(message)


def _sealed(message: AnyMessage) -> bytes:
    if isinstance(message, T2tMessage):
        return _packed_t2t(message)
    if isinstance(message, PositionReport):
        return _packed_report(message)
    if isinstance(message, MovementAuthority):
        return _packed_authority(message)
    if isinstance(message, TrainStatus):
        return _packed_status(message)
    return _packed_orders(message)


def unpack(
    payload: bytes, key: SafetyKey = BENCH_KEY, *, database: int | None = None
) -> AnyMessage | Refused:
    """Return the message if every byte is as its sender sent it; otherwise the refusal.

    Never raises.

    Args:
        database: version of the receiver's track database. A message of another one is refused,
            because its places are those of another survey. None: any is read, as by a log reader.
    """
    if len(payload) <= BODY_AT + CODE_BYTES:
        return Refused(RefusedReason.TOO_SHORT, f"{len(payload)} bytes")
    if len(payload) > MAX_BYTES:
        return Refused(RefusedReason.TOO_LONG, f"{len(payload)} bytes")
    number = payload[0] >> VERSION_BITS
    secret = _secret(number, key)
    if secret is None:
        return Refused(RefusedReason.WRONG_CODE, f"sealed with key {number}, which is unknown here")
    sealed = payload[:-CODE_BYTES]
    if not hmac.compare_digest(_code(sealed, secret), payload[-CODE_BYTES:]):
        return Refused(RefusedReason.WRONG_CODE, "altered, or sealed with another key")
    return _opened(sealed, database)


def _secret(number: int, key: SafetyKey) -> bytes | None:
    """Return the key with this identifier. None: there is none."""
    if isinstance(key, bytes):
        return key if number == 0 else None
    return key.accepted.get(number)


def _opened(sealed: bytes, database: int | None) -> AnyMessage | Refused:
    first, kind, source, destination, sequence, stamp_ns = HEADER.unpack_from(sealed)
    version = first % (1 << VERSION_BITS)
    if version != VERSION:
        return Refused(RefusedReason.UNKNOWN_VERSION, f"version {version}, known is {VERSION}")
    theirs = int.from_bytes(sealed[HEADER.size : BODY_AT], "big")
    if database is not None and theirs != database:
        detail = f"{theirs:016x} of the sender, {database:016x} here"
        return Refused(RefusedReason.OTHER_DATABASE, detail)
    opener = _OPENERS.get(kind)
    if opener is None and not knows(kind):
        return Refused(RefusedReason.UNKNOWN_TYPE, f"type {kind}")
    head = _Head(source, destination, sequence, stamp_ns)
    body = sealed[BODY_AT:]
    message: AnyMessage
    try:
        message = opened(kind, *head, body) if opener is None else opener(head, body)
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        return Refused(RefusedReason.WRONG_FIELDS, str(error))
    problem = _problem(message)
    return Refused(RefusedReason.INVALID_VALUE, problem) if problem else message


class _Head(NamedTuple):
    source: int
    destination: int
    sequence: int
    stamp_ns: int


def _opened_report(head: _Head, body: bytes) -> Message:
    boot, front_min_m, front_max_m, rear_min_m, speed_mps, standstill, parameters = (
        REPORT_BODY.decode(body)
    )
    return PositionReport(
        head.source,
        boot,
        head.sequence,
        head.stamp_ns,
        front_min_m,
        front_max_m,
        rear_min_m,
        speed_mps,
        standstill,
        head.destination,
        parameters,
    )


def _opened_authority(head: _Head, body: bytes) -> Message:
    boot, term, echo_stamp_ns, end_m, rear_m, parameters = AUTHORITY_BODY.decode(body)
    return MovementAuthority(
        head.destination,
        boot,
        term,
        head.sequence,
        echo_stamp_ns,
        end_m,
        head.source,
        head.stamp_ns,
        rear_m,
        parameters,
    )


def _opened_status(head: _Head, body: bytes) -> Message:
    told = STATUS_BODY.decode(body)
    return TrainStatus(
        head.source,
        told.boot,
        head.sequence,
        head.stamp_ns,
        told.mode,
        told.supervision,
        told.cause,
        told.localised,
        told.standstill,
        told.front_m,
        told.doors_locked,
        told.open_left,
        told.open_right,
        told.passenger_alarm,
        told.fire,
        told.obstacle,
        told.alarm_raised,
        head.destination,
        told.emergency_number,
    )


def _opened_orders(head: _Head, body: bytes) -> Message:
    told = ORDERS_BODY.decode(body)
    return TrainOrders(
        head.destination,
        told.boot,
        head.sequence,
        told.echo_stamp_ns,
        told.awake,
        told.hold,
        told.skip_next,
        told.stop_next,
        told.emergency,
        told.releases,
        told.creep,
        told.restricted,
        told.doors_left,
        told.doors_right,
        told.platform_doors_locked,
        tuple([SpeedRestriction(*each) for each in told.restrictions]),
        head.source,
        head.stamp_ns,
        told.released_emergency,
    )


_OPENERS: Final[Mapping[int, Callable[[_Head, bytes], Message]]] = {
    TYPE_POSITION_REPORT: _opened_report,
    TYPE_MOVEMENT_AUTHORITY: _opened_authority,
    TYPE_TRAIN_STATUS: _opened_status,
    TYPE_TRAIN_ORDERS: _opened_orders,
}


def _packed_t2t(message: T2tMessage) -> bytes:
    return HEADER.pack(
        VERSION,
        TYPE_NUMBERS[type(message)],
        message.source,
        message.destination,
        message.sequence,
        message.stamp_ns,
    ) + packed_body(message)


def _packed_report(report: PositionReport) -> bytes:
    return HEADER.pack(
        VERSION,
        TYPE_POSITION_REPORT,
        report.train,
        report.destination,
        report.sequence,
        report.stamp_ns,
    ) + _encode(
        (
            report.boot,
            report.front_min_m,
            report.front_max_m,
            report.rear_min_m,
            report.speed_mps,
            report.standstill,
            report.parameters,
        )
    )


def _packed_authority(authority: MovementAuthority) -> bytes:
    return HEADER.pack(
        VERSION,
        TYPE_MOVEMENT_AUTHORITY,
        authority.source,
        authority.train,
        authority.sequence,
        authority.stamp_ns,
    ) + _encode(
        (
            authority.boot,
            authority.term,
            authority.echo_stamp_ns,
            authority.end_m,
            authority.rear_m,
            authority.parameters,
        )
    )


def _packed_status(status: TrainStatus) -> bytes:
    return HEADER.pack(
        VERSION,
        TYPE_TRAIN_STATUS,
        status.train,
        status.destination,
        status.sequence,
        status.stamp_ns,
    ) + _encode(
        (
            status.boot,
            status.mode,
            status.supervision,
            status.cause,
            status.localised,
            status.standstill,
            status.front_m,
            status.doors_locked,
            status.open_left,
            status.open_right,
            status.passenger_alarm,
            status.fire,
            status.obstacle,
            status.alarm_raised,
            status.emergency_number,
        )
    )


def _packed_orders(orders: TrainOrders) -> bytes:
    return HEADER.pack(
        VERSION,
        TYPE_TRAIN_ORDERS,
        orders.source,
        orders.train,
        orders.sequence,
        orders.stamp_ns,
    ) + _encode(
        (
            orders.boot,
            orders.echo_stamp_ns,
            orders.awake,
            orders.hold,
            orders.skip_next,
            orders.stop_next,
            orders.emergency,
            orders.releases,
            orders.creep,
            orders.restricted,
            orders.doors_left,
            orders.doors_right,
            orders.platform_doors_locked,
            [(each.start_m, each.end_m, each.limit_mps) for each in orders.restrictions],
            orders.released_emergency,
        )
    )


@lru_cache(maxsize=16)
def _code(sealed: bytes, key: bytes) -> bytes:
    """Compute the safety code.

    The cache serves processes with both ends, where a message is sealed and then opened.
    """
    code = _begun(key).copy()
    code.update(sealed)
    return code.digest()[:CODE_BYTES]


@lru_cache(maxsize=16)
def _begun(key: bytes) -> hmac.HMAC:
    """Return the HMAC state after the key, computed once for all messages."""
    return hmac.new(key, digestmod="sha256")
