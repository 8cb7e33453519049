"""Train-to-train messages have the documented layout, and are valid up to the limits of their
fields."""

import dataclasses
import enum
import hmac
import math
import struct
from typing import Any

import msgspec
import pytest

from zenoh_config.codec import BENCH_KEY, pack, unpack
from zenoh_config.messages import Refused, RefusedReason, SpeedRestriction
from zenoh_config.t2t import (
    Admission,
    AdmissionState,
    AreaAuthority,
    ClaimKind,
    Heartbeat,
    LeaseAnswer,
    LeaseKind,
    LeaseRequest,
    LineOrder,
    ObjectClaim,
    ObjectState,
    ObjectStatus,
    OrderKind,
    Phase,
    RosterAck,
    RosterCommit,
    RosterEntry,
    SectionState,
    SignedGrant,
    StandbySync,
    SwitchKind,
    SwitchStep,
    SyncAck,
    SyncEntry,
    T2tMessage,
    TrackStatus,
    TrainReport,
)
from zenoh_config.t2t_codec import body_fields, knows, problem_of_t2t
from zenoh_config.t2t_supervision import (
    Decree,
    DecreeAnswer,
    DecreeKind,
    LeaseNote,
    LeaseReason,
    LineState,
    Removal,
    RemovalAnswer,
    RemovalState,
    RosterPlace,
    TrainDecree,
)

STAMP_NS = 5_000_000_000
MAX_NUMBER = 4_294_967_295
MAX_TERM = 281_474_976_710_655
MAX_STAMP_NS = 9_223_372_036_854_775_807
LINE_END_M = 1_000_000.0
JUST_OFF_LINE_M = math.nextafter(LINE_END_M, math.inf)
HEAD = (9, 4, 1, 7, 2, 100, STAMP_NS)
HEAD_OF_BODY: list[object] = [1, 7, 2]
"""Area, term and boot; the header of the envelope holds the rest."""
SLOW = SpeedRestriction(10.5, 20.5, 5.5)
SHUT = SpeedRestriction(30.5, 40.5, 6.5)
REPORT = TrainReport(
    *HEAD, True, 98.5, 102.5, 20.5, 21.5, 3.5, False, 310.5, 300.5, 140.5, 7, 3, True, 11, 2, 16,
    False, 12, 4930,
)  # fmt: skip
AUTHORITY = AreaAuthority(*HEAD, 5, 4900, 800.5, 15.5, 3, 6, (SLOW, SHUT))
SIGNED = SignedGrant(9, 17, b"by arbiter 9")
EXAMPLES: list[tuple[int, T2tMessage, list[object]]] = [
    (16, LeaseRequest(*HEAD, LeaseKind.RENEW, 5, 11, 12, 3, 120), [2, 5, 11, 12, 3, 120]),
    (
        17,
        LeaseAnswer(
            *(*HEAD, True, 5, 4990, 6, 13, 14, 15, (RosterEntry(9, 410.5, True, 8, False),)),
            (SIGNED,),
        ),
        [True, 5, 4990, 6, 13, 14, 15, [[9, 410.5, True, 8, False]], [[9, 17, b"by arbiter 9"]]],
    ),
    (18, Heartbeat(*HEAD, Phase.ISSUING, 4, 3, (SIGNED,)), [2, 4, 3, [[9, 17, b"by arbiter 9"]]]),
    (
        19,
        REPORT,
        [
            *(True, 98.5, 102.5, 20.5, 21.5, 3.5, False, 310.5, 300.5, 140.5),
            *(7, 3, True, 11, 2, 16, False, 12, 4930),
        ],
    ),
    (
        20,
        AUTHORITY,
        [5, 4900, 800.5, 15.5, 3, 6, [[10.5, 20.5, 5.5], [30.5, 40.5, 6.5]]],
    ),
    (21, StandbySync(*HEAD, 3, (SyncEntry(9, 1.5, 2.5, 8),)), [3, [[9, 1.5, 2.5, 8]]]),
    (22, SyncAck(*HEAD, 99), [99]),
    (
        23,
        RosterCommit(*HEAD, 3, (RosterEntry(9, 4.5, False, 8, True), RosterEntry(4, 1.5, True))),
        [3, [[9, 4.5, False, 8, True], [4, 1.5, True, 0, False]]],
    ),
    (24, RosterAck(*HEAD, 3), [3]),
    (25, SwitchStep(*HEAD, SwitchKind.RESIGN, 3, 11), [5, 3, 11]),
    (26, ObjectClaim(*HEAD, 3, ClaimKind.RELEASE, 8), [3, 2, 8]),
    (27, ObjectStatus(*HEAD, 3, ObjectState.LOCKED, 6, 8, True), [3, 2, 6, 8, True]),
    (
        28,
        TrackStatus(*HEAD, 4950, (SectionState(1, True, 16),), (SLOW,), (SHUT,)),
        [4950, [[1, True, 16]], [[10.5, 20.5, 5.5]], [[30.5, 40.5, 6.5]]],
    ),
    (29, LineOrder(*HEAD, OrderKind.GO, 3), [5, 3]),
    (30, Admission(*HEAD, AdmissionState.UNPLACED, 3), [4, 3]),
    (
        31,
        Decree(*HEAD, 4900, DecreeKind.OPEN, 3, 10.5, 20.5, 5.5),
        [4900, 10, 3, 10.5, 20.5, 5.5],
    ),
    (
        32,
        LineState(
            *(*HEAD, 5, 98, DecreeAnswer.TOO_OLD),
            (TrainDecree(3, True, False, True, 8),),
            (LeaseNote(1, 3, 7, 9, LeaseReason.AGAIN, 4000),),
            (SLOW,),
            (SHUT,),
            (RosterPlace(1, 3), RosterPlace(1, 9)),
        ),
        [
            *(5, 98, 7, [[3, True, False, True, 8]], [[1, 3, 7, 9, 4, 4000]]),
            *([[10.5, 20.5, 5.5]], [[30.5, 40.5, 6.5]], [[1, 3], [1, 9]]),
        ],
    ),
    (33, Removal(*HEAD, 4900, 3), [4900, 3]),
    (34, RemovalAnswer(*HEAD, 3, RemovalState.TOO_OLD), [3, 5]),
]
examples = pytest.mark.parametrize(
    ("number", "message", "rest"), EXAMPLES, ids=[type(each).__name__ for _, each, _ in EXAMPLES]
)

