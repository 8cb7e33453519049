"""Envelopes at the limits of length, key and type, and the counters and messages of the gates."""

import hmac
import struct
from dataclasses import replace

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zenoh_config.codec import BENCH_KEY, LineKeys, pack, safety_key, unpack
from zenoh_config.messages import (
    Message,
    MovementAuthority,
    PositionReport,
    Refused,
    RefusedReason,
    TrainOrders,
    TrainStatus,
)
from zenoh_config.sequencing import AuthorityGate, OrdersGate, ReportGate

MS = 1_000_000
NOW_NS = 10_000 * MS
HEADER_BYTES, CODE_BYTES = 26, 16
REPORT = PositionReport(7, 3, 50, NOW_NS, 10.0, 11.0, -60.0, 1.0, False)
AUTHORITY = MovementAuthority(7, 3, 2, 50, NOW_NS - 300 * MS, 900.0, 0, 99)
STATUS = TrainStatus(
    7, 3, 50, NOW_NS, 4, 1, 0, True, False, 10.0, True, False, False, False, False, False, False
)
ORDERS = TrainOrders(
    7, 3, 50, NOW_NS - 300 * MS, True, False, False, False, False, 0, False, False, False, False,
    True,
)  # fmt: skip
ANSWERS = pytest.mark.parametrize("answer", [AUTHORITY, ORDERS], ids=["authority", "orders"])
REPORTS = pytest.mark.parametrize("report", [REPORT, STATUS], ids=["position", "status"])


def with_code(sealed: bytes, key: bytes = BENCH_KEY) -> bytes:
    return sealed + hmac.digest(key, sealed, "sha256")[:CODE_BYTES]


def headed(body: bytes, *, version: int = 3, kind: int = 2) -> bytes:
    return with_code(struct.pack(">BBHHIQQ", version, kind, 0, 7, 5, 6, 0) + body)


def refused(payload: bytes) -> Refused:
    result = unpack(payload)
    assert isinstance(result, Refused)
    return result


def check(answer: MovementAuthority | TrainOrders, now_ns: int = NOW_NS) -> Refused | None:
    """Check a message with a new gate of train 7 in incarnation 3; it accepts three sources and
    an age of 1 s."""
    if isinstance(answer, MovementAuthority):
        gate = AuthorityGate(train=7, boot=3, max_age_ns=1000 * MS, sources=(0, 9, 12))
        return gate.check(answer, now_ns)
    orders_gate = OrdersGate(train=7, boot=3, max_age_ns=1000 * MS, sources=(0, 9, 12))
    return orders_gate.check(answer, now_ns)


# Lengths.


@pytest.mark.parametrize("length", range(HEADER_BYTES + 1))
def test_an_envelope_without_a_body_is_too_short_even_with_a_correct_code(
    length: int,
) -> None:
    payload = with_code(struct.pack(">BBHHIQQ", 3, 2, 0, 7, 5, 6, 0)[:length])

    assert refused(payload) == Refused(RefusedReason.TOO_SHORT, f"{length + 16} bytes")


@pytest.mark.parametrize("length", range(CODE_BYTES))
def test_an_envelope_shorter_than_its_code_is_too_short(length: int) -> None:
    assert refused(bytes(length)) == Refused(RefusedReason.TOO_SHORT, f"{length} bytes")


def test_one_byte_of_a_body_is_enough_to_be_read() -> None:
    assert refused(headed(b"\x90")).reason is RefusedReason.WRONG_FIELDS
    assert refused(bytes(43)).reason is RefusedReason.WRONG_CODE


@pytest.mark.parametrize(
    ("length", "reason"),
    [
        (4095, RefusedReason.WRONG_FIELDS),
        (4096, RefusedReason.WRONG_FIELDS),
        (4097, RefusedReason.TOO_LONG),
        (5000, RefusedReason.TOO_LONG),
    ],
)
def test_a_genuine_envelope_of_4096_bytes_is_read_and_a_longer_one_is_not(
    length: int, reason: RefusedReason
) -> None:
    payload = headed(bytes(length - HEADER_BYTES - CODE_BYTES))

    assert len(payload) == length
    assert refused(payload).reason is reason


