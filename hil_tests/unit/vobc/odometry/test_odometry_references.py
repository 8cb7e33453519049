"""Which tags count, and how a position is lost, proven and found again; each limit on both
sides."""

import math
from dataclasses import replace

import pytest

from can_dbc.nodes import Direction
from can_dbc.odometer import ColdMovement, Tacho
from firmware_py.trackdb import TagSite
from hil_tests.unit.vobc.odometry import odometry_rig as rig
from vobc.odometry.contacts import Travelled
from vobc.odometry.pulses import APART_PULSES, PLAY_PULSES, PulseCounter
from vobc.odometry.references import MOVED_PULSES, TURN_PULSES, LocatedTag, References, Windows
from vobc.odometry.scale import Waypoint, WheelScale
from vobc.vocabulary import PlaceProof, TagRefusal

CONFIG, TAGS, LINE, NOMINAL_M = rig.CONFIG.odometry, rig.TAGS, rig.LINE, rig.NOMINAL_M
LIMIT_M = CONFIG.localisation_limit_m


BOTH = Windows((10.0, 20.0), (10.0, 20.0))
"""Wheels and ground expect the front at the same places."""


def reading(index: int, claim_m: float, *, pulses: int = 0, bound_m: float = 0.1) -> LocatedTag:
    site = TAGS[index]
    return LocatedTag(
        site, site.position_m + 2.0, claim_m, bound_m, pulses, pulses * NOMINAL_M, 0.0
    )


def references(proof: PlaceProof = PlaceProof.SET_UP) -> References:
    found = References(CONFIG, LINE, proof)
    found.begin(0.0)
    return found


@pytest.mark.parametrize(
    ("claim_m", "off_m"), [(9.89, -0.11), (9.91, None), (20.09, None), (20.11, 0.11)]
)
def test_a_tag_is_accepted_inside_its_window_only(claim_m: float, off_m: float | None) -> None:
    refused = references().judge(reading(0, claim_m), BOTH, disputed=False)

    assert (refused is None) is (off_m is None)
    if refused is not None:
        assert refused.reason is TagRefusal.OUTSIDE_WINDOW
        assert refused.off_m == pytest.approx(off_m)


def test_a_tag_behind_the_last_one_is_out_of_order_and_the_last_one_itself_repeated() -> None:
    order = references()
    order.accept(reading(1, 15.0), None)

    again, behind = (
        order.judge(reading(1, 15.0), BOTH, disputed=False),
        order.judge(reading(0, 15.0), BOTH, disputed=False),
    )

    assert again is not None
    assert behind is not None
    assert (again.reason, behind.reason) == (TagRefusal.REPEATED, TagRefusal.OUT_OF_ORDER)
    assert order.judge(reading(2, 15.0), BOTH, disputed=False) is None


@pytest.mark.parametrize(("back", "believed"), [(TURN_PULSES, False), (TURN_PULSES + 1, True)])
def test_a_train_that_went_back_may_pass_a_tag_again(back: int, *, believed: bool) -> None:
    order = references()
    order.accept(reading(1, 15.0), None)
    order.turned(100)
    order.turned(100 - back)

    assert (order.judge(reading(1, 15.0), BOTH, disputed=False) is None) is believed


