"""A message body is accepted only with all its fields, each of its documented type."""

import dataclasses
from collections.abc import Callable
from typing import Any

import msgspec
import pytest

from zenoh_config import bodies

REPORT: list[object] = [3, -20.5, -19.0, -89.1, 12.25, False, 7]
AUTHORITY: list[object] = [3, 2, 123, 1450.0, 900.0, 7]
STATUS: list[object] = [
    *(3, 4, 1, 2, True, False, -19.5, True, False, True, False, True, False, True, 5),
]
ORDERS: list[object] = [
    3, 123, True, False, True, False, True, 2, False, True, False, True, False,
    [[100.0, 250.5, 8.25], [0.0, 1.0, 2.0]], 4,
]  # fmt: skip
WHOLE, MEASURE, FLAG, STRETCHES = "whole number", "measure", "flag", "stretches"


@dataclasses.dataclass(frozen=True)
class Kind:
    """A decoder, a good body for it, and the documented type of each field in order."""

    decode: Callable[[bytes], Any]
    good: list[object]
    types: list[str]


KINDS = {
    "report": Kind(bodies.REPORT_BODY.decode, REPORT, [WHOLE, *4 * [MEASURE], FLAG, WHOLE]),
    "authority": Kind(
        bodies.AUTHORITY_BODY.decode, AUTHORITY, [*3 * [WHOLE], *2 * [MEASURE], WHOLE]
    ),
    "status": Kind(
        bodies.STATUS_BODY.decode, STATUS, [*4 * [WHOLE], FLAG, FLAG, MEASURE, *7 * [FLAG], WHOLE]
    ),
    "orders": Kind(
        bodies.ORDERS_BODY.decode,
        ORDERS,
        [WHOLE, WHOLE, *5 * [FLAG], WHOLE, *5 * [FLAG], STRETCHES, WHOLE],
    ),
}
WRONG: dict[str, list[object]] = {
    WHOLE: [True, 3.0, 3.5, "3", b"3", None, [3], {}],
    MEASURE: [True, "3", b"3", [3.0], {}],
    FLAG: [0, 1, 1.0, "true", None, [], {}],
    STRETCHES: [
        *(None, 0, True, {}, [1.0, 2.0, 3.0], [[1.0, 2.0]], [[1.0, 2.0, 3.0, 4.0]], [[]]),
        *([["1", 2.0, 3.0]], [[1.0, None, 3.0]], [[1.0, 2.0, True]], [{"start_m": 1.0}]),
    ],
}
FIELDS = [(name, at) for name, kind in KINDS.items() for at in range(len(kind.good))]
kinds = pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)


def encoded(value: object) -> bytes:
    return msgspec.msgpack.encode(value)


def values_of(body: Any) -> list[object]:
    """The field values in the order of the body, for any result type of the decoder."""
    return list(body) if isinstance(body, tuple) else list(msgspec.structs.astuple(body))


@kinds
def test_every_value_is_decoded_into_its_own_field(kind: Kind) -> None:
    read = values_of(kind.decode(encoded(kind.good)))

    assert encoded(read) == encoded(kind.good)
    assert [type(value) for value in read] == [type(value) for value in kind.good]


def test_status_and_orders_decode_their_fields_in_the_documented_order() -> None:
    status = bodies.STATUS_BODY.decode(encoded(STATUS))
    orders = bodies.ORDERS_BODY.decode(encoded(ORDERS))

    assert (status.boot, status.mode, status.supervision, status.cause) == (3, 4, 1, 2)
    assert (status.localised, status.standstill, status.front_m) == (True, False, -19.5)
    assert (status.doors_locked, status.open_left, status.open_right) == (True, False, True)
    assert (status.passenger_alarm, status.fire) == (False, True)
    assert (status.obstacle, status.alarm_raised) == (False, True)
    assert (orders.boot, orders.echo_stamp_ns, orders.releases) == (3, 123, 2)
    assert (orders.awake, orders.hold, orders.skip_next) == (True, False, True)
    assert (orders.stop_next, orders.emergency) == (False, True)
    assert (orders.creep, orders.restricted) == (False, True)
    assert (orders.doors_left, orders.doors_right) == (False, True)
    assert orders.platform_doors_locked is False
    assert (status.emergency_number, orders.released_emergency) == (5, 4)
    assert orders.restrictions == [(100.0, 250.5, 8.25), (0.0, 1.0, 2.0)]


@kinds
def test_a_missing_or_extra_field_is_refused(kind: Kind) -> None:
    for body in ([], kind.good[:-1], kind.good[1:], [*kind.good, False], [*kind.good, 0]):
        with pytest.raises(msgspec.MsgspecError):
            kind.decode(encoded(body))


@pytest.mark.parametrize(("name", "at"), FIELDS)
def test_a_value_of_the_wrong_type_is_refused_in_any_field(name: str, at: int) -> None:
    kind = KINDS[name]

    for wrong in WRONG[kind.types[at]]:
        with pytest.raises(msgspec.MsgspecError):
            kind.decode(encoded([*kind.good[:at], wrong, *kind.good[at + 1 :]]))


@pytest.mark.parametrize(
    ("name", "at"),
    [(name, at) for name, at in FIELDS if KINDS[name].types[at] == MEASURE],
)
def test_a_measure_may_be_an_integer(name: str, at: int) -> None:
    kind = KINDS[name]

    read = values_of(kind.decode(encoded([*kind.good[:at], 12, *kind.good[at + 1 :]])))

    assert read[at] == 12.0
    assert type(read[at]) is float


def test_only_the_protected_rear_may_be_null() -> None:
    absent = []
    for name, at in FIELDS:
        kind = KINDS[name]
        try:
            kind.decode(encoded([*kind.good[:at], None, *kind.good[at + 1 :]]))
        except msgspec.MsgspecError:
            continue
        absent.append((name, at))

    assert absent == [("authority", 4)]


@kinds
def test_a_map_instead_of_an_array_is_refused(kind: Kind) -> None:
    for body in ({}, {"boot": 3}, dict(enumerate(kind.good)), None, 3, "boot"):
        with pytest.raises(msgspec.MsgspecError):
            kind.decode(encoded(body))


@kinds
def test_bytes_behind_a_body_are_refused(kind: Kind) -> None:
    with pytest.raises(msgspec.MsgspecError):
        kind.decode(encoded(kind.good) + b"\x00")
