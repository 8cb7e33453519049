"""Track detection: every axle in its section, and every object under a train."""

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.ports import RadioMessage
from firmware_py.trackdb.areas import Area, AreaMap, ObjectKind, ObjectSite, TrackSection
from plant_emulator.wayside.detection import Detection, Place, key_of, packed, subscription
from zenoh_config.keys import matches

LINE = AreaMap(
    "Line 9",
    (Area(1, 0.0, 400.0),),
    (
        TrackSection(1, 0.0, 100.0),
        TrackSection(2, 100.0, 200.0),
        TrackSection(3, 200.0, 300.0),
        TrackSection(4, 300.0, 400.0),
    ),
    (
        ObjectSite(5, ObjectKind.SWITCH, 100.0, 120.0),
        ObjectSite(6, ObjectKind.CROSSING, 210.0, 220.0),
    ),
)


def encoded_position(train: int, rear_m: float, front_m: float, *, axles: int = 16) -> RadioMessage:
    return RadioMessage(0, key_of("Line 9", train), packed(Place(front_m, rear_m, axles)))


def detection(*messages: RadioMessage) -> Detection:
    detecting = Detection(LINE)
    assert detecting.on_message(messages) == []
    return detecting


def axles(rear_m: float, front_m: float, count: int) -> dict[int, int]:
    return detection(encoded_position(1, rear_m, front_m, axles=count)).axles()


def test_a_position_message_holds_front_rear_axles_and_instant_in_network_order() -> None:
    place = Place(90.5, 10.25, 16, 77)
    assert packed(place) == struct.pack(">ddHQ", 90.5, 10.25, 16, 77)
    assert packed(Place(90.5, 10.25, 16)) == struct.pack(">ddHQ", 90.5, 10.25, 16, 0)
    assert key_of("Line 9", 7) == "m/line-9/x/7"
    assert matches(subscription("Line 9"), key_of("Line 9", 7))


@pytest.mark.parametrize(
    ("rear_m", "front_m", "counted"),
    [
        # The first axle is 2 m behind the front coupler; a joint belongs to the section that begins
        # there.
        (50.0, 102.0, {1: 1, 2: 1}),
        (50.0, 101.9, {1: 2}),
        (50.0, 102.1, {1: 1, 2: 1}),
        # The last axle is 2 m before the rear coupler.
        (98.0, 150.0, {2: 2}),
        (97.9, 150.0, {1: 1, 2: 1}),
        (198.0, 302.0, {3: 1, 4: 1}),
        (197.9, 301.9, {2: 1, 3: 1}),
        # No counter covers the track beyond the last joint.
        (350.0, 402.0, {4: 1}),
        (350.0, 401.9, {4: 2}),
        (-2.0, 30.0, {1: 2}),
        (-2.1, 30.0, {1: 1}),
    ],
)
def test_the_outer_axles_are_2_m_from_the_couplers(
    rear_m: float, front_m: float, counted: dict[int, int]
) -> None:
    assert axles(rear_m, front_m, 2) == counted


@pytest.mark.parametrize(
    ("count", "counted"),
    [
        (0, {}),
        (1, {4: 1}),
        (2, {1: 1, 4: 1}),
        (3, {1: 1, 3: 1, 4: 1}),
        (4, {1: 1, 2: 1, 3: 1, 4: 1}),
        (5, {1: 1, 2: 1, 3: 2, 4: 1}),
        (10, {1: 2, 2: 3, 3: 2, 4: 3}),
    ],
)
def test_axles_stand_evenly_over_a_train(count: int, counted: dict[int, int]) -> None:
    """The axles are spread from 20 m to 380 m; a single axle is at the front."""
    assert axles(18.0, 382.0, count) == counted


def test_axles_of_several_trains_in_a_section_are_summed() -> None:
    counted = detection(
        encoded_position(1, 10.0, 40.0, axles=3), encoded_position(2, 50.0, 95.0, axles=4)
    ).axles()

    assert counted == {1: 7}


@given(
    rear_m=st.floats(0.0, 299.0),
    long_m=st.floats(5.0, 100.0),
    count=st.integers(2, 40),
)
def test_no_axle_of_a_train_on_the_line_is_lost_or_counted_twice(
    rear_m: float, long_m: float, count: int
) -> None:
    counted = axles(rear_m, rear_m + long_m, count)

    assert sum(counted.values()) == count
    for number in counted:
        section = LINE.sections[number - 1]
        assert rear_m < section.end_m
        assert section.start_m < rear_m + long_m