UNPLACED = dataclasses.replace(REPORT, localised=False)
"""A report without position, whose positions do not count, so that the test can vary each alone."""
WHOLE_LINE = dataclasses.replace(AUTHORITY, rear_m=-LINE_END_M, end_m=LINE_END_M)
ALONE: dict[type[T2tMessage], T2tMessage] = {TrainReport: UNPLACED, AreaAuthority: WHOLE_LINE}
"""Examples for messages whose fields depend on each other; they stay valid when one field
changes."""
TRIED = [ALONE.get(type(message), message) for _, message, _ in EXAMPLES]
ADDRESSES = frozenset(
    (
        *("source", "destination", "successor", "holder", "standby", "train", "behind"),
        *("before", "waits_for", "arbiter"),
    )
)


def sealed(number: int, body: object) -> bytes:
    """An envelope built from the documented format alone."""
    header = struct.pack(">BBHHIQQ", 3, number, 9, 4, 100, STAMP_NS, 0)
    told = header + msgspec.msgpack.encode(body)
    return told + hmac.digest(BENCH_KEY, told, "sha256")[:16]


def reason(number: int, body: object) -> RefusedReason | None:
    result = unpack(sealed(number, body))
    return result.reason if isinstance(result, Refused) else None


def most_of(name: str) -> int:
    """The largest integer that a field of this name may hold."""
    if name.endswith("_ns"):
        return MAX_STAMP_NS
    if name in ADDRESSES:
        return 65_535
    if name == "term" or name.endswith("_term"):
        return MAX_TERM
    return {"area": 255, "comes_from": 255, "axles": 1000, "rank": 128}.get(name, MAX_NUMBER)


