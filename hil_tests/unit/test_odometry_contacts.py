"""Which readings of a tag may be second ones: until the train has left it for certain."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vobc.config import load_config
from vobc.odometry.contacts import ANY_TAG, Contacts, Way

REACH_M, BOUND_M = 0.5, 0.06
LEAVE_M = 1.12
"""Two readings of a passage are no further apart than twice reach and bound."""
CONFIG = replace(load_config("florence4").odometry, tag_reach_m=REACH_M, tag_bound_m=BOUND_M)
PULSE_M = 0.01
START = Way(0, 0.0, 0.0)


def gone(pulses: int, ground_m: float, blur_m: float = 0.0) -> Way:
    return Way(pulses, ground_m, blur_m)


def settled() -> Contacts:
    """A train that has left where it started."""
    contacts = Contacts(CONFIG)
    contacts.move(gone(1000, 10.0), PULSE_M)
    return contacts


def test_of_a_train_that_has_just_started_nobody_knows_what_it_read_before() -> None:
    contacts = Contacts(CONFIG)
    assert contacts.off_m(7) == REACH_M

    contacts.move(START, PULSE_M)
    assert contacts.off_m(7) == REACH_M
    contacts.move(gone(1000, 10.0), PULSE_M)
    assert contacts.off_m(7) == 0.0


def test_a_tag_is_read_at_its_centre_the_first_time_and_anywhere_within_reach_after() -> None:
    contacts = settled()
    assert contacts.off_m(7) == 0.0
    contacts.touch(7, gone(1000, 10.0))

    assert contacts.off_m(7) == REACH_M
    assert contacts.off_m(8) == 0.0, "another tag is none the worse"


def test_missing_telegrams_may_be_those_of_any_tag() -> None:
    contacts = settled()
    contacts.touch(ANY_TAG, gone(1000, 10.0))

    assert contacts.off_m(7) == contacts.off_m(8) == REACH_M


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    ("pulses", "ground_m", "blur_m", "off_m"),
    [
        (112, 5.0, 0.0, REACH_M),
        (113, 5.0, 0.0, REACH_M),  # 1.12 m at the least, for a pulse may be almost over.
        (114, 5.0, 0.0, 0.0),
        (500, 1.12, 0.0, REACH_M),
        (500, 1.13, 0.0, 0.0),
        (500, 1.63, 0.52, REACH_M),
        (500, 1.63, 0.5, 0.0),
        (500, 0.0, 0.0, REACH_M),  # Wheels that spin on the spot.
        (0, 5.0, 0.0, REACH_M),  # A radar that is wrong, and a train that stands.
    ],
)
def test_a_tag_is_left_once_wheels_and_ground_both_say_so(
    sign: int, pulses: int, ground_m: float, blur_m: float, off_m: float
) -> None:
    contacts = settled()
    contacts.touch(7, gone(1000, 0.0, 3.0))
    contacts.move(gone(1000 + sign * pulses, sign * ground_m, 3.0 + blur_m), PULSE_M)

    assert contacts.off_m(7) == off_m


def test_a_train_that_comes_back_to_a_tag_that_it_had_left_reads_its_centre() -> None:
    contacts = settled()
    contacts.touch(7, gone(1000, 10.0))
    contacts.move(gone(1300, 13.0), PULSE_M)
    contacts.move(gone(1000, 10.0), PULSE_M)

    assert contacts.off_m(7) == 0.0


def test_what_was_touched_is_forgotten_one_by_one() -> None:
    contacts = settled()
    contacts.touch(7, gone(1000, 10.0))
    contacts.touch(8, gone(1100, 11.0))
    contacts.move(gone(1150, 11.5), PULSE_M)

    assert (contacts.off_m(7), contacts.off_m(8)) == (0.0, REACH_M)


def test_a_reading_counts_from_its_latest() -> None:
    contacts = settled()
    contacts.touch(7, gone(1000, 10.0))
    contacts.touch(7, gone(1050, 10.5))
    contacts.move(gone(1150, 11.5), PULSE_M)

    assert contacts.off_m(7) == REACH_M


@given(
    st.floats(-20.0, 20.0), st.floats(-0.5, 0.5), st.lists(st.floats(-0.3, 0.3), max_size=60),
    st.floats(-0.01, 0.05), st.booleans(),
)  # fmt: skip
def test_however_the_train_turns_no_second_reading_within_reach_is_taken_for_the_first(
    tag_m: float, first_off_m: float, moves_m: list[float], error_ratio: float, heard: bool
) -> None:
    """It is read or, unheard, passed at some place within reach; then it moves on and about."""
    contacts, at_m = settled(), tag_m + first_off_m

    def way() -> Way:
        return gone(round(at_m * (1.0 + error_ratio) / PULSE_M), at_m)

    contacts.touch(7 if heard else ANY_TAG, way())
    stayed = True
    for move_m in moves_m:
        at_m += move_m
        contacts.move(way(), PULSE_M / 1.05)
        stayed = stayed and abs(at_m - tag_m) <= REACH_M + BOUND_M
        if stayed:
            assert contacts.off_m(7) == REACH_M
