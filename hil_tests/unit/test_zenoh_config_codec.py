"""Messages come back as they were sent, or not at all."""

import hashlib
import hmac
import math
import struct
from collections.abc import Sequence
from dataclasses import replace

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zenoh_config.codec import BENCH_KEY, MAX_BYTES, pack, safety_key, unpack
from zenoh_config.messages import (
    MovementAuthority,
    PositionReport,
    Refused,
    RefusedReason,
)

REPORT = PositionReport(7, 3, 1000, 123_456_789_012, -20.5, -19.0, -89.1, 12.25, False)
AUTHORITY = MovementAuthority(7, 3, 2, 500, 123_456_789_012, 1450.0, 0, 99)

numbers = st.integers(0, 2**32 - 1)
stamps_ns = st.integers(0, 2**63 - 1)
addresses = st.integers(0, 65535)
trains = st.integers(1, 65535)
chainages_m = st.floats(-1.0e6, 1.0e6)


@st.composite
def reports(draw: st.DrawFn) -> PositionReport:
    rear_m, low_m, high_m = sorted(draw(st.tuples(chainages_m, chainages_m, chainages_m)))
    return PositionReport(
        train=draw(trains),
        boot=draw(numbers),
        sequence=draw(numbers),
        stamp_ns=draw(stamps_ns),
        front_min_m=low_m,
        front_max_m=high_m,
        rear_min_m=rear_m,
        speed_mps=draw(st.floats(-200.0, 200.0)),
        standstill=draw(st.booleans()),
        destination=draw(addresses),
    )


authorities = st.builds(
    MovementAuthority,
    train=trains,
    boot=numbers,
    term=numbers,
    sequence=numbers,
    echo_stamp_ns=stamps_ns,
    end_m=chainages_m,
    source=addresses,
    stamp_ns=stamps_ns,
)


def sealed(header: bytes, body: bytes, key: bytes = BENCH_KEY) -> bytes:
    """An envelope by the document alone."""
    code = hmac.new(key, header + body, hashlib.sha256).digest()[:16]
    return header + body + code


def header_of(kind: int, source: int, destination: int, *, version: int = 1) -> bytes:
    return struct.pack(">BBHHIQ", version, kind, source, destination, 5, 6)


def reason_of(payload: bytes) -> RefusedReason | None:
    result = unpack(payload)
    return result.reason if isinstance(result, Refused) else None


@given(reports() | authorities)
def test_messages_come_back(message: PositionReport | MovementAuthority) -> None:
    payload = pack(message)

    assert unpack(payload) == message
    assert len(payload) <= MAX_BYTES


@given(reports())
def test_a_report_is_laid_out_as_documented(report: PositionReport) -> None:
    header = struct.pack(
        ">BBHHIQ", 1, 1, report.train, report.destination, report.sequence, report.stamp_ns
    )
    fields = [
        report.boot, report.front_min_m, report.front_max_m,
        report.rear_min_m, report.speed_mps, report.standstill,
    ]  # fmt: skip

    assert pack(report) == sealed(header, msgspec.msgpack.encode(fields))


@given(authorities)
def test_an_authority_is_laid_out_as_documented(authority: MovementAuthority) -> None:
    header = struct.pack(
        ">BBHHIQ",
        1,
        2,
        authority.source,
        authority.train,
        authority.sequence,
        authority.stamp_ns,
    )
    fields = [authority.boot, authority.term, authority.echo_stamp_ns, authority.end_m]

    assert pack(authority) == sealed(header, msgspec.msgpack.encode(fields))