def fields_of(kind: type) -> list[tuple[T2tMessage, str]]:
    """Every field of every message whose type is exactly `kind`."""
    return [
        (message, field.name)
        for message in TRIED
        for field in dataclasses.fields(message)
        if type(getattr(message, field.name)) is kind
    ]


def problem_with(message: T2tMessage, name: str, value: object) -> str:
    changed: dict[str, Any] = {name: value}
    return problem_of_t2t(dataclasses.replace(message, **changed))


def told_of(fields: list[tuple[T2tMessage, str]]) -> list[str]:
    return [f"{type(message).__name__}.{name}" for message, name in fields]


# Layout.


@examples
def test_a_message_is_laid_out_as_documented(
    number: int, message: T2tMessage, rest: list[object]
) -> None:
    assert pack(message) == sealed(number, HEAD_OF_BODY + rest)


@examples
def test_an_unpacked_message_has_all_its_types(
    number: int, message: T2tMessage, rest: list[object]
) -> None:
    """Equality accepts a list for an entry and a number for an enumeration; the text form does
    not."""
    assert repr(unpack(sealed(number, HEAD_OF_BODY + rest))) == repr(message)


@examples
def test_a_body_with_a_missing_or_extra_field_is_refused(
    number: int, message: T2tMessage, rest: list[object]
) -> None:
    whole = HEAD_OF_BODY + rest
    others: tuple[object, ...] = (whole[:-1], whole[1:], [*whole, 0], [*whole, False], [], {}, None)

    for body in others:
        assert reason(number, body) is RefusedReason.WRONG_FIELDS


WRONG: dict[type, list[object]] = {
    bool: [0, 1, 1.0, "true", None, []],
    int: [True, 3.0, 3.5, "3", b"3", None, [3]],
    float: [True, "3", b"3", None, [3.0]],
    bytes: [True, 3, 3.5, None, [3]],
    list: [None, 3, "", {}, [3], [[]], [["3"]], [[None, None, None, None, None]]],
}


@examples
def test_a_value_of_another_type_is_refused_in_any_field(
    number: int, message: T2tMessage, rest: list[object]
) -> None:
    whole = HEAD_OF_BODY + rest

    for at, good in enumerate(whole):
        for wrong in WRONG[type(good)]:
            body = [*whole[:at], wrong, *whole[at + 1 :]]
            assert reason(number, body) is RefusedReason.WRONG_FIELDS, (at, wrong)


@examples
def test_a_value_of_another_type_is_refused_in_any_field_of_an_entry(
    number: int, message: T2tMessage, rest: list[object]
) -> None:
    whole = HEAD_OF_BODY + rest

    for at, entries in enumerate(whole):
        entry = entries[0] if isinstance(entries, list) else []
        for place, good in enumerate(entry):
            for wrong in WRONG[type(good)]:
                spoiled = [*entry[:place], wrong, *entry[place + 1 :]]
                body = [*whole[:at], [entry, spoiled], *whole[at + 1 :]]
                assert reason(number, body) is RefusedReason.WRONG_FIELDS, (at, place, wrong)


@examples
def test_a_body_holds_all_that_the_header_does_not(
    number: int, message: T2tMessage, rest: list[object]
) -> None:
    names = body_fields(type(message))

    assert names[:3] == ("area", "term", "boot")
    assert len(names) == len(HEAD_OF_BODY + rest)
    assert not {"source", "destination", "sequence", "stamp_ns"} & set(names)


def test_types_are_numbered_from_16_without_a_gap() -> None:
    known = [number for number in range(256) if knows(number)]

    assert known == [number for number, _, _ in EXAMPLES] == list(range(16, 16 + len(EXAMPLES)))


# Single fields.