def test_missing_telegrams_widen_the_tags_that_the_antenna_may_have_reached() -> None:
    """The antenna was between 5 m and 13 m when the loss was found, and beyond 20 m later."""
    order = references()
    near, far = TagSite(91, 13.0), TagSite(92, 13.2)
    order.follow(Travelled(0, 0.0, 0.0), NOMINAL_M, 0.0, gap=False, slip=False)
    order.watch(0.0, 0.0, 1.0)
    order.follow(Travelled(5000, 20.0, 0.0), NOMINAL_M, 0.0, gap=False, slip=False)
    assert (
        order.off_centre_m(near, 0, NOMINAL_M, 0.1),
        order.off_centre_m(far, 0, NOMINAL_M, 0.1),
    ) == (
        0.0,
        0.0,
    )

    order.follow(Travelled(5000, 20.0, 0.0), NOMINAL_M, 0.0, gap=True, slip=False)
    assert (
        order.off_centre_m(near, 0, NOMINAL_M, 0.1)
        == order.off_centre_m(far, 0, NOMINAL_M, 0.1)
        == CONFIG.tag_reach_m
    )
    order.watch(5.0, 0.0, 8.0)
    assert (
        order.off_centre_m(near, 0, NOMINAL_M, 0.1),
        order.off_centre_m(far, 0, NOMINAL_M, 0.1),
    ) == (
        CONFIG.tag_reach_m,
        0.0,
    )
    order.follow(Travelled(10000, 40.0, 0.0), NOMINAL_M, 0.0, gap=False, slip=False)
    assert order.off_centre_m(near, 0, NOMINAL_M, 0.1) == 0.0


def test_missing_telegrams_widen_any_tag_while_the_position_is_lost() -> None:
    order = references(PlaceProof.UNKNOWN)
    order.follow(Travelled(5000, 50.0, 0.0), NOMINAL_M, 0.0, gap=True, slip=False)
    order.watch(5.0, 0.0, 8.0)

    assert order.off_centre_m(TagSite(92, 500.0), 0, NOMINAL_M, 0.1) == CONFIG.tag_reach_m


def test_a_tag_that_was_read_may_be_read_again_until_it_is_left() -> None:
    order = references()
    order.follow(Travelled(5000, 50.0, 0.0), NOMINAL_M, 0.0, gap=False, slip=False)
    first = replace(reading(1, 15.0), pulses=5000, ground_m=50.0)
    order.read(first, honest=True)
    assert order.off_centre_m(first.site, 0, NOMINAL_M, 0.1) == CONFIG.tag_reach_m
    order.follow(Travelled(6000, 60.0, 0.0), NOMINAL_M, 0.0, gap=False, slip=False)
    assert order.off_centre_m(first.site, 0, NOMINAL_M, 0.1) == 0.0

    order.read(replace(first, pulses=6000, ground_m=60.0, ground_bound_m=10.0), honest=True)
    order.follow(Travelled(7000, 70.0, 19.5), NOMINAL_M, 0.0, gap=False, slip=False)
    assert order.off_centre_m(first.site, 0, NOMINAL_M, 0.1) == CONFIG.tag_reach_m


@pytest.mark.parametrize(
    ("honest", "slip", "off_m"), [(True, False, 0.25), (False, False, 0.5), (True, True, 0.5)]
)
def test_wheels_without_slip_measure_the_distance_to_a_repeated_reading(
    off_m: float, *, honest: bool, slip: bool
) -> None:
    """The first reading is within 0.2 m of the tag; since then the train ran four pulses and
    perhaps one more."""
    order = references()
    order.follow(Travelled(5000, 50.0, 0.0), NOMINAL_M, 0.0, gap=False, slip=False)
    first = replace(reading(1, 15.0), pulses=5000, ground_m=50.0, bound_m=0.2)
    order.read(first, honest=honest)
    order.follow(Travelled(5000, 50.0, 0.0), NOMINAL_M, 0.0, gap=False, slip=slip)

    assert order.off_centre_m(first.site, 5004, 0.01, 0.1) == pytest.approx(off_m)


@pytest.mark.parametrize(("width_m", "lost"), [(LIMIT_M, False), (LIMIT_M + 0.001, True)])
def test_the_place_is_lost_beyond_the_limit_of_its_interval(width_m: float, *, lost: bool) -> None:
    order = references()
    order.watch(0.0, 0.0, width_m)

    assert bool(order.lost_cause) is lost
    assert ("the limit is 30 m" in order.lost_cause) is lost