def test_the_refusal_of_a_long_envelope_names_its_length() -> None:
    assert refused(bytes(4097)) == Refused(RefusedReason.TOO_LONG, "4097 bytes")


# Keys.


@pytest.mark.parametrize("length", [16, 17, 64, 65])
def test_a_key_of_sixteen_bytes_or_more_seals_and_opens(length: int) -> None:
    key = safety_key("ab" * length)

    assert key == bytes([0xAB] * length)
    assert unpack(pack(AUTHORITY, key), key) == AUTHORITY


def test_a_key_of_fifteen_bytes_is_refused() -> None:
    with pytest.raises(ValueError, match="15 bytes, at least 16 are needed"):
        safety_key("ab" * 15)


def test_many_keys_in_turn_are_never_confused() -> None:
    keys = [bytes([number] * 16) for number in range(40)]
    payloads = [pack(AUTHORITY, key) for key in keys]

    for key, payload in zip(keys, payloads, strict=True):
        sealed = payload[:-CODE_BYTES]
        assert payload == with_code(sealed, key)
        assert unpack(payload, key) == AUTHORITY
        for other in (keys[0], keys[-1]):
            if other != key:
                assert isinstance(unpack(payload, other), Refused)


# The checks come in this order: version, type, fields.


@pytest.mark.parametrize("version", [0, 1, 2, 4, 15])
def test_an_envelope_of_another_version_is_checked_no_further(version: int) -> None:
    payload = headed(b"\xc1", version=version, kind=200)

    words = f"version {version}, known is 3"
    assert refused(payload) == Refused(RefusedReason.UNKNOWN_VERSION, words)


@pytest.mark.parametrize("kind", [0, *range(5, 16), *range(35, 256)])
def test_an_unused_type_is_unknown(kind: int) -> None:
    payload = headed(b"\xc1", kind=kind)

    assert refused(payload) == Refused(RefusedReason.UNKNOWN_TYPE, f"type {kind}")


@pytest.mark.parametrize("kind", [*range(1, 5), *range(16, 35)])
@pytest.mark.parametrize(
    "body",
    [
        b"\xc1",
        b"\x91" * 4000,
        b"\x9f" + b"\x91" * 4000,
        b"\x81" * 4000,
        b"\xdd\xff\xff\xff\xff\x01\x01",
        b"\xa4\xff\xff\xff\xff",
        b"\xd6\xff\x00\x00\x00\x00",
        b"\x95\x03",
    ],
    ids=["no msgpack", "deep", "deep in an array", "maps", "endless", "text", "time", "cut off"],
)
def test_a_hostile_body_of_a_known_type_has_wrong_fields(kind: int, body: bytes) -> None:
    assert refused(headed(body, kind=kind)).reason is RefusedReason.WRONG_FIELDS


wild_m = st.floats() | st.sampled_from([-1e6, 0.0, 1e6])
wild_numbers = st.integers(-(2**63), 2**64 - 1) | st.sampled_from([0, 2**32 - 1, 2**32, 2**63])


@given(wild_numbers, wild_numbers, wild_numbers, wild_m, st.none() | wild_m)
def test_receiver_and_sender_apply_the_same_checks_to_an_authority(
    boot: int, term: int, echo_stamp_ns: int, end_m: float, rear_m: float | None
) -> None:
    sent = MovementAuthority(7, boot, term, 5, echo_stamp_ns, end_m, 0, 6, rear_m)
    payload = headed(msgspec.msgpack.encode([boot, term, echo_stamp_ns, end_m, rear_m, 0]))

    try:
        assert pack(sent) == payload
    except ValueError:
        assert refused(payload).reason is RefusedReason.INVALID_VALUE
    else:
        assert unpack(payload) == sent


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (replace(REPORT, train=0), "PositionReport: train 0 is not in 1..65535"),
        (replace(AUTHORITY, term=-1), "MovementAuthority: term -1 is not in 0..4294967295"),
        (replace(STATUS, cause=256), "TrainStatus: cause 256 is not in 0..255"),
        (replace(ORDERS, source=-1), "TrainOrders: source -1 is not in 0..65535"),
    ],
)
def test_a_message_that_must_not_be_sent_names_message_and_field(
    message: Message, words: str
) -> None:
    with pytest.raises(ValueError, match=f"^{words}$"):
        pack(message)