@pytest.mark.parametrize("message", [*TRIED, REPORT, AUTHORITY], ids=lambda m: type(m).__name__)
def test_a_valid_message_has_no_problem(message: T2tMessage) -> None:
    assert problem_of_t2t(message) == ""


WHOLE_NUMBERS = fields_of(int)


@pytest.mark.parametrize(("message", "name"), WHOLE_NUMBERS, ids=told_of(WHOLE_NUMBERS))
def test_an_integer_is_valid_from_zero_to_its_maximum(message: T2tMessage, name: str) -> None:
    most = most_of(name)

    for value in (0, 1, most - 1, most):
        assert problem_with(message, name, value) == ""
    for value in (-most, -1, most + 1, 2 * most + 2):
        assert problem_with(message, name, value) == f"{name} {value} is not in 0..{most}"


MEASURES = fields_of(float)


@pytest.mark.parametrize(("message", "name"), MEASURES, ids=told_of(MEASURES))
def test_a_measure_is_valid_in_both_directions_up_to_its_limit(
    message: T2tMessage, name: str
) -> None:
    most = 200.0 if name.endswith("_mps") else LINE_END_M
    beyond = math.nextafter(most, math.inf)

    for value in (-most, 0.0, most):
        assert problem_with(message, name, value) == ""
    for value in (-math.inf, -beyond, beyond, math.inf, math.nan):
        assert problem_with(message, name, value) == f"{name} {value} is not in ±{most}"


@pytest.mark.parametrize(("message", "name"), MEASURES, ids=told_of(MEASURES))
def test_an_integer_measure_is_checked_like_any_measure(message: T2tMessage, name: str) -> None:
    """A chainage of -5 is valid; one of 1 000 001 is not."""
    most = 200 if name.endswith("_mps") else 1_000_000

    for value in (-most, -5, 0, most):
        assert problem_with(message, name, value) == ""
    for value in (-most - 1, most + 1):
        assert problem_with(message, name, value).startswith(f"{name} {value} is not in ±")


@pytest.mark.parametrize("message", TRIED, ids=lambda m: type(m).__name__)
def test_both_booleans_and_every_enumeration_value_are_valid(message: T2tMessage) -> None:
    for field in dataclasses.fields(message):
        value = getattr(message, field.name)
        if isinstance(value, bool):
            others: list[object] = [False, True]
        else:
            others = list(type(value)) if isinstance(value, enum.IntEnum) else []
        for each in others:
            assert problem_with(message, field.name, each) == ""


# Lists and their entries.

LISTS = [
    (message, field.name)
    for message in TRIED
    for field in dataclasses.fields(message)
    if isinstance(getattr(message, field.name), tuple)
]
MOST_ENTRIES = {
    "roster": 128, "entries": 128, "trains": 128, "leases": 56, "sections": 256, "silent": 64,
    "restrictions": 8, "closed": 8, "grants": 5,
}  # fmt: skip
lists = pytest.mark.parametrize(("message", "name"), LISTS, ids=told_of(LISTS))


@lists
def test_a_list_is_valid_up_to_its_maximum_length(message: T2tMessage, name: str) -> None:
    one, most = getattr(message, name)[:1], MOST_ENTRIES[name]

    for count in (0, 1, most - 1, most):
        assert problem_with(message, name, one * count) == ""
    words = f"{most + 1} {name}, at most {most} fit"
    assert problem_with(message, name, one * (most + 1)) == words


ENTRIES = [
    (message, name, place)
    for message, name in LISTS
    if not isinstance(getattr(message, name)[0], SpeedRestriction)
    for place in getattr(message, name)[0]._fields
    if place != "signature"
]


