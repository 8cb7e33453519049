"""Each field of the messages of train, wayside and centre is valid up to its limits and not
beyond."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zenoh_config.messages import (
    Message,
    MovementAuthority,
    PositionReport,
    SpeedRestriction,
    TrainOrders,
    TrainStatus,
)
from zenoh_config.soundness import problem_of

MAX_NUMBER = 4_294_967_295
MAX_STAMP_NS = 9_223_372_036_854_775_807
LINE_END_M = 1_000_000.0
JUST_OFF_LINE_M = math.nextafter(LINE_END_M, math.inf)
TOO_FAST_MPS = math.nextafter(200.0, math.inf)
REPORT = PositionReport(7, 3, 1000, 5_000_000, 10.0, 20.0, -50.0, 12.25, False)
AUTHORITY = MovementAuthority(7, 3, 2, 500, 5_000_000, 1450.0, 0, 99)
STATUS = TrainStatus(
    7, 3, 41, 5_000_000, 4, 1, 0, True, False, -19.5, True, False, True, False, False, True, False
)
ORDERS = TrainOrders(
    7, 3, 77, 5_000_000, True, False, True, False, False, 2, False, False, True, False, True
)
MESSAGES = pytest.mark.parametrize(
    "message", [REPORT, AUTHORITY, STATUS, ORDERS], ids=lambda message: type(message).__name__
)
WHOLE_NUMBERS = [
    *((message, "train", 1, 65_535) for message in (REPORT, AUTHORITY, STATUS, ORDERS)),
    *((message, "destination", 0, 65_535) for message in (REPORT, STATUS)),
    *((message, "source", 0, 65_535) for message in (AUTHORITY, ORDERS)),
    *((message, "boot", 0, MAX_NUMBER) for message in (REPORT, AUTHORITY, STATUS, ORDERS)),
    *((message, "sequence", 0, MAX_NUMBER) for message in (REPORT, AUTHORITY, STATUS, ORDERS)),
    *((message, "stamp_ns", 0, MAX_STAMP_NS) for message in (REPORT, AUTHORITY, STATUS, ORDERS)),
    (AUTHORITY, "term", 0, MAX_NUMBER),
    (AUTHORITY, "echo_stamp_ns", 0, MAX_STAMP_NS),
    (ORDERS, "echo_stamp_ns", 0, MAX_STAMP_NS),
    (ORDERS, "releases", 0, MAX_NUMBER),
    *((STATUS, code, 0, 255) for code in ("mode", "supervision", "cause")),
]
MEASURES = [
    (REPORT, "speed_mps", 200.0),
    (AUTHORITY, "end_m", LINE_END_M),
    (STATUS, "front_m", LINE_END_M),
]


def with_field(message: Message, name: str, value: float) -> Message:
    return replace(message, **{name: value})  # type: ignore[arg-type]


def restricted(start_m: float, end_m: float, limit_mps: float) -> str:
    """The problem of orders with this restriction behind a valid one."""
    good = SpeedRestriction(0.0, 1.0, 5.0)
    bad = SpeedRestriction(start_m, end_m, limit_mps)
    return problem_of(replace(ORDERS, restrictions=(good, bad)))


@MESSAGES
def test_a_valid_message_has_no_problem(message: Message) -> None:
    assert problem_of(message) == ""


@pytest.mark.parametrize(("message", "name", "least", "most"), WHOLE_NUMBERS)
def test_an_integer_is_valid_from_its_minimum_to_its_maximum(
    message: Message, name: str, least: int, most: int
) -> None:
    for value in (least, least + 1, most - 1, most):
        assert problem_of(with_field(message, name, value)) == ""


@pytest.mark.parametrize(("message", "name", "least", "most"), WHOLE_NUMBERS)
def test_an_integer_out_of_range_is_named_with_the_range(
    message: Message, name: str, least: int, most: int
) -> None:
    for value in (-most, least - 1, most + 1, 2 * most + 2):
        words = f"{name} {value} is not in {least}..{most}"
        assert problem_of(with_field(message, name, value)) == words


@pytest.mark.parametrize(("message", "name", "most"), MEASURES)
def test_a_measure_is_valid_in_both_directions_up_to_its_limit(
    message: Message, name: str, most: float
) -> None:
    for value in (-most, 0.0, most):
        assert problem_of(with_field(message, name, value)) == ""


@pytest.mark.parametrize(("message", "name", "most"), MEASURES)
def test_a_measure_just_beyond_its_limit_or_nan_is_named(
    message: Message, name: str, most: float
) -> None:
    beyond = math.nextafter(most, math.inf)

    for value in (-math.inf, -beyond, beyond, math.inf, math.nan):
        assert problem_of(with_field(message, name, value)).startswith(f"{name} {value} is ")


@pytest.mark.parametrize(
    ("rear_m", "low_m", "high_m"),
    [
        (5.0, 5.0, 5.0),
        (5.0, 5.0, 6.0),
        (5.0, 6.0, 6.0),
        (-LINE_END_M, 0.0, 1.0),
        (-1.0, 0.0, LINE_END_M),
        (-LINE_END_M, -LINE_END_M, -LINE_END_M),
        (LINE_END_M, LINE_END_M, LINE_END_M),
    ],
)
def test_a_report_may_have_exact_positions_and_lie_at_either_end_of_the_line(
    rear_m: float, low_m: float, high_m: float
) -> None:
    report = replace(REPORT, rear_min_m=rear_m, front_min_m=low_m, front_max_m=high_m)

    assert problem_of(report) == ""


@pytest.mark.parametrize(
    ("rear_m", "low_m", "high_m", "words"),
    [
        (math.nextafter(5.0, 6.0), 5.0, 6.0, "not in this order"),
        (5.0, math.nextafter(6.0, 7.0), 6.0, "not in this order"),
        (math.nan, 5.0, 6.0, "not in this order"),
        (5.0, math.nan, 6.0, "not in this order"),
        (5.0, 6.0, math.nan, "not in this order"),
        (-JUST_OFF_LINE_M, 5.0, 6.0, "off every line"),
        (5.0, 6.0, JUST_OFF_LINE_M, "off every line"),
        (-JUST_OFF_LINE_M, 0.0, JUST_OFF_LINE_M, "off every line"),
        (-math.inf, 5.0, 6.0, "off every line"),
        (5.0, 6.0, math.inf, "off every line"),
    ],
)
def test_a_report_with_contradicting_positions_is_invalid(
    rear_m: float, low_m: float, high_m: float, words: str
) -> None:
    report = replace(REPORT, rear_min_m=rear_m, front_min_m=low_m, front_max_m=high_m)

    assert words in problem_of(report)


@pytest.mark.parametrize("rear_m", [None, -LINE_END_M, 0.0, 1450.0])
def test_an_authority_may_protect_any_track_up_to_its_end(
    rear_m: float | None,
) -> None:
    assert problem_of(replace(AUTHORITY, rear_m=rear_m)) == ""


@pytest.mark.parametrize(
    "rear_m",
    [-JUST_OFF_LINE_M, math.nextafter(1450.0, 1451.0), math.nan, math.inf, -math.inf],
)
def test_an_authority_may_not_protect_track_off_the_line_or_beyond_its_end(rear_m: float) -> None:
    words = f"rear_m {rear_m} is off every line or beyond end_m 1450.0"

    assert problem_of(replace(AUTHORITY, rear_m=rear_m)) == words


@pytest.mark.parametrize(
    ("start_m", "end_m", "limit_mps"),
    [
        (-LINE_END_M, LINE_END_M, 5.0),
        (3.0, 3.0, 5.0),
        (LINE_END_M, LINE_END_M, 200.0),
        (-LINE_END_M, -LINE_END_M, math.nextafter(0.0, 1.0)),
    ],
)
def test_a_restriction_may_cover_one_point_or_the_whole_line_at_any_positive_speed(
    start_m: float, end_m: float, limit_mps: float
) -> None:
    assert restricted(start_m, end_m, limit_mps) == ""


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
def test_a_restriction_with_reversed_ends_is_invalid(start_m: float, end_m: float) -> None:
    words = f"restriction from {start_m} m to {end_m} m is no stretch of a line"

    assert restricted(start_m, end_m, 5.0) == words


@pytest.mark.parametrize("limit_mps", [0.0, -1.0, TOO_FAST_MPS, math.inf, math.nan])
def test_a_restriction_to_zero_or_an_absurd_speed_is_invalid(limit_mps: float) -> None:
    words = f"restriction to {limit_mps} m/s is not in 0..200.0"

    assert restricted(0.0, 1.0, limit_mps) == words


def test_eight_restrictions_fit_and_nine_do_not() -> None:
    one = (SpeedRestriction(0.0, 1.0, 5.0),)

    assert problem_of(replace(ORDERS, restrictions=8 * one)) == ""
    assert problem_of(replace(ORDERS, restrictions=9 * one)) == "9 restrictions, at most 8 fit"


@given(st.tuples(*3 * [st.floats()]))
def test_only_finite_ordered_positions_make_a_valid_report(
    places_m: tuple[float, float, float],
) -> None:
    rear_m, low_m, high_m = places_m
    report = replace(REPORT, rear_min_m=rear_m, front_min_m=low_m, front_max_m=high_m)
    sound = (
        all(abs(place_m) <= 1e6 for place_m in places_m)
        and sorted(places_m) == list(places_m)
        and not any(math.isnan(place_m) for place_m in places_m)
    )

    assert (problem_of(report) == "") is sound
