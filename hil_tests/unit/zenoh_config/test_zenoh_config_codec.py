"""Messages survive packing and unpacking unchanged, and damaged ones are refused."""

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
    RESTRICTIONS_MAX,
    Message,
    MovementAuthority,
    PositionReport,
    Refused,
    RefusedReason,
    SpeedRestriction,
    TrainOrders,
    TrainStatus,
)

REPORT = PositionReport(7, 3, 1000, 123_456_789_012, -20.5, -19.0, -89.1, 12.25, False)
AUTHORITY = MovementAuthority(7, 3, 2, 500, 123_456_789_012, 1450.0, 0, 99)
STATUS = TrainStatus(
    7, 3, 41, 123_456_789_012, 4, 1, 0, True, False, -19.5, True, False, True, False, False, True,
    False, 0, 5,
)  # fmt: skip
ORDERS = TrainOrders(
    7, 3, 77, 123_456_789_012, True, False, True, False, False, 2, False, False, True, False, True,
    (SpeedRestriction(100.0, 250.5, 8.25), SpeedRestriction(-3.0, 4.0, 1.0)), 0, 99, 4,
)  # fmt: skip
SAMPLES = pytest.mark.parametrize(
    "message", [REPORT, AUTHORITY, STATUS, ORDERS], ids=lambda message: type(message).__name__
)

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
    rear_m=st.none(),
) | st.builds(
    lambda ends_m, **values: MovementAuthority(rear_m=min(ends_m), end_m=max(ends_m), **values),
    st.tuples(chainages_m, chainages_m),
    train=trains,
    boot=numbers,
    term=numbers,
    sequence=numbers,
    echo_stamp_ns=stamps_ns,
    source=addresses,
    stamp_ns=stamps_ns,
)

codes = st.integers(0, 255)
flags = st.booleans()
statuses = st.builds(
    TrainStatus,
    train=trains,
    boot=numbers,
    sequence=numbers,
    stamp_ns=stamps_ns,
    mode=codes,
    supervision=codes,
    cause=codes,
    localised=flags,
    standstill=flags,
    front_m=chainages_m,
    doors_locked=flags,
    open_left=flags,
    open_right=flags,
    passenger_alarm=flags,
    fire=flags,
    obstacle=flags,
    alarm_raised=flags,
    destination=addresses,
    emergency_number=numbers,
)
restrictions = st.builds(
    lambda ends_m, limit_mps: SpeedRestriction(min(ends_m), max(ends_m), limit_mps),
    st.tuples(chainages_m, chainages_m),
    st.floats(0.0, 200.0, exclude_min=True),
)
orders = st.builds(
    TrainOrders,
    train=trains,
    boot=numbers,
    sequence=numbers,
    echo_stamp_ns=stamps_ns,
    awake=flags,
    hold=flags,
    skip_next=flags,
    stop_next=flags,
    emergency=flags,
    releases=numbers,
    creep=flags,
    restricted=flags,
    doors_left=flags,
    doors_right=flags,
    platform_doors_locked=flags,
    restrictions=st.lists(restrictions, max_size=RESTRICTIONS_MAX).map(tuple),
    source=addresses,
    stamp_ns=stamps_ns,
    released_emergency=numbers,
)
messages = reports() | authorities | statuses | orders


def sealed(header: bytes, body: bytes, key: bytes = BENCH_KEY) -> bytes:
    """An envelope built from the documented format alone."""
    code = hmac.new(key, header + body, hashlib.sha256).digest()[:16]
    return header + body + code


def header_of(kind: int, source: int, destination: int, *, version: int = 3) -> bytes:
    return struct.pack(">BBHHIQQ", version, kind, source, destination, 5, 6, 0)


def reason_of(payload: bytes) -> RefusedReason | None:
    result = unpack(payload)
    return result.reason if isinstance(result, Refused) else None