@pytest.mark.parametrize(
    ("message", "name", "place"),
    ENTRIES,
    ids=[f"{type(message).__name__}.{name}.{place}" for message, name, place in ENTRIES],
)
def test_a_field_of_an_entry_is_checked_like_a_field_of_a_message(
    message: T2tMessage, name: str, place: str
) -> None:
    good = getattr(message, name)[0]
    value = getattr(good, place)
    if isinstance(value, bool | enum.IntEnum):
        edges: list[object] = list(type(value)) if isinstance(value, enum.Enum) else [False, True]
        beyond: list[object] = []
    elif isinstance(value, float):
        edges = [-LINE_END_M, -5, 0.0, LINE_END_M]
        beyond = [-math.inf, -JUST_OFF_LINE_M, JUST_OFF_LINE_M, math.inf, math.nan]
    else:
        most = most_of(place)
        edges, beyond = [0, 1, most], [-1, most + 1, 2 * most + 2]

    for each in edges:
        assert problem_with(message, name, (good, good._replace(**{place: each}))) == ""
    for each in beyond:
        words = problem_with(message, name, (good, good._replace(**{place: each})))
        assert words.startswith(f"{name}: {place} {each} is not in ")


def test_a_signature_has_at_most_the_length_of_one() -> None:
    for length, words in ((0, ""), (64, ""), (65, "grants: signature of 65 bytes")):
        grant = SIGNED._replace(signature=bytes(length))
        assert problem_of_t2t(Heartbeat(*HEAD, Phase.ISSUING, 4, 3, (grant,))) == words


STRETCHES = [
    (message, name)
    for message, name in LISTS
    if isinstance(getattr(message, name)[0], SpeedRestriction)
]
stretches = pytest.mark.parametrize(("message", "name"), STRETCHES, ids=told_of(STRETCHES))


@stretches
@pytest.mark.parametrize(
    ("start_m", "end_m", "limit_mps"),
    [
        (-LINE_END_M, LINE_END_M, 5.0),
        (3.0, 3.0, 5.0),
        (LINE_END_M, LINE_END_M, 200.0),
        (-LINE_END_M, -LINE_END_M, 0.5),
        (-5, -4, 1),
        (0.0, 1.0, math.nextafter(0.0, 1.0)),
    ],
)
def test_a_stretch_may_cover_one_point_or_the_whole_line_at_any_positive_speed(
    message: T2tMessage, name: str, start_m: float, end_m: float, limit_mps: float
) -> None:
    stretch = SpeedRestriction(start_m, end_m, limit_mps)

    assert problem_with(message, name, (SLOW, stretch)) == ""


@stretches
@pytest.mark.parametrize(
    ("start_m", "end_m"),
    [
        (-JUST_OFF_LINE_M, 0.0),
        (0.0, JUST_OFF_LINE_M),
        (math.nextafter(3.0, 4.0), 3.0),
        (math.nan, 3.0),
        (3.0, math.nan),
    ],
)
def test_a_stretch_with_reversed_ends_is_invalid(
    message: T2tMessage, name: str, start_m: float, end_m: float
) -> None:
    stretch = SpeedRestriction(start_m, end_m, 5.0)

    words = f"{name}: from {start_m} m to {end_m} m is no stretch of a line"
    assert problem_with(message, name, (SLOW, stretch)) == words


@stretches
@pytest.mark.parametrize("limit_mps", [0.0, -1.0, math.nextafter(200.0, 201.0), math.inf, math.nan])
def test_a_limit_of_zero_or_an_absurd_speed_is_invalid(
    message: T2tMessage, name: str, limit_mps: float
) -> None:
    stretch = SpeedRestriction(1.0, 2.0, limit_mps)

    words = f"{name}: limit {limit_mps} m/s is not in 0..200.0"
    assert problem_with(message, name, (SLOW, stretch)) == words


# Fields that depend on each other.


def placed(rear_m: float, low_m: float, high_m: float, latent_m: float, protected_m: float) -> str:
    """The problem of a located train that reports these positions."""
    report = dataclasses.replace(
        REPORT,
        rear_min_m=rear_m,
        front_min_m=low_m,
        front_max_m=high_m,
        latent_m=latent_m,
        protected_m=protected_m,
    )
    return problem_of_t2t(report)


