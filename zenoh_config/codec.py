"""Messages to bytes and back, inside a safety envelope after EN 50159 for open networks.

The envelope says who speaks to whom, of what, in which order and when, and ends in a cryptographic
safety code (HMAC-SHA256, shortened to 16 bytes) over all that stands before it.
docs/radio_interface.md has the layout and the table of threats and defences; what only a receiver
can check, order and age, is in sequencing.py.
"""

import hmac
import struct
from typing import Final

import msgspec

from zenoh_config.messages import (
    MAX_ADDRESS,
    WAYSIDE,
    Message,
    MovementAuthority,
    PositionReport,
    Refused,
    RefusedReason,
)

VERSION: Final = 1
TYPE_POSITION_REPORT: Final = 1
TYPE_MOVEMENT_AUTHORITY: Final = 2
HEADER: Final = struct.Struct(">BBHHIQ")
"""Version, type, source, destination, sequence, stamp in ns of the sender's clock."""
CODE_BYTES: Final = 16
MAX_BYTES: Final = 512
"""Longer ones are refused before anything is computed."""
MIN_KEY_BYTES: Final = 16
MAX_CHAINAGE_M: Final = 1.0e6
MAX_SPEED_MPS: Final = 200.0

BENCH_KEY: Final = b"metro bench, public key of no use"
"""Shipped default. Everyone has it, so on a bench it finds accidents and not attackers; a network
that others can reach needs a key of its own."""

MAX_NUMBER: Final = 2**32 - 1
MAX_STAMP_NS: Final = 2**63 - 1


# In the order of the fields named in docs/radio_interface.md.
_REPORT_BODY: Final = msgspec.msgpack.Decoder(tuple[int, float, float, float, float, bool])
_AUTHORITY_BODY: Final = msgspec.msgpack.Decoder(tuple[int, int, int, float])
_encode: Final = msgspec.msgpack.Encoder().encode


def safety_key(text: str) -> bytes:
    """A key as a configuration spells it, in hexadecimal. Raises ValueError saying why not."""
    try:
        key = bytes.fromhex(text)
    except ValueError as error:
        raise ValueError(f"safety key: not hexadecimal: {error}") from error
    if len(key) < MIN_KEY_BYTES:
        raise ValueError(f"safety key: {len(key)} bytes, at least {MIN_KEY_BYTES} are needed")
    return key


def pack(message: Message, key: bytes = BENCH_KEY) -> bytes:
    """The message in its envelope. Raises ValueError naming the field that must not be sent."""
    assert len(key) >= MIN_KEY_BYTES
    problem = _problem(message)
    if problem:
        raise ValueError(f"{type(message).__name__}: {problem}")
    sealed = (
        _packed_report(message)
        if isinstance(message, PositionReport)
        else _packed_authority(message)
    )
    return sealed + _code(sealed, key)


def unpack(payload: bytes, key: bytes = BENCH_KEY) -> Message | Refused:
    """The message, if every byte is what its sender sent. Never raises, whatever the bytes."""
    if len(payload) <= HEADER.size + CODE_BYTES:
        return Refused(RefusedReason.TOO_SHORT, f"{len(payload)} bytes")
    if len(payload) > MAX_BYTES:
        return Refused(RefusedReason.TOO_LONG, f"{len(payload)} bytes")
    sealed = payload[:-CODE_BYTES]
    if not hmac.compare_digest(_code(sealed, key), payload[-CODE_BYTES:]):
        return Refused(RefusedReason.WRONG_CODE, "altered, or sealed with another key")
    return _opened(sealed)