def test_the_second_expected_tag_in_a_row_that_was_not_read_loses_the_place() -> None:
    order = references()
    late_m = CONFIG.tag_bound_m
    order.watch(TAGS[0].position_m + late_m, 0.0, 1.0)
    assert (order.missed, order.lost_cause) == (0, "")
    order.watch(TAGS[0].position_m + late_m + 0.01, 0.0, 1.0)
    assert (order.missed, order.lost_cause) == (1, "")
    order.accept(reading(1, 15.0), None)
    assert order.missed == 0
    order.watch(TAGS[3].position_m + late_m + 0.01, 0.0, 1.0)
    assert (order.missed, order.lost_cause) == (2, "2 expected tags were not read")


@pytest.mark.parametrize(("off_m", "found"), [(-0.19, True), (0.19, True), (0.6, False)])
def test_two_tags_give_the_position_if_the_train_ran_as_far_as_they_lie_apart(
    off_m: float, *, found: bool
) -> None:
    order = references(PlaceProof.UNKNOWN)
    apart = round((TAGS[1].position_m - TAGS[0].position_m + off_m) / NOMINAL_M)

    assert order.find_again(reading(0, 0.0), NOMINAL_M, NOMINAL_M) is None
    assert order.lost_cause == "started at an unknown place"
    same = order.find_again(reading(0, 0.0), NOMINAL_M, NOMINAL_M)
    assert same is not None
    assert same.reason is TagRefusal.REPEATED
    refused = order.find_again(reading(1, 0.0, pulses=apart), NOMINAL_M, NOMINAL_M)

    assert (refused is None) is found
    assert (order.lost_cause == "") is found


LIMIT_COLD_M = CONFIG.cold_movement_m


@pytest.mark.parametrize(
    ("cold", "pulses", "moved_m"),
    [
        (ColdMovement(LIMIT_COLD_M, True), 0, LIMIT_COLD_M),
        (ColdMovement(LIMIT_COLD_M + 0.01, True), 0, None),
        (ColdMovement(0.0, False), 0, None),
        (ColdMovement(0.3, True), MOVED_PULSES, 0.3),
        (ColdMovement(0.3, True), MOVED_PULSES + 1, None),
        (ColdMovement(0.3, True), -MOVED_PULSES - 1, None),
    ],
)
def test_a_remembered_position_counts_once_it_is_proven_that_the_train_did_not_move(
    cold: ColdMovement, pulses: int, moved_m: float | None
) -> None:
    order = references(PlaceProof.REMEMBERED)
    assert "not proven yet" in order.lost_cause

    assert order.check_cold(cold, pulses) == moved_m
    assert (order.lost_cause == "") is (moved_m is not None)
    assert not order.waiting


def cruise(time_s: float, speed_mps: float) -> float:
    return 1.0 if time_s < 14.0 else 0.0


def test_after_wake_up_the_proof_localises_the_train_and_widens_its_interval() -> None:
    ride = rig.Rig(rig.Errors(start_off_m=1.9), bound_m=0.5, proof=PlaceProof.REMEMBERED)
    before = ride.run(1.5, lambda time_s, mps: 0.0)
    ride.cold = ColdMovement(1.9, True)
    after = ride.run(1.0, lambda time_s, mps: 0.0)

    assert not any(moment.motion.localised for moment in before)
    assert all(moment.motion.localised for moment in after)
    widths_m = [
        history[-1].motion.front_m.high - history[-1].motion.front_m.low
        for history in (before, after)
    ]
    assert widths_m[1] - widths_m[0] == pytest.approx(2 * 1.9, abs=0.01)
    assert after[-1].motion.front_m.low <= ride.front_m <= after[-1].motion.front_m.high


@pytest.mark.parametrize("proof", [PlaceProof.REMEMBERED, PlaceProof.UNKNOWN])
def test_without_the_proof_two_references_give_the_position(proof: PlaceProof) -> None:
    """The remembered position is 300 m off and must leave no trace."""
    ride = rig.Rig(rig.Errors(seed=3), believed_m=300.0, bound_m=2000.0, proof=proof)
    ride.cold = ColdMovement(50.0, True)
    history = ride.run(30.0, cruise)

    found = next(moment for moment in history if moment.motion.localised)
    second_m = TAGS[1].position_m + 2.0
    assert second_m <= found.front_m < second_m + 3.0
    assert all(m.motion.localised == (m.time_s >= found.time_s) for m in history)
    for moment in history[history.index(found) :]:
        front = moment.motion.front_m
        assert front.low <= moment.front_m <= front.high
        assert abs(front.best - moment.front_m) < 1.0