def test_a_train_off_the_line_has_no_axle_on_it() -> None:
    assert axles(500.0, 600.0, 8) == {}


@pytest.mark.parametrize(
    ("rear_m", "front_m", "there"),
    [
        (50.0, 100.0, set()),
        (50.0, 100.1, {5}),
        (119.9, 150.0, {5}),
        (120.0, 150.0, set()),
        (105.0, 110.0, {5}),
        (50.0, 150.0, {5}),
        (119.0, 211.0, {5, 6}),
        (120.0, 210.0, set()),
        (300.0, 380.0, set()),
    ],
)
def test_an_object_is_occupied_by_any_part_of_a_train_between_its_ends(
    rear_m: float, front_m: float, there: set[int]
) -> None:
    assert detection(encoded_position(1, rear_m, front_m)).occupied() == there


def test_objects_under_different_trains_are_all_occupied() -> None:
    assert detection(
        encoded_position(1, 90.0, 110.0), encoded_position(2, 215.0, 240.0)
    ).occupied() == {5, 6}


def test_the_newest_place_of_a_train_counts() -> None:
    moved = detection(
        encoded_position(1, 10.0, 40.0, axles=3), encoded_position(1, 110.0, 140.0, axles=3)
    )

    assert moved.places == {"m/line-9/x/1": Place(140.0, 110.0, 3)}
    assert moved.axles() == {2: 3}


@given(
    st.lists(
        st.tuples(st.integers(1, 3), st.floats(-50.0, 450.0), st.floats(5.0, 100.0)), max_size=12
    )
)
def test_only_the_present_positions_of_trains_count(
    moves: list[tuple[int, float, float]],
) -> None:
    detecting = detection()
    newest: dict[int, RadioMessage] = {}
    for train, rear_m, long_m in moves:
        newest[train] = encoded_position(train, rear_m, rear_m + long_m)
        detecting.on_message([newest[train]])

        assert detecting.axles() == detection(*newest.values()).axles()


def test_a_train_that_repeats_its_position_is_counted_once() -> None:
    detecting = detection(encoded_position(1, 10.0, 40.0, axles=3))
    again = Place(40.0, 10.0, 3, 50)
    detecting.on_message([RadioMessage(0, key_of("Line 9", 1), packed(again))])

    assert detecting.axles() == {1: 3}
    assert detecting.places == {"m/line-9/x/1": again}


def test_a_line_without_axle_counters_counts_no_axles() -> None:
    detecting = Detection(AreaMap("Line 9", (Area(1, 0.0, 400.0),)))
    detecting.on_message([encoded_position(1, 10.0, 40.0)])

    assert detecting.axles() == {}


@pytest.mark.parametrize(
    ("rear_m", "front_m"),
    [
        (10.0, 10.0),
        (10.1, 10.0),
        (10.0, math.inf),
        (10.0, -math.inf),
        (-math.inf, 40.0),
        (10.0, math.nan),
        (math.nan, 10.0),
    ],
)
def test_an_impossible_stretch_does_not_count_as_a_position(rear_m: float, front_m: float) -> None:
    assert detection(encoded_position(1, rear_m, front_m)).places == {}


@pytest.mark.parametrize("payload", [b"", bytes(18), bytes(25), bytes(27)])
def test_a_message_of_a_wrong_length_is_consumed_and_ignored(payload: bytes) -> None:
    assert detection(RadioMessage(0, "m/line-9/x/1", payload)).places == {}


def test_other_messages_are_returned_in_order() -> None:
    place = packed(Place(40.0, 10.0, 4))
    others = [
        RadioMessage(0, "m/line-9/w/1/hb/1/all", b"..."),
        RadioMessage(0, "m/line-8/x/1", place),
        RadioMessage(0, "m/line-9/w/2/hb/1/all", place),
    ]
    detecting = Detection(LINE)

    assert detecting.on_message([others[0], encoded_position(1, 10.0, 40.0), *others[1:]]) == others
    assert detecting.places == {"m/line-9/x/1": Place(40.0, 10.0, 16)}


def test_at_most_512_trains_are_tracked() -> None:
    flood = detection(*[encoded_position(n, 10.0, 40.0) for n in range(1, 600)])
    assert list(flood.places) == [f"m/line-9/x/{n}" for n in range(1, 513)]

    flood.on_message([encoded_position(7, 310.0, 340.0)])
    assert flood.places["m/line-9/x/7"] == Place(340.0, 310.0, 16)
