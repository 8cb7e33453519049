"""Lengths, keys and types of envelopes at their edges, and how gates count and say what they do."""

import hmac
import struct
from dataclasses import replace

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zenoh_config.codec import BENCH_KEY, pack, safety_key, unpack
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
HEADER_BYTES, CODE_BYTES = 20, 16
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


def headed(body: bytes, *, version: int = 2, kind: int = 2) -> bytes:
    return with_code(struct.pack(">BBHHIQ", version, kind, 0, 7, 5, 6) + body)


def refused(payload: bytes) -> Refused:
    result = unpack(payload)
    assert isinstance(result, Refused)
    return result


def check(answer: MovementAuthority | TrainOrders, now_ns: int = NOW_NS) -> Refused | None:
    """By a gate of train 7 in its life 3 that has heard nothing and takes a second from three."""
    if isinstance(answer, MovementAuthority):
        gate = AuthorityGate(train=7, boot=3, max_age_ns=1000 * MS, sources=(0, 9, 12))
        return gate.check(answer, now_ns)
    orders_gate = OrdersGate(train=7, boot=3, max_age_ns=1000 * MS, sources=(0, 9, 12))
    return orders_gate.check(answer, now_ns)


# Lengths.


@pytest.mark.parametrize("length", range(HEADER_BYTES + 1))
def test_what_holds_no_more_than_a_header_is_too_short_even_under_a_right_code(
    length: int,
) -> None:
    header = struct.pack(">BBHHIQ", 2, 2, 0, 7, 5, 6) + b"\x00\x00"
    payload = with_code(header[:length][: len(header) - 2])

    assert refused(payload) == Refused(RefusedReason.TOO_SHORT, f"{len(payload)} bytes")


@pytest.mark.parametrize("length", range(CODE_BYTES))
def test_what_is_shorter_than_a_code_is_too_short(length: int) -> None:
    assert refused(bytes(length)) == Refused(RefusedReason.TOO_SHORT, f"{length} bytes")
