"""Which readings of a tag may be repeated ones, until the train has certainly left the tag."""

from dataclasses import replace
from math import inf, nextafter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.trackdb import TagSite
from vobc.config import load_config
from vobc.odometry.contacts import Contacts, Travelled

REACH_M, BOUND_M = 0.5, 0.06
"""Two readings of one passage are at most 1.12 m apart: twice the reach plus twice the bound."""
CONFIG = replace(load_config("florence4").odometry, tag_reach_m=REACH_M, tag_bound_m=BOUND_M)
PULSE_M = 0.01
LATER_S = 0.1
"""Time of a reading, after that of all movements, 0.0."""
FAR = 1_000_000
"""A pulse count far from every earlier reading."""
SEVEN, EIGHT = TagSite(7, 20.0), TagSite(8, 21.5)


def gone(pulses: int, ground_m: float, blur_m: float = 0.0) -> Travelled:
    return Travelled(pulses, ground_m, blur_m)


def settled() -> Contacts:
    """A tracker whose train has left its starting place and is before both tags."""
    contacts = Contacts(CONFIG)
    contacts.look(0.0)
    contacts.move(gone(1000, 10.0), PULSE_M, 0.0)
    contacts.look(10.0)
    return contacts


def test_a_restarted_train_may_have_read_any_tag_near_it_before() -> None:
    contacts = Contacts(CONFIG)
    assert contacts.off_m(SEVEN, FAR, PULSE_M, LATER_S) == REACH_M

    contacts.move(gone(0, 0.0), PULSE_M, 0.0)
    contacts.look(inf)
    assert contacts.off_m(SEVEN, FAR, PULSE_M, LATER_S) == REACH_M
    contacts.move(gone(1000, 10.0), PULSE_M, 0.0)
    assert contacts.off_m(SEVEN, FAR, PULSE_M, LATER_S) == 0.0


@pytest.mark.parametrize(
    ("way", "off_m"),
    [
        (gone(113, 5.0), REACH_M),
        (gone(114, 5.0), 0.0),
        (gone(-113, -5.0), REACH_M),
        (gone(500, 1.12), REACH_M),
        (gone(500, 1.13), 0.0),
        (gone(-500, -1.12), REACH_M),
        (gone(500, 1.63, 0.52), REACH_M),
        (gone(500, 1.63, 0.5), 0.0),
    ],
)
def test_the_starting_place_is_left_like_any_other_place(way: Travelled, off_m: float) -> None:
    contacts = Contacts(CONFIG)
    contacts.look(inf)
    contacts.move(way, PULSE_M, 0.0)

    assert contacts.off_m(SEVEN, FAR, PULSE_M, LATER_S) == off_m


def test_a_tag_that_is_ahead_at_the_start_was_not_read_before() -> None:
    contacts = Contacts(CONFIG)
    contacts.look(19.9)
    contacts.look(20.5)

    assert contacts.off_m(SEVEN, FAR, PULSE_M, LATER_S) == 0.0


def test_a_tag_is_read_at_its_centre_the_first_time_and_anywhere_within_reach_after() -> None:
    contacts = settled()
    assert contacts.off_m(SEVEN, FAR, PULSE_M, LATER_S) == 0.0
    contacts.read(7, gone(1000, 10.0), 0.1)

    assert contacts.off_m(SEVEN, FAR, PULSE_M, LATER_S) == REACH_M
    assert contacts.off_m(EIGHT, FAR, PULSE_M, LATER_S) == 0.0, "another tag is none the worse"


def test_telegrams_just_found_missing_may_belong_to_any_tag() -> None:
    contacts = settled()
    contacts.miss(gone(1000, 10.0))

    assert (
        contacts.off_m(SEVEN, FAR, PULSE_M, LATER_S)
        == contacts.off_m(EIGHT, FAR, PULSE_M, LATER_S)
        == REACH_M
    )


@pytest.mark.parametrize(
    ("ahead_m", "off_m"), [(19.9, 0.0), (19.93, 0.0), (19.94, REACH_M), (25.0, REACH_M)]
)
def test_a_tag_still_ahead_when_telegrams_were_found_missing_was_not_among_them(
    ahead_m: float, off_m: float
) -> None:
    """The train is at 20 m; where the reader detects it, the tag may lie 6 cm before that."""
    contacts = settled()
    contacts.miss(gone(1000, 10.0))
    contacts.look(ahead_m)
    contacts.look(20.5)

    assert contacts.off_m(SEVEN, FAR, PULSE_M, LATER_S) == off_m


def test_every_loss_of_telegrams_counts_separately() -> None:
    contacts = settled()
    contacts.miss(gone(1000, 10.0))
    contacts.look(15.0)
    assert contacts.off_m(SEVEN, FAR, PULSE_M, LATER_S) == 0.0

    contacts.miss(gone(1050, 10.5))
    contacts.look(20.5)
    assert (
        contacts.off_m(SEVEN, FAR, PULSE_M, LATER_S),
        contacts.off_m(EIGHT, FAR, PULSE_M, LATER_S),
    ) == (
        REACH_M,
        0.0,
    )