# Gates.


@ANSWERS
def test_the_first_number_of_the_first_term_is_accepted(
    answer: MovementAuthority | TrainOrders,
) -> None:
    first = replace(answer, sequence=0)

    assert check(replace(first, term=0) if isinstance(first, MovementAuthority) else first) is None


@ANSWERS
def test_a_number_below_the_first_one_is_refused(
    answer: MovementAuthority | TrainOrders,
) -> None:
    below = replace(answer, sequence=-1)
    if isinstance(below, MovementAuthority):
        below = replace(below, term=0)

    objection = check(below)

    assert objection == Refused(RefusedReason.NOT_NEWER, "sequence -1, -1 is held")


@ANSWERS
@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"train": 8}, Refused(RefusedReason.WRONG_DESTINATION, "for train 8, this is train 7")),
        ({"source": 10}, Refused(RefusedReason.WRONG_SOURCE, "from 10")),
        ({"boot": 4}, Refused(RefusedReason.WRONG_BOOT, "for incarnation 4, this is 3")),
        (
            {"echo_stamp_ns": NOW_NS + 2 * MS - 1},
            Refused(RefusedReason.FROM_THE_FUTURE, "by 1 ms"),
        ),
        (
            {"echo_stamp_ns": NOW_NS + 5000 * MS},
            Refused(RefusedReason.FROM_THE_FUTURE, "by 5000 ms"),
        ),
        ({"echo_stamp_ns": NOW_NS - 1001 * MS}, Refused(RefusedReason.TOO_OLD, "1001 ms")),
        ({"echo_stamp_ns": NOW_NS - 1002 * MS + 1}, Refused(RefusedReason.TOO_OLD, "1001 ms")),
        ({"source": 0}, None),
        ({"source": 9}, None),
        ({"source": 12}, None),
    ],
)
def test_a_refusal_names_the_error_and_its_size(
    answer: MovementAuthority | TrainOrders, change: dict[str, int], expected: Refused | None
) -> None:
    assert check(replace(answer, **change)) == expected  # type: ignore[arg-type]


def test_the_refusal_of_an_old_authority_names_the_held_one() -> None:
    gate = AuthorityGate(train=7, boot=3, max_age_ns=1000 * MS)
    gate.check(AUTHORITY, NOW_NS)

    old_term = gate.check(replace(AUTHORITY, term=1, sequence=60), NOW_NS)
    repeated = gate.check(replace(AUTHORITY, sequence=49), NOW_NS)

    assert old_term == Refused(RefusedReason.OLD_TERM, "term 1, 2 was seen")
    assert repeated == Refused(RefusedReason.NOT_NEWER, "sequence 49, 50 is held")
    assert gate.refusals == {RefusedReason.OLD_TERM: 1, RefusedReason.NOT_NEWER: 1}


def test_the_refusal_of_old_orders_names_the_held_ones() -> None:
    gate = OrdersGate(train=7, boot=3, max_age_ns=1000 * MS)
    gate.check(ORDERS, NOW_NS)

    repeated = gate.check(replace(ORDERS, sequence=49), NOW_NS)

    assert repeated == Refused(RefusedReason.NOT_NEWER, "sequence 49, 50 is held")


@REPORTS
def test_the_refusal_of_a_report_names_its_sender_and_the_last_accepted_number(
    report: PositionReport | TrainStatus,
) -> None:
    gate = ReportGate()
    gate.check(report)

    elsewhere = gate.check(replace(report, destination=5, sequence=51))
    earlier_life = gate.check(replace(report, boot=2, sequence=51))
    repeated = gate.check(replace(report, sequence=49))

    assert elsewhere == Refused(RefusedReason.WRONG_DESTINATION, "for 5, this is 0")
    assert earlier_life == Refused(
        RefusedReason.WRONG_BOOT, "incarnation 2 of train 7, 3 was received"
    )
    assert repeated == Refused(RefusedReason.NOT_NEWER, "sequence 49 of train 7, 50 was received")