def _opened(sealed: bytes) -> Message | Refused:
    version, kind, source, destination, sequence, stamp_ns = HEADER.unpack_from(sealed)
    if version != VERSION:
        return Refused(RefusedReason.UNKNOWN_VERSION, f"version {version}, known is {VERSION}")
    body = sealed[HEADER.size :]
    message: Message
    try:
        if kind == TYPE_POSITION_REPORT:
            boot, front_min_m, front_max_m, rear_min_m, speed_mps, standstill = _REPORT_BODY.decode(
                body
            )
            message = PositionReport(
                source,
                boot,
                sequence,
                stamp_ns,
                front_min_m,
                front_max_m,
                rear_min_m,
                speed_mps,
                standstill,
                destination,
            )
        elif kind == TYPE_MOVEMENT_AUTHORITY:
            boot, term, echo_stamp_ns, end_m = _AUTHORITY_BODY.decode(body)
            message = MovementAuthority(
                destination, boot, term, sequence, echo_stamp_ns, end_m, source, stamp_ns
            )
        else:
            return Refused(RefusedReason.UNKNOWN_TYPE, f"type {kind}")
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        return Refused(RefusedReason.WRONG_FIELDS, str(error))
    problem = _problem(message)
    return Refused(RefusedReason.INVALID_VALUE, problem) if problem else message


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
    ) + _encode((authority.boot, authority.term, authority.echo_stamp_ns, authority.end_m))


def _code(sealed: bytes, key: bytes) -> bytes:
    return hmac.digest(key, sealed, "sha256")[:CODE_BYTES]


def _problem(message: Message) -> str:
    """What no honest sender says, by field; empty when there is nothing. Comparisons catch NaN."""
    if isinstance(message, PositionReport):
        return _report_problem(message)
    return _authority_problem(message)


def _report_problem(report: PositionReport) -> str:
    if not WAYSIDE < report.train <= MAX_ADDRESS:
        return f"train {report.train} is not in 1..{MAX_ADDRESS}"
    if not WAYSIDE <= report.destination <= MAX_ADDRESS:
        return f"destination {report.destination} is not in 0..{MAX_ADDRESS}"
    if not -MAX_SPEED_MPS <= report.speed_mps <= MAX_SPEED_MPS:
        return f"speed_mps {report.speed_mps} is not in ±{MAX_SPEED_MPS}"
    if not report.rear_min_m <= report.front_min_m <= report.front_max_m:
        return (
            f"rear_min_m {report.rear_min_m}, front_min_m {report.front_min_m} and "
            f"front_max_m {report.front_max_m} are not in this order"
        )
    if report.rear_min_m < -MAX_CHAINAGE_M or report.front_max_m > MAX_CHAINAGE_M:
        return (
            f"rear_min_m {report.rear_min_m} or front_max_m {report.front_max_m} is off every line"
        )
    return _number_problem(report.boot, report.sequence, report.stamp_ns)


def _authority_problem(authority: MovementAuthority) -> str:
    if not WAYSIDE < authority.train <= MAX_ADDRESS:
        return f"train {authority.train} is not in 1..{MAX_ADDRESS}"
    if not WAYSIDE <= authority.source <= MAX_ADDRESS:
        return f"source {authority.source} is not in 0..{MAX_ADDRESS}"
    if not 0 <= authority.term <= MAX_NUMBER:
        return f"term {authority.term} is not in 0..{MAX_NUMBER}"
    if not 0 <= authority.echo_stamp_ns <= MAX_STAMP_NS:
        return f"echo_stamp_ns {authority.echo_stamp_ns} is not in 0..{MAX_STAMP_NS}"
    if not -MAX_CHAINAGE_M <= authority.end_m <= MAX_CHAINAGE_M:
        return f"end_m {authority.end_m} is off every line"
    return _number_problem(authority.boot, authority.sequence, authority.stamp_ns)


def _number_problem(boot: int, sequence: int, stamp_ns: int) -> str:
    if not 0 <= boot <= MAX_NUMBER:
        return f"boot {boot} is not in 0..{MAX_NUMBER}"
    if not 0 <= sequence <= MAX_NUMBER:
        return f"sequence {sequence} is not in 0..{MAX_NUMBER}"
    if not 0 <= stamp_ns <= MAX_STAMP_NS:
        return f"stamp_ns {stamp_ns} is not in 0..{MAX_STAMP_NS}"
    return ""