@pytest.mark.parametrize(
    "places_m",
    [
        (5.0, 5.0, 5.0, 5.0, 5.0),
        (5.0, 5.0, 6.0, 7.0, 5.0),
        (5.0, 6.0, 6.0, 7.0, 6.0),
        (5.0, 6.0, 7.0, 7.0, 7.0),
        (-LINE_END_M, 6.0, 7.0, LINE_END_M, 0.0),
    ],
)
def test_a_located_train_may_report_exact_positions(
    places_m: tuple[float, float, float, float, float],
) -> None:
    assert placed(*places_m) == ""


@pytest.mark.parametrize(
    "places_m",
    [
        (math.nextafter(5.0, 6.0), 5.0, 6.0, 7.0, 6.0),
        (4.0, math.nextafter(6.0, 7.0), 6.0, 7.0, 5.0),
        (4.0, 5.0, math.nextafter(7.0, 8.0), 7.0, 5.0),
        (9.0, 8.0, 7.0, 6.0, 7.0),
    ],
)
def test_a_located_train_with_positions_out_of_order_is_invalid(
    places_m: tuple[float, float, float, float, float],
) -> None:
    rear_m, low_m, high_m, latent_m, _ = places_m

    assert placed(*places_m) == (
        f"rear_min_m {rear_m}, front_min_m {low_m}, front_max_m {high_m} and "
        f"latent_m {latent_m} are not in this order"
    )


@pytest.mark.parametrize(
    "protected_m", [math.nextafter(4.0, 3.0), 3.0, math.nextafter(6.0, 7.0), 7.0]
)
def test_the_stopping_place_lies_between_rear_and_front(protected_m: float) -> None:
    words = f"protected_m {protected_m} is not between rear_min_m 4.0 and front_max_m 6.0"

    assert placed(4.0, 5.0, 6.0, 9.0, protected_m) == words


def test_positions_of_a_train_that_is_not_located_need_no_order() -> None:
    void = dataclasses.replace(UNPLACED, rear_min_m=9.0, front_min_m=8.0, front_max_m=7.0)

    assert problem_of_t2t(void) == ""
    assert unpack(pack(void)) == void


def test_positions_of_a_train_that_is_not_located_must_still_be_finite() -> None:
    assert problem_with(UNPLACED, "latent_m", math.nan).startswith("latent_m nan is not in ")


@pytest.mark.parametrize(
    ("rear_m", "end_m", "words"),
    [
        (800.5, 800.5, ""),
        (-LINE_END_M, -LINE_END_M, ""),
        (LINE_END_M, LINE_END_M, ""),
        (-3.0, 800.5, ""),
        (math.nextafter(800.5, 801.0), 800.5, "rear_m 800.5000000000001 is beyond end_m 800.5"),
        (1.0, -1.0, "rear_m 1.0 is beyond end_m -1.0"),
    ],
)
def test_an_authority_protects_up_to_its_end_at_most(
    rear_m: float, end_m: float, words: str
) -> None:
    authority = dataclasses.replace(AUTHORITY, rear_m=rear_m, end_m=end_m)

    assert problem_of_t2t(authority) == words


# Sender and receiver.


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (dataclasses.replace(AUTHORITY, term=-1), "term -1"),
        (dataclasses.replace(AUTHORITY, rear_m=801.5), "rear_m 801.5 is beyond end_m 800.5"),
        (dataclasses.replace(REPORT, axles=1001), "axles 1001"),
        (dataclasses.replace(REPORT, latent_m=102.0), "rear_min_m 20.5, .* not in this order"),
    ],
)
def test_an_invalid_message_is_not_sent_and_named(message: T2tMessage, words: str) -> None:
    with pytest.raises(ValueError, match=f"^{type(message).__name__}: {words}"):
        pack(message)