def test_a_false_position_is_discarded_and_recovered() -> None:
    """The initial position is 40 m off. No tag fits, two are missed, and two others give the
    position."""
    ride = rig.Rig(rig.Errors(), believed_m=40.0)
    history = ride.run(45.0, cruise)

    causes = {moment.motion.lost_cause for moment in history} - {""}
    assert causes == {"2 expected tags were not read"}
    last = history[-1]
    assert last.motion.localised
    assert last.motion.front_m.low <= last.front_m <= last.motion.front_m.high


# Pulses and scale.


def tacho(a: int, b: int, way: Direction = Direction.FORWARD) -> Tacho:
    return Tacho(a % 65536, b % 1024, way, True, True, 0.0)


@pytest.mark.parametrize("way", [Direction.REVERSE, Direction.NEUTRAL])
@pytest.mark.parametrize("step", [PLAY_PULSES, PLAY_PULSES + 1])
def test_pulses_against_their_direction_are_a_contradiction(way: Direction, step: int) -> None:
    pulses = PulseCounter(4000.0)
    pulses.step(tacho(0, 0), 0.02)
    pulses.step(tacho(step, step, way), 0.02)

    assert pulses.contradicted is (step > PLAY_PULSES)


@pytest.mark.parametrize(("ahead", "differ"), [(int(APART_PULSES), False), (6, True)])
def test_axles_that_move_apart_are_noticed(ahead: int, *, differ: bool) -> None:
    pulses = PulseCounter(4000.0)
    pulses.step(tacho(0, 0), 0.02)
    pulses.step(tacho(20 + ahead, 20), 0.02)

    assert pulses.axles_differ is differ


def test_contradicting_directions_make_the_odometer_unusable_and_the_interval_two_sided(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ride = rig.Rig(rig.Errors())
    ride.run(10.0, cruise)
    honest = ride._tacho
    monkeypatch.setattr(ride, "_tacho", lambda: replace(honest(), direction=Direction.REVERSE))
    before_m = ride.front_m
    last = ride.run(1.0, cruise)[-1]

    assert not ride.odometry.usable
    assert last.motion.slip
    assert not last.motion.standstill
    assert last.motion.front_m.low <= before_m - (last.front_m - before_m) + 1.0
    assert last.motion.front_m.high >= last.front_m


def test_two_contradicting_tags_withdraw_the_measured_wheel() -> None:
    scale = WheelScale(CONFIG, NOMINAL_M)
    declared_m = (scale.low_m, scale.high_m)
    scale.anchor(Waypoint(0.0, 0.05, 0, 0.0, 0.0))
    scale.measure(Waypoint(200.0, 0.05, round(200.0 / NOMINAL_M), 200.0, 0.0))
    assert scale.high_m / scale.low_m < 1.006
    assert scale.low_m <= NOMINAL_M <= scale.high_m

    scale.measure(Waypoint(400.0, 0.05, round(396.0 / NOMINAL_M), 400.0, 0.0))

    assert (scale.low_m, scale.high_m) == declared_m


def test_the_reported_wheel_is_the_last_calibrated_one() -> None:
    ride = rig.Rig(rig.Errors(scale_ratio=0.03, seed=5))
    last = ride.run(40.0, cruise)[-1]

    true_m = rig.CONFIG.train.wheel_diameter_m / 1.03
    assert last.motion.wheel_diameter_m == pytest.approx(true_m, rel=2e-3)
    assert math.pi * last.motion.wheel_diameter_m / 256 == pytest.approx(
        ride.odometry.record().m_per_pulse
    )