@given(messages)
def test_a_packed_message_unpacks_unchanged(message: Message) -> None:
    payload = pack(message)

    assert unpack(payload) == message
    assert len(payload) <= MAX_BYTES


@given(reports())
def test_a_report_is_laid_out_as_documented(report: PositionReport) -> None:
    header = struct.pack(
        ">BBHHIQQ", 3, 1, report.train, report.destination, report.sequence, report.stamp_ns, 0
    )
    fields = [
        report.boot, report.front_min_m, report.front_max_m,
        report.rear_min_m, report.speed_mps, report.standstill, report.parameters,
    ]  # fmt: skip

    assert pack(report) == sealed(header, msgspec.msgpack.encode(fields))


@given(authorities)
def test_an_authority_is_laid_out_as_documented(authority: MovementAuthority) -> None:
    header = struct.pack(
        ">BBHHIQQ",
        3,
        2,
        authority.source,
        authority.train,
        authority.sequence,
        authority.stamp_ns,
        0,
    )
    fields = [
        authority.boot, authority.term, authority.echo_stamp_ns, authority.end_m, authority.rear_m,
        authority.parameters,
    ]  # fmt: skip

    assert pack(authority) == sealed(header, msgspec.msgpack.encode(fields))


@given(statuses)
def test_a_status_is_laid_out_as_documented(status: TrainStatus) -> None:
    header = struct.pack(
        ">BBHHIQQ", 3, 3, status.train, status.destination, status.sequence, status.stamp_ns, 0
    )
    fields = [
        status.boot, status.mode, status.supervision, status.cause, status.localised,
        status.standstill, status.front_m, status.doors_locked, status.open_left,
        status.open_right, status.passenger_alarm, status.fire, status.obstacle,
        status.alarm_raised, status.emergency_number,
    ]  # fmt: skip

    assert pack(status) == sealed(header, msgspec.msgpack.encode(fields))


@given(orders)
def test_orders_are_laid_out_as_documented(told: TrainOrders) -> None:
    header = struct.pack(
        ">BBHHIQQ", 3, 4, told.source, told.train, told.sequence, told.stamp_ns, 0
    )  # fmt: skip
    fields = [
        told.boot, told.echo_stamp_ns, told.awake, told.hold, told.skip_next, told.stop_next,
        told.emergency, told.releases, told.creep, told.restricted, told.doors_left,
        told.doors_right, told.platform_doors_locked,
        [[each.start_m, each.end_m, each.limit_mps] for each in told.restrictions],
        told.released_emergency,
    ]  # fmt: skip

    assert pack(told) == sealed(header, msgspec.msgpack.encode(fields))