@pytest.mark.parametrize("message", [REPORT, AUTHORITY], ids=["report", "authority"])
def test_no_single_wrong_bit_is_accepted(message: PositionReport | MovementAuthority) -> None:
    payload = pack(message)

    for bit in range(len(payload) * 8):
        broken = bytearray(payload)
        broken[bit // 8] ^= 1 << bit % 8
        assert reason_of(bytes(broken)) is RefusedReason.WRONG_CODE, f"bit {bit}"


@pytest.mark.parametrize("message", [REPORT, AUTHORITY], ids=["report", "authority"])
def test_no_part_of_a_message_is_accepted(message: PositionReport | MovementAuthority) -> None:
    payload = pack(message)

    for length in range(len(payload)):
        assert reason_of(payload[:length]) in (RefusedReason.TOO_SHORT, RefusedReason.WRONG_CODE)
    assert reason_of(payload + b"\x00") is RefusedReason.WRONG_CODE


def test_a_message_sealed_with_another_key_is_refused() -> None:
    assert reason_of(pack(AUTHORITY, b"somebody else's key")) is RefusedReason.WRONG_CODE


@given(st.binary(max_size=2 * MAX_BYTES))
def test_no_bytes_raise(payload: bytes) -> None:
    assert isinstance(unpack(payload), Refused)


@given(st.integers(0, 255), st.integers(0, 255), addresses, addresses, st.binary(max_size=80))
def test_no_bytes_raise_behind_a_good_code(
    version: int, kind: int, source: int, destination: int, body: bytes
) -> None:
    """What a faulty but genuine sender may send."""
    result = unpack(sealed(header_of(kind, source, destination, version=version), body))

    if not isinstance(result, Refused):
        assert unpack(pack(result)) == result


def test_a_long_message_is_refused_unread() -> None:
    assert reason_of(bytes(MAX_BYTES + 1)) is RefusedReason.TOO_LONG


GOOD_REPORT_BODY = [3, -20.5, -19.0, -89.1, 12.25, False]
GOOD_AUTHORITY_BODY = [3, 2, 123, 1450.0]


def with_field(body: Sequence[object], at: int, value: object) -> list[object]:
    return [*body[:at], value, *body[at + 1 :]]


@pytest.mark.parametrize(
    ("kind", "body", "reason"),
    [
        (1, GOOD_REPORT_BODY, None),
        (2, GOOD_AUTHORITY_BODY, None),
        (3, GOOD_AUTHORITY_BODY, RefusedReason.UNKNOWN_TYPE),
        (1, GOOD_AUTHORITY_BODY, RefusedReason.WRONG_FIELDS),
        (2, GOOD_REPORT_BODY, RefusedReason.WRONG_FIELDS),
        (2, [*GOOD_AUTHORITY_BODY, 1], RefusedReason.WRONG_FIELDS),
        (2, GOOD_AUTHORITY_BODY[:-1], RefusedReason.WRONG_FIELDS),
        (2, {"boot": 3}, RefusedReason.WRONG_FIELDS),
        (2, with_field(GOOD_AUTHORITY_BODY, 3, "far"), RefusedReason.WRONG_FIELDS),
        (2, with_field(GOOD_AUTHORITY_BODY, 0, 3.5), RefusedReason.WRONG_FIELDS),
        (2, with_field(GOOD_AUTHORITY_BODY, 0, True), RefusedReason.WRONG_FIELDS),
        (1, with_field(GOOD_REPORT_BODY, 5, 1), RefusedReason.WRONG_FIELDS),
        (2, with_field(GOOD_AUTHORITY_BODY, 3, math.nan), RefusedReason.INVALID_VALUE),
        (2, with_field(GOOD_AUTHORITY_BODY, 3, math.inf), RefusedReason.INVALID_VALUE),
        (2, with_field(GOOD_AUTHORITY_BODY, 3, -1.1e6), RefusedReason.INVALID_VALUE),
        (2, with_field(GOOD_AUTHORITY_BODY, 0, -1), RefusedReason.INVALID_VALUE),
        (2, with_field(GOOD_AUTHORITY_BODY, 1, -1), RefusedReason.INVALID_VALUE),
        (2, with_field(GOOD_AUTHORITY_BODY, 1, 2**32), RefusedReason.INVALID_VALUE),
        (2, with_field(GOOD_AUTHORITY_BODY, 2, -1), RefusedReason.INVALID_VALUE),
        (2, with_field(GOOD_AUTHORITY_BODY, 2, 2**63), RefusedReason.INVALID_VALUE),
        (1, with_field(GOOD_REPORT_BODY, 0, -1), RefusedReason.INVALID_VALUE),
        (1, with_field(GOOD_REPORT_BODY, 1, math.nan), RefusedReason.INVALID_VALUE),
        (1, with_field(GOOD_REPORT_BODY, 2, math.nan), RefusedReason.INVALID_VALUE),
        (1, with_field(GOOD_REPORT_BODY, 3, math.nan), RefusedReason.INVALID_VALUE),
        (1, with_field(GOOD_REPORT_BODY, 4, math.nan), RefusedReason.INVALID_VALUE),
        (1, with_field(GOOD_REPORT_BODY, 2, math.inf), RefusedReason.INVALID_VALUE),
        (1, with_field(GOOD_REPORT_BODY, 3, -math.inf), RefusedReason.INVALID_VALUE),
        (1, with_field(GOOD_REPORT_BODY, 4, 201.0), RefusedReason.INVALID_VALUE),
        (1, with_field(GOOD_REPORT_BODY, 2, -21.0), RefusedReason.INVALID_VALUE),
        (1, with_field(GOOD_REPORT_BODY, 3, -20.0), RefusedReason.INVALID_VALUE),
    ],
)
def test_a_genuine_envelope_with_unsound_fields_is_refused(
    kind: int, body: object, reason: RefusedReason | None
) -> None:
    header = header_of(kind, *((7, 0) if kind == 1 else (0, 7)))

    assert reason_of(sealed(header, msgspec.msgpack.encode(body))) is reason


@pytest.mark.parametrize(("kind", "source", "destination"), [(1, 0, 7), (2, 7, 0)])
def test_the_wayside_is_no_train(kind: int, source: int, destination: int) -> None:
    body = GOOD_REPORT_BODY if kind == 1 else GOOD_AUTHORITY_BODY
    payload = sealed(header_of(kind, source, destination), msgspec.msgpack.encode(body))

    assert reason_of(payload) is RefusedReason.INVALID_VALUE


def test_a_later_version_is_refused() -> None:
    payload = sealed(header_of(2, 0, 7, version=2), msgspec.msgpack.encode(GOOD_AUTHORITY_BODY))

    assert reason_of(payload) is RefusedReason.UNKNOWN_VERSION


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (replace(AUTHORITY, end_m=math.nan), "MovementAuthority: end_m nan"),
        (replace(AUTHORITY, train=0), "train 0 is not in 1..65535"),
        (replace(AUTHORITY, source=65536), "source 65536"),
        (replace(AUTHORITY, stamp_ns=-1), "stamp_ns -1"),
        (replace(AUTHORITY, sequence=2**32), "sequence 4294967296"),
        (replace(REPORT, front_max_m=math.inf), "PositionReport: rear_min_m .* off every line"),
        (replace(REPORT, rear_min_m=-10.0), "not in this order"),
        (replace(REPORT, destination=-1), "destination -1"),
        (replace(REPORT, boot=-1), "boot -1"),
    ],
)
def test_what_must_not_be_sent_is_said_by_name(
    message: PositionReport | MovementAuthority, words: str
) -> None:
    with pytest.raises(ValueError, match=words):
        pack(message)


def test_a_key_is_read_as_hexadecimal() -> None:
    assert safety_key("00112233445566778899aabbccddeeff") == bytes.fromhex(
        "00112233445566778899aabbccddeeff"
    )


@pytest.mark.parametrize(
    ("text", "words"), [("0011", "2 bytes, at least 16"), ("key!", "not hexadecimal")]
)
def test_a_key_that_is_none_says_why(text: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        safety_key(text)
