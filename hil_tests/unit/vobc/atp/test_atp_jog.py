"""Missed stops: overshoots, jogs and attempts, on both sides of every threshold."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from can_dbc.alarms import TrainAlarms
from can_dbc.cab import CabMode, Desk
from can_dbc.doors import DoorState, DoorStatus
from can_dbc.vobc import Cause
from firmware_py.trackdb import load_line
from hil_tests.unit.vobc.atp.heard_rig import DESK, NO_ORDERS, SILENCE
from vobc.atp.jog import TRANSITIONS, JogFacts, JogState, next_state
from vobc.atp.station import StationGuard, StationVerdict
from vobc.config import load_config
from vobc.vocabulary import Authority, CycleInput, Interval, Motion

LINE = load_line("florence")
CONFIG = load_config("florence4").atp
LENGTH_M = 68.59
STOP_M = 1500.0
JOG_MPS = 5.0 / 3.6
SEEN = replace(
    SILENCE,
    doors=DoorStatus(True, DoorState.LOCKED, DoorState.LOCKED, True),
    doors_age_s=0.0,
    desk=DESK,
    desk_age_s=0.0,
    authority=Authority(1560.0, 1, 1, rear_m=STOP_M - LENGTH_M - 10.0),
    authority_age_s=0.0,
    alarms=TrainAlarms(True, True),
    alarms_age_s=0.0,
    orders=replace(NO_ORDERS, awake=True, doors_right=True, platform_doors_locked=True),
    orders_age_s=0.0,
)  # fmt: skip
ALARM = replace(SEEN, desk=Desk(CabMode.AUTO, 0.0, True, False, False, False, False, False))


def motion(off_m: float, speed_mps: float, *, half_m: float, rests: bool) -> Motion:
    front_m = STOP_M + off_m
    return Motion(
        Interval(front_m - half_m, front_m, front_m + half_m),
        Interval(speed_mps, speed_mps, speed_mps),
        0.0,
        front_m,
        rests,
        rests,
        True,
        False,
        (),
    )


class GuardRig:
    """A station guard; tests say how far past the stop the train stands or moves."""

    def __init__(self, seen: CycleInput = SEEN, stop_m: float | None = STOP_M) -> None:
        self.guard = StationGuard(CONFIG, LINE, train_length_m=LENGTH_M)
        self.seen = seen
        self.stop_m = stop_m
        self.emergency = False
        self.may_move = True

    def step(self, at: Motion) -> StationVerdict:
        return self.guard.step(
            self.seen,
            at,
            gone=0,
            emergency=self.emergency,
            may_move=self.may_move,
            stopping_at_m=self.stop_m,
        )

    def stands(self, off_m: float, half_m: float = 0.05) -> StationVerdict:
        return self.step(motion(off_m, 0.0, half_m=half_m, rests=True))

    def moves(self, off_m: float, speed_mps: float, half_m: float = 0.05) -> StationVerdict:
        return self.step(motion(off_m, speed_mps, half_m=half_m, rests=False))


def jogged(bench: GuardRig, from_m: float, to_m: float) -> StationVerdict:
    """Make one attempt from rest to rest and return the verdict after it."""
    bench.stands(from_m)
    way_m = to_m - from_m
    bench.moves(from_m + way_m / 2.0, math.copysign(0.3, way_m))
    return bench.stands(to_m)


# Overshoots.


@pytest.mark.parametrize(
    ("off_m", "cause"), [(0.9, Cause.NONE), (1.04, Cause.NONE), (1.06, Cause.OVERSHOT)]
)
def test_more_than_a_metre_past_the_stop_brings_the_emergency_brake(
    off_m: float, cause: Cause
) -> None:
    """The interval reaches 5 cm to either side; the train must have passed the metre for
    certain."""
    bench = GuardRig()
    bench.moves(-20.0, 3.0)

    assert bench.moves(off_m, 2.0).emergency is cause


def test_a_standing_train_overshoots_no_more() -> None:
    bench = GuardRig()
    bench.moves(0.5, 1.0)

    assert bench.stands(1.4).emergency is Cause.NONE


@pytest.mark.parametrize("stop_m", [None, 3000.0])
def test_a_station_that_is_passed_on_purpose_is_not_overshot(stop_m: float | None) -> None:
    bench = GuardRig(stop_m=stop_m)
    for off_m in (-100.0, -1.0, 1.5, 4.0, 50.0):
        verdict = bench.moves(off_m, 15.0)
        assert verdict.emergency is Cause.NONE
        assert not verdict.alarm_raised


@pytest.mark.parametrize(
    ("off_m", "mended"), [(1.4, True), (4.94, True), (4.96, False), (6.0, False)]
)
def test_only_an_overshoot_that_a_jog_can_correct_releases_itself(
    off_m: float, mended: bool
) -> None:
    bench = GuardRig()
    bench.moves(off_m - 0.5, 2.0)
    bench.emergency = True

    assert bench.stands(off_m).self_release is mended


def test_beyond_the_reach_of_a_jog_the_train_calls_for_a_person_and_does_not_move_back() -> None:
    bench = GuardRig()
    bench.moves(5.5, 2.0)

    verdict = bench.stands(6.0)

    assert verdict.alarm_raised
    assert not verdict.jog_permitted
    assert verdict.jog_back_m == 0.0


# Leave to jog.


@pytest.mark.parametrize(
    ("off_m", "permitted"),
    [
        (-5.01, False),
        (-5.0, True),
        (-0.8, True),
        (-0.26, True),
        (-0.2, False),
        (0.0, False),
        (0.2, False),
        (0.26, True),
        (0.6, True),
        (5.0, True),
        (5.01, False),
    ],
)
def test_a_jog_is_for_trains_that_stand_off_their_stop_within_reach(
    off_m: float, permitted: bool
) -> None:
    verdict = GuardRig().stands(off_m)

    assert verdict.jog_permitted is permitted
    assert (verdict.jog_back_m > 0.0) is (permitted and off_m > 0.0)


def test_no_jog_makes_an_interval_narrower() -> None:
    assert not GuardRig().stands(0.1, half_m=0.25).jog_permitted
    assert not GuardRig().stands(0.25, half_m=1.0).jog_permitted


@pytest.mark.parametrize("off_m", [-0.04, 0.0, 0.06, 0.29])
@pytest.mark.parametrize(
    ("tag_off_m", "permitted"), [(0.0, True), (0.25, True), (0.26, False), (math.inf, False)]
)
@pytest.mark.parametrize("seen", [SEEN, replace(SEEN, authority=Authority(1560.0, 1, 1))])
def test_a_tag_ahead_in_the_window_justifies_a_jog_forwards(
    seen: CycleInput, tag_off_m: float, off_m: float, permitted: bool
) -> None:
    """The interval is too wide for doors, and this jog needs no free track behind the train."""
    at = replace(motion(off_m, 0.0, half_m=0.31, rests=True), next_tag_m=STOP_M + tag_off_m)
    verdict = GuardRig(seen).step(at)

    assert verdict.jog_permitted is permitted
    assert verdict.jog_to_tag is permitted


def test_a_jog_to_a_tag_stays_permitted_under_way_and_ends_with_the_permission_to_move() -> None:
    bench = GuardRig(replace(SEEN, authority=Authority(1560.0, 1, 1)))
    at = replace(motion(0.1, 0.0, half_m=0.35, rests=True), next_tag_m=STOP_M)
    bench.step(at)
    moving = replace(motion(0.25, 0.2, half_m=0.35, rests=False), next_tag_m=STOP_M)

    assert bench.step(moving).jog_to_tag
    read = replace(motion(0.25, 0.1, half_m=0.1, rests=False), next_tag_m=math.inf)
    assert bench.step(read).jog_permitted
    bench.emergency = True
    assert not bench.step(read).jog_permitted


@pytest.mark.parametrize(("rear_off_m", "permitted"), [(0.56, False), (0.54, True)])
def test_a_jog_back_needs_protection_behind_the_rearmost_place_of_the_rear(
    rear_off_m: float, permitted: bool
) -> None:
    """The jog goes 0.6 m back from 0.6 m past the stop with 5 cm of uncertainty."""
    rear_m = STOP_M + 0.6 - 0.05 - LENGTH_M - 0.6 + rear_off_m - 0.55
    bench = GuardRig(replace(SEEN, authority=Authority(1560.0, 1, 1, rear_m=rear_m)))

    assert bench.stands(0.6).jog_permitted is permitted


def test_without_a_protected_rear_no_train_jogs_back() -> None:
    verdict = GuardRig(replace(SEEN, authority=Authority(1560.0, 1, 1))).stands(0.6)

    assert not verdict.jog_permitted
    assert verdict.jog_back_m == 0.0


@pytest.mark.parametrize(
    ("seen", "off_m", "permitted"),
    [
        (ALARM, 0.6, False),
        (ALARM, -0.8, True),
        (replace(SEEN, doors=None), -0.8, False),
        (replace(SEEN, orders=None), -0.8, False),
        (replace(SEEN, alarms=TrainAlarms(False, True)), -0.8, False),
    ],
)
def test_what_else_keeps_a_train_from_jogging(
    seen: CycleInput, off_m: float, permitted: bool
) -> None:
    assert GuardRig(seen).stands(off_m).jog_permitted is permitted


def test_an_emergency_or_a_held_train_jogs_nowhere() -> None:
    bench = GuardRig()
    bench.emergency = True
    assert not bench.stands(0.6).jog_permitted
    bench.emergency, bench.may_move = False, False
    assert not bench.stands(0.6).jog_permitted
    bench.may_move = True
    assert bench.stands(0.6).jog_permitted


def test_an_emergency_withdraws_the_permission_of_a_running_jog() -> None:
    bench = GuardRig()
    bench.stands(0.6)
    assert bench.moves(0.45, -0.3).jog_permitted
    bench.emergency = True

    verdict = bench.moves(0.4, -0.3)

    assert not verdict.jog_permitted
    assert verdict.jog_back_m == 0.0


# A jog under way.


@pytest.mark.parametrize(
    ("low_mps", "high_mps", "cause"),
    [
        (0.2, JOG_MPS - 0.001, Cause.NONE),
        (0.2, JOG_MPS + 0.001, Cause.JOG_EXCEEDED),
        (1.0 - JOG_MPS, 0.1, Cause.NONE),
        (-JOG_MPS - 0.001, -0.2, Cause.JOG_EXCEEDED),
    ],
)
def test_the_highest_bound_of_the_speed_counts_in_both_directions(
    low_mps: float, high_mps: float, cause: Cause
) -> None:
    bench = GuardRig()
    bench.stands(3.0)
    runs = motion(2.0, 0.0, half_m=0.05, rests=False)

    verdict = bench.step(replace(runs, speed_mps=Interval(low_mps, low_mps, high_mps)))

    assert verdict.emergency is cause


def test_a_jog_back_from_beyond_a_metre_is_no_overshoot() -> None:
    bench = GuardRig()
    bench.stands(1.4)

    assert bench.moves(1.2, -0.3).emergency is Cause.NONE


def test_a_jog_forward_that_runs_past_the_stop_is_an_overshoot() -> None:
    bench = GuardRig()
    bench.stands(-0.8)
    bench.moves(0.0, 1.0)

    assert bench.moves(1.1, 1.0).emergency is Cause.OVERSHOT


@pytest.mark.parametrize("way", [-1.0, 1.0])
@pytest.mark.parametrize(
    ("speed_mps", "cause"),
    [(JOG_MPS - 0.001, Cause.NONE), (JOG_MPS + 0.001, Cause.JOG_EXCEEDED)],
)
def test_a_jog_runs_at_five_kilometres_an_hour_at_most(
    speed_mps: float, way: float, cause: Cause
) -> None:
    bench = GuardRig()
    bench.stands(-way * 3.0)

    assert bench.moves(-way * 2.0, way * speed_mps).emergency is cause


@pytest.mark.parametrize(("gone_m", "cause"), [(4.99, Cause.NONE), (5.01, Cause.JOG_EXCEEDED)])
def test_a_jog_goes_no_farther_than_five_metres(gone_m: float, cause: Cause) -> None:
    bench = GuardRig()
    bench.stands(4.9)

    assert bench.moves(4.9 - gone_m, -0.5).emergency is cause


def test_a_jog_that_leaves_what_protects_its_rear_is_stopped() -> None:
    bench = GuardRig(
        replace(SEEN, authority=Authority(1560.0, 1, 1, rear_m=STOP_M - LENGTH_M - 0.5))
    )
    bench.stands(0.6)

    assert bench.moves(-0.44, -0.3).emergency is Cause.NONE
    assert bench.moves(-0.46, -0.3).emergency is Cause.JOG_EXCEEDED


def test_three_attempts_and_no_fourth() -> None:
    bench = GuardRig()
    for made, (before_m, after_m) in enumerate([(-0.8, 0.5), (0.5, -0.6), (-0.6, 0.7)], start=1):
        assert bench.stands(before_m).jog_permitted
        verdict = jogged(bench, before_m, after_m)
        assert verdict.jog_attempts == made

    assert not verdict.jog_permitted
    assert verdict.alarm_raised
    assert verdict.stop_now
    assert bench.moves(0.59, -0.2).emergency is Cause.JOG_EXCEEDED


def test_an_attempt_that_reaches_the_stop_ends_the_jog() -> None:
    bench = GuardRig()
    verdict = jogged(bench, -0.8, 0.02)

    assert not verdict.jog_permitted
    assert not verdict.alarm_raised
    assert verdict.jog_attempts == 1


def test_the_attempt_count_restarts_only_at_another_stop() -> None:
    bench = GuardRig()
    jogged(bench, -0.8, 0.6)
    bench.stop_m = None
    bench.stands(0.6)
    bench.stop_m = STOP_M
    assert bench.stands(0.6).jog_attempts == 1
    bench.stop_m = 3000.0
    assert bench.stands(0.6).jog_attempts == 0


def test_a_train_that_goes_on_after_failed_jogs_may_jog_again() -> None:
    bench = GuardRig()
    for before_m, after_m in [(-0.8, 0.5), (0.5, -0.6), (-0.6, 0.7)]:
        jogged(bench, before_m, after_m)
    bench.stop_m = 3000.0

    verdict = bench.stands(0.7)

    assert not verdict.stop_now
    assert not verdict.alarm_raised


def test_a_slow_movement_below_zero_speed_does_not_end_an_attempt() -> None:
    """Zero speed counts as proven below 1 km/h, but the pulses show that the train still moves."""
    bench = GuardRig()
    bench.stands(-2.0)
    creeping = replace(motion(-1.0, 0.2, half_m=0.05, rests=False), standstill=True)

    assert bench.step(creeping).jog_attempts == 1
    assert bench.step(replace(creeping, travel_m=STOP_M - 0.5)).jog_attempts == 1


# Distance of a jog after wheel slip: pulses and accelerometer are no better than the position
# bounds.


def jogs_back(*, slips: tuple[bool, ...]) -> list[Cause]:
    """Jog back from 4.6 m past the stop, known within 0.2 m.

    The best position stays at 4.4 m, while the rearmost one goes back to 4.6 + 0.2 - 5 m and just
    beyond.
    """
    bench = GuardRig()
    bench.stands(4.6, half_m=0.2)
    found = []
    for low_m, slip in zip((3.0, -0.2, -0.201, -0.201), slips, strict=True):
        at = replace(motion(4.4, -0.3, half_m=0.0, rests=False), slip=slip)
        low = Interval(STOP_M + low_m, STOP_M + 4.4, STOP_M + 4.6)
        found.append(bench.step(replace(at, front_m=low)).emergency)
    return found


def test_a_jog_with_slipping_wheels_ends_where_it_may_have_gone_too_far() -> None:
    over = Cause.JOG_EXCEEDED

    assert jogs_back(slips=(True, True, True, True)) == [Cause.NONE, Cause.NONE, over, over]
    # Pulses counted during a slip stay wrong, whatever the wheels do afterwards.
    assert jogs_back(slips=(True, False, False, False)) == [Cause.NONE, Cause.NONE, over, over]
    assert jogs_back(slips=(False, False, False, True)) == [Cause.NONE] * 3 + [over]


def test_without_slip_the_pulses_measure_the_jog() -> None:
    assert jogs_back(slips=(False,) * 4) == [Cause.NONE] * 4


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_after_a_slip_the_farthest_position_and_the_pulses_both_count(way: float) -> None:
    bench = GuardRig()
    bench.stands(-4.6 * way, half_m=0.2)
    at = replace(motion(-4.4 * way, 0.3 * way, half_m=0.0, rests=False), slip=True)

    def may_be_at(farthest_m: float, travel_m: float) -> Cause:
        ends_m = sorted((STOP_M - 4.6 * way, STOP_M + farthest_m * way))
        where = Interval(ends_m[0], STOP_M - 4.4 * way, ends_m[1])
        return bench.step(replace(at, front_m=where, travel_m=STOP_M + travel_m * way)).emergency

    assert may_be_at(0.2 - 1e-6, -4.4) is Cause.NONE
    assert may_be_at(0.2 - 1e-6, 0.4 + 1e-6) is Cause.JOG_EXCEEDED
    assert may_be_at(0.2 + 1e-6, -4.4) is Cause.JOG_EXCEEDED


def test_a_train_that_slips_and_never_stood_makes_no_jog() -> None:
    verdict = GuardRig().step(replace(motion(4.4, -0.3, half_m=0.1, rests=False), slip=True))

    assert (verdict.jog_attempts, verdict.jog_permitted) == (0, False)


def test_a_slip_no_longer_counts_once_the_train_stands_again() -> None:
    bench = GuardRig()
    bench.stands(4.6, half_m=0.2)
    bench.step(replace(motion(4.4, -0.3, half_m=0.2, rests=False), slip=True))
    bench.stands(4.4, half_m=0.2)
    wide = replace(motion(4.2, -0.3, half_m=0.0, rests=False))

    verdict = bench.step(replace(wide, front_m=Interval(STOP_M - 1.0, STOP_M + 4.2, STOP_M + 4.4)))

    assert verdict.emergency is Cause.NONE


# The table.


def facts(**changes: float | bool) -> JogFacts:
    known = {
        "low_m": 0.6,
        "best_m": 0.65,
        "high_m": 0.7,
        "standstill": True,
        "moved_m": 0.0,
        "speed_high_mps": 0.0,
        "back_room_m": 10.0,
        "attempts": 0,
    }
    known["most_moved_m"] = abs(changes.get("moved_m", 0.0))
    return JogFacts(limits=CONFIG, **{**known, **changes})  # type: ignore[arg-type]


def test_every_state_is_in_the_table_and_can_be_reached() -> None:
    assert set(TRANSITIONS) == set(JogState)
    assert {target for rows in TRANSITIONS.values() for _, target in rows} == set(JogState)


@given(
    st.sampled_from(JogState),
    st.floats(-20.0, 20.0),
    st.floats(0.0, 2.0),
    st.booleans(),
    st.floats(-6.0, 6.0),
    st.integers(3, 5),
)
def test_after_the_last_attempt_nothing_gets_ready_for_another(
    state: JogState, best_m: float, half_m: float, standstill: bool, moved_m: float, attempts: int
) -> None:
    seen = facts(
        low_m=best_m - half_m,
        best_m=best_m,
        high_m=best_m + half_m,
        standstill=standstill,
        moved_m=moved_m,
        attempts=attempts,
    )
    after = next_state(state, seen)

    assert after is not JogState.READY or state is JogState.READY


@given(st.lists(st.tuples(st.floats(-4.0, 4.0), st.booleans()), min_size=1, max_size=40))
def test_no_motion_gets_more_than_three_attempts(
    way: list[tuple[float, bool]],
) -> None:
    """The test counts the attempts from the permissions alone while the train moves on them."""
    bench = GuardRig()
    begun, granted = 0, False
    for off_m, rests in way:
        verdict = bench.stands(off_m) if rests else bench.moves(off_m, 0.3)
        if not rests and granted and verdict.jog_attempts > begun:
            begun += 1
        granted = verdict.jog_permitted
        assert begun <= 3
        if begun == 3 and rests:
            assert not verdict.jog_permitted