def test_rolling_back_does_not_undo_what_the_train_had_reached() -> None:
    contacts = settled()
    contacts.look(20.4)
    contacts.look(19.0)
    contacts.miss(gone(1000, 10.0))
    contacts.look(19.0)

    assert (
        contacts.off_m(SEVEN, FAR, PULSE_M, LATER_S),
        contacts.off_m(EIGHT, FAR, PULSE_M, LATER_S),
    ) == (
        REACH_M,
        0.0,
    )


def test_a_train_whose_place_is_lost_may_have_reached_any_tag() -> None:
    contacts = settled()
    contacts.look(inf)
    contacts.miss(gone(1000, 10.0))
    contacts.look(inf)
    contacts.look(12.0)

    assert (
        contacts.off_m(SEVEN, FAR, PULSE_M, LATER_S)
        == contacts.off_m(EIGHT, FAR, PULSE_M, LATER_S)
        == REACH_M
    )


def test_a_recovered_position_counts_like_any_other() -> None:
    contacts = settled()
    contacts.look(inf)
    contacts.look(12.0)
    contacts.miss(gone(1000, 10.0))
    contacts.look(12.1)

    assert contacts.off_m(SEVEN, FAR, PULSE_M, LATER_S) == 0.0


@pytest.mark.parametrize("missing", [True, False])
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    ("pulses", "ground_m", "blur_m", "off_m"),
    [
        (112, 5.0, 0.0, REACH_M),
        (113, 5.0, 0.0, REACH_M),  # At least 1.12 m, because a pulse may be almost complete.
        (114, 5.0, 0.0, 0.0),
        (500, 1.12, 0.0, REACH_M),
        (500, 1.13, 0.0, 0.0),
        (500, 1.63, 0.52, REACH_M),
        (500, 1.63, 0.5, 0.0),
        (500, 0.0, 0.0, REACH_M),  # The wheels spin on the spot.
        (0, 5.0, 0.0, REACH_M),  # The radar is wrong while the train stands.
    ],
)
def test_a_tag_is_left_once_wheels_and_ground_both_show_it(
    pulses: int, ground_m: float, blur_m: float, off_m: float, sign: int, *, missing: bool
) -> None:
    contacts = settled()
    there = gone(1000, 0.0, 3.0)
    if missing:
        contacts.miss(there)
    else:
        contacts.read(7, there, 0.1)
    contacts.move(gone(1000 + sign * pulses, sign * ground_m, 3.0 + blur_m), PULSE_M, 0.0)

    assert contacts.off_m(SEVEN, FAR, PULSE_M, LATER_S) == off_m


def test_two_distances_over_ground_differ_only_beyond_their_wider_bounds() -> None:
    contacts = settled()
    contacts.read(7, gone(2000, 20.0, 0.5), inf)

    contacts.move(gone(2130, 21.15, 0.4), PULSE_M, 0.0)

    assert contacts.off_m(SEVEN, FAR, PULSE_M, LATER_S) == REACH_M


@pytest.mark.parametrize(
    ("pulses", "off_m"), [(0, 0.11), (10, 0.21), (-10, 0.21), (38, 0.49), (39, 0.5), (-90, 0.5)]
)
def test_the_pulses_bound_the_offset_of_a_repeated_reading(pulses: int, off_m: float) -> None:
    """The first reading is within 10 cm and a pulse."""
    contacts = settled()
    contacts.read(7, gone(1000, 10.0), 0.1)

    assert contacts.off_m(SEVEN, 1000 + pulses, PULSE_M, LATER_S) == pytest.approx(off_m)
    assert contacts.off_m(SEVEN, 1000 + pulses, inf, LATER_S) == REACH_M, "bad wheels tell nothing"


def test_after_a_slip_the_pulses_no_longer_bound_the_offset() -> None:
    contacts = settled()
    contacts.read(7, gone(1000, 10.0), 0.1)
    contacts.doubt()
    assert contacts.off_m(SEVEN, 1000, PULSE_M, LATER_S) == REACH_M
    assert contacts.off_m(EIGHT, 1000, PULSE_M, LATER_S) == 0.0

    contacts.move(gone(2000, 20.0), PULSE_M, 0.0)
    assert contacts.off_m(SEVEN, 1000, PULSE_M, LATER_S) == 0.0, "but it is left all the same"


def test_the_pulses_bound_nothing_after_missing_telegrams() -> None:
    contacts = settled()
    contacts.read(7, gone(1000, 10.0), 0.1)
    contacts.miss(gone(1000, 10.0))

    assert contacts.off_m(SEVEN, 1000, PULSE_M, LATER_S) == REACH_M