@REPORTS
def test_a_gate_for_reports_counts_accepted_and_refused_ones(
    report: PositionReport | TrainStatus,
) -> None:
    gate = ReportGate()
    assert (gate.accepted, gate.refusals.total()) == (0, 0)

    for sequence in (50, 51, 51, 52, 40, 53):
        gate.check(replace(report, sequence=sequence))

    assert (gate.accepted, gate.refusals) == (4, {RefusedReason.NOT_NEWER: 2})


@REPORTS
def test_a_gate_with_an_address_accepts_only_messages_for_that_address(
    report: PositionReport | TrainStatus,
) -> None:
    gate = ReportGate(address=5)

    assert gate.check(replace(report, destination=5)) is None
    assert gate.check(report) == Refused(RefusedReason.WRONG_DESTINATION, "for 0, this is 5")


# Keys that change while programs run.

OLD, NEW = b"o" * 16, b"n" * 16
STEPS = [
    f"{OLD.hex()}\n",
    f"{OLD.hex()}\n1 {NEW.hex()}\n",
    f"1 {NEW.hex()}\n{OLD.hex()}\n",
    f"1 {NEW.hex()}\n",
]
"""Texts of a key file: before a change, a key added, the new one used, the old one dropped."""


def test_no_message_is_lost_while_one_program_is_a_step_ahead_of_the_other() -> None:
    first, second = LineKeys(STEPS[0]), LineKeys(STEPS[0])

    for text in STEPS[1:]:
        first.take(text)
        for sender, receiver in ((first, second), (second, first)):
            assert unpack(pack(AUTHORITY, sender), receiver) == AUTHORITY
        second.take(text)
    assert first.sending == (1, NEW)


def test_a_program_that_missed_the_change_gives_the_number_of_the_key() -> None:
    sealed = pack(AUTHORITY, LineKeys(STEPS[3]))

    assert sealed[0] == 1 << 4 | 3
    for known in (LineKeys(STEPS[0]), OLD, NEW):
        words = "sealed with key 1, which is unknown here"
        assert unpack(sealed, known) == Refused(RefusedReason.WRONG_CODE, words)


def test_key_0_is_sealed_as_before_keys_had_numbers() -> None:
    assert pack(AUTHORITY, LineKeys(STEPS[1])) == pack(AUTHORITY, OLD)


def test_the_number_of_a_key_is_under_the_safety_code() -> None:
    twice = LineKeys(f"1 {OLD.hex()}\n2 {OLD.hex()}\n")
    sealed = bytearray(pack(AUTHORITY, twice))
    sealed[0] = 2 << 4 | 3

    result = unpack(bytes(sealed), twice)
    assert isinstance(result, Refused)
    assert result.reason is RefusedReason.WRONG_CODE


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "0 keys; 1 or 2 with different identifiers are needed"),
        (STEPS[1] + f"2 {NEW.hex()}", "3 keys; 1 or 2 with different"),
        (f"{OLD.hex()}\n0 {NEW.hex()}", "2 keys; 1 or 2 with different"),
        (f"16 {OLD.hex()}", "key identifier '16' is not in 0..15"),
        (f"x {OLD.hex()}", "key identifier 'x' is not in 0..15"),
        ("1 abcd", "safety key: 2 bytes, at least 16 are needed"),
        ("1 xy", "safety key: not hexadecimal"),
    ],
)
def test_an_invalid_key_file_changes_nothing(text: str, words: str) -> None:
    keys = LineKeys(STEPS[1])

    with pytest.raises(ValueError, match=words):
        keys.take(text)
    assert (keys.sending, keys.text) == ((0, OLD), STEPS[1])
    assert keys.accepted == {0: OLD, 1: NEW}