@given(messages, st.data())
def test_a_wrong_bit_anywhere_in_any_message_is_refused(
    message: Message, data: st.DataObject
) -> None:
    broken = bytearray(pack(message))
    bit = data.draw(st.integers(0, 8 * len(broken) - 1))
    broken[bit // 8] ^= 1 << bit % 8

    assert reason_of(bytes(broken)) is RefusedReason.WRONG_CODE


@SAMPLES
def test_no_single_wrong_bit_is_accepted(message: Message) -> None:
    payload = pack(message)

    for bit in range(len(payload) * 8):
        broken = bytearray(payload)
        broken[bit // 8] ^= 1 << bit % 8
        assert reason_of(bytes(broken)) is RefusedReason.WRONG_CODE, f"bit {bit}"


@SAMPLES
def test_no_truncated_message_is_accepted(message: Message) -> None:
    payload = pack(message)

    for length in range(len(payload)):
        assert reason_of(payload[:length]) in (RefusedReason.TOO_SHORT, RefusedReason.WRONG_CODE)
    assert reason_of(payload + b"\x00") is RefusedReason.WRONG_CODE


def test_a_message_sealed_with_another_key_is_refused() -> None:
    assert reason_of(pack(AUTHORITY, b"the key of another line")) is RefusedReason.WRONG_CODE


@given(st.binary(max_size=2 * MAX_BYTES))
def test_no_input_raises_an_exception(payload: bytes) -> None:
    assert isinstance(unpack(payload), Refused)


@given(st.integers(0, 255), st.integers(0, 255), addresses, addresses, st.binary(max_size=80))
def test_no_body_with_a_correct_code_raises_an_exception(
    version: int, kind: int, source: int, destination: int, body: bytes
) -> None:
    """A faulty node with the key may send any such body."""
    result = unpack(sealed(header_of(kind, source, destination, version=version), body))

    if not isinstance(result, Refused):
        assert unpack(pack(result)) == result


def test_a_long_message_is_refused_unread() -> None:
    assert reason_of(bytes(MAX_BYTES + 1)) is RefusedReason.TOO_LONG


GOOD_REPORT_BODY = [3, -20.5, -19.0, -89.1, 12.25, False, 2**64 - 1]
GOOD_AUTHORITY_BODY = [3, 2, 123, 1450.0, None, 5]
GOOD_STATUS_BODY = [
    3, 4, 1, 0, True, False, -19.5, True, False, True, False, False, True, False, 0,
]  # fmt: skip
GOOD_ORDERS_BODY = [
    3, 123, True, False, True, False, False, 2, False, False, True, False, True,
    [[100.0, 250.5, 8.25]], 0,
]  # fmt: skip


def with_field(body: Sequence[object], at: int, value: object) -> list[object]:
    return [*body[:at], value, *body[at + 1 :]]


@pytest.mark.parametrize(
    ("kind", "body", "reason"),
    [
        (1, GOOD_REPORT_BODY, None),
        (2, GOOD_AUTHORITY_BODY, None),
        (3, GOOD_STATUS_BODY, None),
        (4, GOOD_ORDERS_BODY, None),
        (0, GOOD_AUTHORITY_BODY, RefusedReason.UNKNOWN_TYPE),
        (5, GOOD_ORDERS_BODY, RefusedReason.UNKNOWN_TYPE),
        (3, GOOD_AUTHORITY_BODY, RefusedReason.WRONG_FIELDS),
        (4, GOOD_STATUS_BODY, RefusedReason.WRONG_FIELDS),
        (3, GOOD_ORDERS_BODY, RefusedReason.WRONG_FIELDS),
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
        (1, with_field(GOOD_REPORT_BODY, 6, -1), RefusedReason.INVALID_VALUE),
        (2, with_field(GOOD_AUTHORITY_BODY, 5, -1), RefusedReason.INVALID_VALUE),
        (2, with_field(GOOD_AUTHORITY_BODY, 0, -1), RefusedReason.INVALID_VALUE),
        (2, with_field(GOOD_AUTHORITY_BODY, 1, -1), RefusedReason.INVALID_VALUE),
        (2, with_field(GOOD_AUTHORITY_BODY, 1, 2**32), RefusedReason.INVALID_VALUE),
        (2, with_field(GOOD_AUTHORITY_BODY, 2, -1), RefusedReason.INVALID_VALUE),
        (2, with_field(GOOD_AUTHORITY_BODY, 2, 2**63), RefusedReason.INVALID_VALUE),
        (2, with_field(GOOD_AUTHORITY_BODY, 4, 1450.0), None),
        (2, with_field(GOOD_AUTHORITY_BODY, 4, -1.0e6), None),
        (2, with_field(GOOD_AUTHORITY_BODY, 4, 1450.1), RefusedReason.INVALID_VALUE),
        (2, with_field(GOOD_AUTHORITY_BODY, 4, -1.1e6), RefusedReason.INVALID_VALUE),
        (2, with_field(GOOD_AUTHORITY_BODY, 4, math.nan), RefusedReason.INVALID_VALUE),
        (2, with_field(GOOD_AUTHORITY_BODY, 4, False), RefusedReason.WRONG_FIELDS),
        (3, [*GOOD_STATUS_BODY, False], RefusedReason.WRONG_FIELDS),
        (3, GOOD_STATUS_BODY[:-1], RefusedReason.WRONG_FIELDS),
        (3, with_field(GOOD_STATUS_BODY, 4, 1), RefusedReason.WRONG_FIELDS),
        (3, with_field(GOOD_STATUS_BODY, 13, None), RefusedReason.WRONG_FIELDS),
        (3, with_field(GOOD_STATUS_BODY, 1, 255), None),
        (3, with_field(GOOD_STATUS_BODY, 1, 256), RefusedReason.INVALID_VALUE),
        (3, with_field(GOOD_STATUS_BODY, 2, -1), RefusedReason.INVALID_VALUE),
        (3, with_field(GOOD_STATUS_BODY, 3, 256), RefusedReason.INVALID_VALUE),
        (3, with_field(GOOD_STATUS_BODY, 6, math.nan), RefusedReason.INVALID_VALUE),
        (3, with_field(GOOD_STATUS_BODY, 6, 1.0e6), None),
        (3, with_field(GOOD_STATUS_BODY, 6, 1.1e6), RefusedReason.INVALID_VALUE),
        (3, with_field(GOOD_STATUS_BODY, 0, 2**32), RefusedReason.INVALID_VALUE),
        (4, [*GOOD_ORDERS_BODY, False], RefusedReason.WRONG_FIELDS),
        (4, GOOD_ORDERS_BODY[:-1], RefusedReason.WRONG_FIELDS),
        (4, with_field(GOOD_ORDERS_BODY, 2, 1), RefusedReason.WRONG_FIELDS),
        (4, with_field(GOOD_ORDERS_BODY, 6, None), RefusedReason.WRONG_FIELDS),
        (4, with_field(GOOD_ORDERS_BODY, 13, [[0.0, 1.0]]), RefusedReason.WRONG_FIELDS),
        (4, with_field(GOOD_ORDERS_BODY, 13, [[0.0, 1.0, "v"]]), RefusedReason.WRONG_FIELDS),
        (4, with_field(GOOD_ORDERS_BODY, 0, -1), RefusedReason.INVALID_VALUE),
        (4, with_field(GOOD_ORDERS_BODY, 1, -1), RefusedReason.INVALID_VALUE),
        (4, with_field(GOOD_ORDERS_BODY, 7, -1), RefusedReason.INVALID_VALUE),
        (4, with_field(GOOD_ORDERS_BODY, 7, 2**32 - 1), None),
        (4, with_field(GOOD_ORDERS_BODY, 7, 2**32), RefusedReason.INVALID_VALUE),
        (4, with_field(GOOD_ORDERS_BODY, 13, [[0.0, 0.0, 200.0]]), None),
        (4, with_field(GOOD_ORDERS_BODY, 13, [[0.1, 0.0, 5.0]]), RefusedReason.INVALID_VALUE),
        (4, with_field(GOOD_ORDERS_BODY, 13, [[0.0, 1.1e6, 5.0]]), RefusedReason.INVALID_VALUE),
        (4, with_field(GOOD_ORDERS_BODY, 13, [[0.0, 1.0, 0.0]]), RefusedReason.INVALID_VALUE),
        (4, with_field(GOOD_ORDERS_BODY, 13, [[0.0, 1.0, 200.1]]), RefusedReason.INVALID_VALUE),
        (4, with_field(GOOD_ORDERS_BODY, 13, [[0.0, 1.0, math.nan]]), RefusedReason.INVALID_VALUE),
        (4, with_field(GOOD_ORDERS_BODY, 13, 8 * [[0.0, 1.0, 5.0]]), None),
        (4, with_field(GOOD_ORDERS_BODY, 13, 9 * [[0.0, 1.0, 5.0]]), RefusedReason.INVALID_VALUE),
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
def test_an_envelope_with_a_correct_code_and_invalid_fields_is_refused(
    kind: int, body: object, reason: RefusedReason | None
) -> None:
    header = header_of(kind, *((7, 0) if kind in (1, 3) else (0, 7)))

    assert reason_of(sealed(header, msgspec.msgpack.encode(body))) is reason


@pytest.mark.parametrize(
    ("kind", "source", "destination", "body"),
    [
        (1, 0, 7, GOOD_REPORT_BODY),
        (2, 7, 0, GOOD_AUTHORITY_BODY),
        (3, 0, 7, GOOD_STATUS_BODY),
        (4, 7, 0, GOOD_ORDERS_BODY),
    ],
)
def test_the_address_of_the_wayside_is_no_train(
    kind: int, source: int, destination: int, body: list[object]
) -> None:
    payload = sealed(header_of(kind, source, destination), msgspec.msgpack.encode(body))

    assert reason_of(payload) is RefusedReason.INVALID_VALUE


@pytest.mark.parametrize("version", [2, 4])
def test_another_version_is_refused(version: int) -> None:
    payload = sealed(
        header_of(2, 0, 7, version=version), msgspec.msgpack.encode(GOOD_AUTHORITY_BODY)
    )

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
        (replace(AUTHORITY, rear_m=1450.5), "rear_m 1450.5 is off every line or beyond end_m"),
        (replace(STATUS, mode=256), "TrainStatus: mode 256 is not in 0..255"),
        (replace(STATUS, front_m=math.nan), "front_m nan"),
        (replace(STATUS, train=0), "train 0"),
        (replace(STATUS, destination=65536), "destination 65536"),
        (replace(ORDERS, train=0), "TrainOrders: train 0"),
        (replace(ORDERS, source=-1), "source -1"),
        (replace(ORDERS, releases=-1), "releases -1"),
        (replace(ORDERS, released_emergency=-1), "released_emergency -1"),
        (replace(STATUS, emergency_number=2**32), "emergency_number 4294967296"),
        (replace(ORDERS, restrictions=9 * ORDERS.restrictions[:1]), "9 restrictions, at most 8"),
    ],
)
def test_a_message_that_must_not_be_sent_is_refused_by_name(message: Message, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        pack(message)


def test_a_key_is_read_as_hexadecimal() -> None:
    assert safety_key("00112233445566778899aabbccddeeff") == bytes.fromhex(
        "00112233445566778899aabbccddeeff"
    )


@pytest.mark.parametrize(
    ("text", "words"), [("0011", "2 bytes, at least 16"), ("key!", "not hexadecimal")]
)
def test_an_invalid_key_is_refused_with_the_reason(text: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        safety_key(text)


@pytest.mark.parametrize("length", [16, 63, 64, 65, 200])
def test_the_safety_code_is_the_standard_one_for_a_key_of_any_length(length: int) -> None:
    key = bytes(range(length))

    for message in (REPORT, ORDERS):
        payload = pack(message, key)
        assert payload[-16:] == hmac.digest(key, payload[:-16], hashlib.sha256)[:16]


@SAMPLES
@pytest.mark.parametrize("version", [0, 1, 2**64 - 1])
def test_a_message_carries_the_version_of_the_track_database(
    message: Message, version: int
) -> None:
    payload = pack(message, database=version)

    assert payload[18:26] == version.to_bytes(8, "big")
    assert unpack(payload) == unpack(payload, database=version) == message


@SAMPLES
@pytest.mark.parametrize(("sent", "here"), [(1, 2), (2, 1), (0, 1), (1, 0), (2**63, 2**64 - 1)])
def test_a_message_of_another_track_database_is_refused(
    message: Message, sent: int, here: int
) -> None:
    result = unpack(pack(message, database=sent), database=here)

    detail = f"{sent:016x} of the sender, {here:016x} here"
    assert result == Refused(RefusedReason.OTHER_DATABASE, detail)