def test_a_train_that_comes_back_to_a_tag_that_it_had_left_reads_its_centre() -> None:
    contacts = settled()
    contacts.read(7, gone(1000, 10.0), 0.1)
    contacts.move(gone(1300, 13.0), PULSE_M, 0.0)
    contacts.move(gone(1000, 10.0), PULSE_M, 0.0)

    assert contacts.off_m(SEVEN, FAR, PULSE_M, LATER_S) == 0.0


@pytest.mark.parametrize("missing", [True, False])
@pytest.mark.parametrize(
    ("read_s", "off_m"), [(4.9, REACH_M), (5.0, REACH_M), (nextafter(5.0, inf), 0.0)]
)
def test_a_telegram_may_arrive_after_the_train_has_left_the_tag(
    read_s: float, off_m: float, *, missing: bool
) -> None:
    """The train has certainly left the tag at 5 s, and the telegram arrives at 5.05 s."""
    contacts = settled()
    if missing:
        contacts.miss(gone(1000, 10.0))
    else:
        contacts.read(7, gone(1000, 10.0), 0.1)
    contacts.move(gone(1100, 11.0), PULSE_M, 4.95)
    contacts.move(gone(1150, 11.5), PULSE_M, 5.0)
    contacts.move(gone(1200, 12.0), PULSE_M, 5.05)

    assert contacts.off_m(SEVEN, FAR, PULSE_M, read_s) == off_m


@pytest.mark.parametrize(("late_s", "off_m"), [(0.0, REACH_M), (0.001, 0.0)])
def test_a_tag_is_forgotten_when_no_telegram_can_still_arrive(late_s: float, off_m: float) -> None:
    contacts = settled()
    contacts.read(7, gone(1000, 10.0), 0.1)
    contacts.move(gone(1150, 11.5), PULSE_M, 0.0)
    contacts.move(gone(2000, 20.0), PULSE_M, CONFIG.tag_silence_s + late_s)

    assert contacts.off_m(SEVEN, FAR, PULSE_M, -1.0) == off_m


def test_old_readings_are_dropped_one_by_one() -> None:
    contacts = settled()
    contacts.read(7, gone(1000, 10.0), 0.1)
    contacts.read(8, gone(1100, 11.0), 0.1)
    contacts.move(gone(1150, 11.5), PULSE_M, 0.0)

    assert (
        contacts.off_m(SEVEN, FAR, PULSE_M, LATER_S),
        contacts.off_m(EIGHT, FAR, PULSE_M, LATER_S),
    ) == (
        0.0,
        REACH_M,
    )


def test_a_tag_counts_from_its_latest_reading() -> None:
    contacts = settled()
    contacts.read(7, gone(1000, 10.0), 0.1)
    contacts.read(7, gone(1050, 10.5), 0.1)
    contacts.move(gone(1150, 11.5), PULSE_M, 0.0)

    assert contacts.off_m(SEVEN, FAR, PULSE_M, LATER_S) == REACH_M


@given(
    st.floats(-20.0, 20.0), st.floats(-0.06, 0.06), st.lists(st.floats(-0.3, 0.3), max_size=60),
    st.floats(-0.01, 0.05), st.floats(0.0, 0.5), st.one_of(st.none(), st.integers(0, 4)),
    st.floats(-3.0, 3.0),
)  # fmt: skip
def test_no_motion_makes_a_repeated_reading_count_as_the_first(
    tag_m: float,
    felt_off_m: float,
    moves_m: list[float],
    error_ratio: float,
    unsure_m: float,
    found_after: int | None,
    late_m: float,
) -> None:
    """The reader sends the first reading, or it is lost; the loss is found after some moves
    within reach."""
    contacts, site, at_m, now_s = Contacts(CONFIG), TagSite(7, tag_m), tag_m - 30.0, 0.0

    def way() -> Travelled:
        return gone(round(at_m * (1.0 + error_ratio) / PULSE_M), at_m)

    def go(move_m: float) -> None:
        nonlocal at_m, now_s
        at_m += move_m
        now_s += 0.05
        contacts.move(way(), PULSE_M / 1.05, now_s)
        contacts.look(at_m + unsure_m)

    for move_m in (5.0, 5.0, 15.0, 5.0 + felt_off_m):
        go(move_m)
    if found_after is None:
        contacts.read(7, way(), 0.1)
    for number, move_m in enumerate(moves_m):
        if number == found_after:
            contacts.miss(way())
        go(move_m)
        if abs(at_m - tag_m) > REACH_M:
            break
        read_m, pulses, read_s = at_m, way().pulses, now_s
        if number + 1 == len(moves_m):
            # Its telegram arrives only here.
            go(late_m)
        off_m = contacts.off_m(site, pulses, PULSE_M / 0.99, read_s)
        if found_after is None:
            assert off_m >= min(REACH_M, abs(read_m - tag_m))
        elif number >= found_after:
            assert off_m == REACH_M