@pytest.mark.parametrize(
    ("number", "body"),
    [
        (18, [256, 7, 2, 2, 4, 3, []]),
        (18, [1, 2**48, 2, 2, 4, 3, []]),
        (18, [1, 7, -1, 2, 4, 3, []]),
        (18, [1, 7, 2, 2, 65_536, 3, []]),
        (18, [1, 7, 2, 2, 4, 3, [[65_536, 17, b"x"]]]),
        (18, [1, 7, 2, 2, 4, 3, [[9, 17, bytes(65)]]]),
        (20, [1, 7, 2, 5, 2**63, 800.5, 15.5, 3, 6, []]),
        (20, [1, 7, 2, 5, 4900, 800.5, 800.6, 3, 6, []]),
        (20, [1, 7, 2, 5, 4900, 800.5, 15.5, 3, 6, [[1.0, 2.0, 0.0]]]),
        (20, [1, 7, 2, 5, 4900, 800.5, 15.5, 3, 6, 9 * [[1.0, 2.0, 5.0]]]),
        (23, [1, 7, 2, 3, [[9, math.inf, True, 0, False]]]),
        (23, [1, 7, 2, 3, 129 * [[9, 1.0, True, 0, False]]]),
        (31, [1, 7, 2, 4900, 10, 3, 10.5, 20.5, 200.5]),
    ],
)
def test_an_envelope_with_a_correct_code_and_an_invalid_body_is_refused(
    number: int, body: list[object]
) -> None:
    assert reason(number, body) is RefusedReason.INVALID_VALUE


@pytest.mark.parametrize(
    ("number", "body"),
    [
        (18, [1, 7, 2, 0, 4, 3, []]),
        (18, [1, 7, 2, 3, 4, 3, []]),
        (16, [1, 7, 2, 4, 5, 11, 12]),
        (32, [1, 7, 2, 5, 98, 8, [], [], [], [], []]),
        (32, [1, 7, 2, 5, 98, 7, [], [[1, 3, 7, 9, 5, 4000]], [], [], []]),
    ],
)
def test_an_undefined_enumeration_value_is_refused(number: int, body: list[object]) -> None:
    assert reason(number, body) is RefusedReason.WRONG_FIELDS


WIDE_HEAD = (65_099, 65_535, 255, MAX_TERM, MAX_NUMBER, MAX_NUMBER, MAX_STAMP_NS)
WIDE_ENTRY = RosterEntry(64_999, 123_456.789, True, MAX_NUMBER, True)
WIDE_GRANT = SignedGrant(65_099, MAX_STAMP_NS, bytes(64))
EIGHT = 8 * (SpeedRestriction(-123_456.789, 123_456.789, 12.3),)


@pytest.mark.parametrize(
    "message",
    [
        LeaseAnswer(
            *(*WIDE_HEAD, True, MAX_NUMBER, MAX_STAMP_NS, 64_999, MAX_STAMP_NS),
            *(MAX_TERM, MAX_NUMBER, 128 * (WIDE_ENTRY,), (WIDE_GRANT,)),
        ),
        RosterCommit(*WIDE_HEAD, MAX_NUMBER, 128 * (WIDE_ENTRY,)),
        StandbySync(
            *(*WIDE_HEAD, MAX_NUMBER),
            128 * (SyncEntry(64_999, -123_456.789, 123_456.789, MAX_NUMBER),),
        ),
        TrackStatus(
            *(*WIDE_HEAD, MAX_STAMP_NS, 256 * (SectionState(MAX_NUMBER, True, 1000),)),
            *(EIGHT, EIGHT),
        ),
        LineState(
            *(*WIDE_HEAD, MAX_NUMBER, MAX_NUMBER, DecreeAnswer.NOT_STORED),
            128 * (TrainDecree(64_999, True, True, True, MAX_NUMBER),),
            56 * (LeaseNote(255, 64_999, MAX_TERM, 64_999, LeaseReason.AGAIN, MAX_STAMP_NS),),
            *(EIGHT, EIGHT, 64 * (RosterPlace(255, 64_999),)),
        ),
    ],
    ids=lambda message: type(message).__name__,
)
def test_the_largest_message_fits_the_length_limit(
    message: T2tMessage,
) -> None:
    assert repr(unpack(pack(message))) == repr(message)
