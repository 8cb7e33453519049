"""One tag in one cycle: the resulting position of the train and its bounds."""

from typing import Any

import pytest

from can_dbc.odometer import ColdMovement
from hil_tests.unit.vobc.odometry.odometry_desk import PULSE_M, Desk, near
from vobc.odometry.localisation import Localisation
from vobc.odometry.references import LocatedTag, References, Windows
from vobc.odometry.scale import Waypoint
from vobc.vocabulary import PlaceProof, RefusedTag, TagReading, TagRefusal

LEAST_M, MOST_M = 0.01 / 1.05, 0.01 / 0.99
SCALE: dict[str, Any] = {"scale_error_low_ratio": -0.01, "scale_error_high_ratio": 0.05}


class Judged:
    """Records what the odometer passes to the order of tags: the reading and the window."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.readings: list[LocatedTag] = []
        self.windows: list[tuple[float, float]] = []
        judge, find_again = References.judge, References.find_again

        def judged(
            self_: References, reading: LocatedTag, windows: Windows, *, disputed: bool
        ) -> Any:
            self.readings.append(reading)
            self.windows.append(windows.whole_m)
            return judge(self_, reading, windows, disputed=disputed)

        def found(self_: References, reading: LocatedTag, least_m: float, most_m: float) -> Any:
            self.readings.append(reading)
            return find_again(self_, reading, least_m, most_m)

        monkeypatch.setattr(References, "judge", judged)
        monkeypatch.setattr(References, "find_again", found)


@pytest.fixture
def judged(monkeypatch: pytest.MonkeyPatch) -> Judged:
    return Judged(monkeypatch)


def going(step: int = 8, cycles: int = 60, front_m: float = 52.0, **changes: Any) -> Any:
    """An odometer at 4 m/s with 8 pulses in each 20 ms, seen by the radar; it is 960 pulses
    (9.52 m) from the start."""
    made = Desk(front_m=front_m, **changes)
    made.cycles(cycles, step, step, radar_mps=step * 0.5)
    return made


def read(made: Any, *, since: int, age_s: float, tag_id: int = 7) -> TagReading:
    """A reading that lies `since` pulses before the last sample."""
    return TagReading(tag_id, (made.pulses_a - since) % 65536, age_s)


def test_a_tag_places_the_train_by_the_pulses_since(judged: Judged) -> None:
    """The front was at 62 m 20 pulses ago; at 4 m/s, 6 ms are 2.4 cm."""
    made = going(**SCALE)
    where, over_m = made.where, made.odometry._over_m
    made.over_ground(3.8, 4.0)
    made.track.rate_pulses_per_s = 400.0
    m_per_pulse, scale, pulses = where.m_per_pulse, where.scale, where.pulses
    spread_m = 20 * (scale.high_m - scale.low_m)
    made.cycle(dt_s=0.0, tags=(read(made, since=20, age_s=0.05),))

    (reading,) = judged.readings
    speed_mps = max(400.0 * m_per_pulse, 3.9)
    assert reading.site.tag_id == 7
    assert reading.front_m == 62.0
    assert reading.claim_m == pytest.approx(62.0 + 20 * m_per_pulse)
    assert reading.bound_m == pytest.approx(0.06 + 0.006 * speed_mps + MOST_M + 0.5 * spread_m)
    assert reading.pulses == pulses - 20
    assert reading.ground_m == pytest.approx(over_m - 0.05 * 3.9)
    assert reading.ground_bound_m == made.odometry._over_blur_m


def test_the_front_reaches_the_next_tag_an_antenna_offset_beyond_it() -> None:
    assert going().cycle(8, 8, radar_mps=4.0).next_tag_m == 62.0


@pytest.mark.parametrize(
    ("rate_pulses_per_s", "ground_mps", "half_mps", "speed_mps"),
    [
        (400.0, 3.0, 1.0, 4.0),
        (300.0, 4.0, 1.0, 4.0),
        (-400.0, 3.0, 1.0, 4.0),
        (300.0, -4.0, 8.1, 4.0),
    ],
)
def test_the_time_error_of_a_tag_grows_with_the_speed(
    judged: Judged, rate_pulses_per_s: float, ground_mps: float, half_mps: float, speed_mps: float
) -> None:
    made = going()
    made.track.rate_pulses_per_s = rate_pulses_per_s
    made.over_ground(ground_mps - half_mps, ground_mps + half_mps)
    made.cycle(dt_s=0.0, tacho_age_s=9.0, tags=(read(made, since=0, age_s=0.05),))

    assert judged.readings[0].bound_m == pytest.approx(0.06 + 0.006 * speed_mps + PULSE_M)


@pytest.mark.parametrize("age_s", [0.05, 9.0])
@pytest.mark.parametrize("since", [20, -20])
def test_the_pulses_since_a_tag_carry_the_error_of_the_scale(
    monkeypatch: pytest.MonkeyPatch, since: int, age_s: float
) -> None:
    """The test also runs backwards.

    The distance over ground is that of the last cycles. For an older tag it follows from the speed
    and 1.5 m/s².
    """
    told: list[tuple[Any, ...]] = []
    corrected: list[tuple[float, float, float]] = []
    measured: list[Waypoint] = []
    monkeypatch.setattr(
        Localisation, "refer", lambda self, *args, restarts: told.append((*args, restarts))
    )
    monkeypatch.setattr(Localisation, "correct", lambda self, *args: corrected.append(args))
    monkeypatch.setattr(Localisation, "measure", lambda self, here: measured.append(here))
    made = going(front_m=52.4, **SCALE)
    made.over_ground(3.8, 4.0)
    made.track.rate_pulses_per_s = 400.0
    m_per_pulse = made.where.m_per_pulse
    bound_m = 0.06 + 0.006 * max(400.0 * m_per_pulse, 3.9) + MOST_M
    lately_m = made.where.lately_m(age_s)
    made.cycle(dt_s=0.0, tags=(read(made, since=since, age_s=age_s),))

    ((front_m, since_m, over_m, refer_bound_m, restarts),) = told
    ends_m = sorted((since * made.where.scale.low_m, since * made.where.scale.high_m))
    assert (front_m, restarts) == (62.0, False)
    assert since_m == near(ends_m[0], since * m_per_pulse, ends_m[1])
    assert (lately_m is None) == (age_s == 9.0)
    by_speed_m = near((3.8 - 1.5 * age_s) * age_s, (4.0 + 1.5 * age_s) * age_s)
    assert over_m == (by_speed_m if lately_m is None else lately_m)
    assert refer_bound_m == pytest.approx(bound_m)
    assert corrected == [near(62.0, since, bound_m - 0.06 - MOST_M)]
    (here,) = measured
    assert (here.antenna_m, here.pulses) == (60.0, 960 - 8 - since)
    assert here.bound_m == pytest.approx(bound_m)


def test_a_tag_counted_by_slipping_wheels_has_the_error_of_the_ground(
    judged: Judged, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The wheels give the distance since the tag, with the error of the ground; no scale is
    measured."""
    corrected: list[tuple[float, float, float]] = []
    monkeypatch.setattr(Localisation, "correct", lambda self, *args: corrected.append(args))
    made = going()
    made.cycle(8, 8, steps_b=(8, 18), radar_mps=4.0)
    assert made.odometry._slip
    assert not made.odometry._wheels_out
    made.over_ground(3.8, 4.1)
    made.track.rate_pulses_per_s = 400.0
    made.cycle(dt_s=0.0, tacho_age_s=9.0, tags=(read(made, since=20, age_s=0.1),))

    rough_m = 0.5 * (0.3 + 2 * 0.15) * 0.1
    (reading,) = judged.readings
    assert reading.claim_m == pytest.approx(62.2)
    assert reading.bound_m == pytest.approx(0.06 + 0.024 + PULSE_M + rough_m)
    assert corrected == [near(62.0, 20.0, 0.024 + rough_m)]
    assert made.where.scale._anchor is None


def test_a_tag_counted_by_excluded_wheels_is_placed_by_the_ground_alone(
    judged: Judged, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[tuple[Any, ...]] = []
    refer = Localisation.refer

    def referred(self: Localisation, *args: Any, restarts: bool) -> None:
        told.append(args)
        refer(self, *args, restarts=restarts)

    monkeypatch.setattr(Localisation, "refer", referred)
    made = going()
    made.cycles(4, 16, 16, radar_mps=4.0)
    assert made.odometry._wheels_out
    made.over_ground(3.8, 4.1)
    made.track.rate_pulses_per_s = 300.0
    made.cycle(dt_s=0.0, tacho_age_s=9.0, tags=(read(made, since=50, age_s=0.1),))

    over_m = ((3.8 - 0.15) * 0.1, (4.1 + 0.15) * 0.1)
    (reading,) = judged.readings
    assert reading.claim_m == pytest.approx(62.0 + 0.395)
    assert reading.bound_m == pytest.approx(0.06 + 0.006 * 3.95 + PULSE_M + 0.03 + 0.03)
    assert told[0][1] == near(over_m[0], 0.395, over_m[1])
    lately_m = made.where.lately_m(0.1)
    assert told[0][2] == lately_m
    assert over_m[0] < lately_m[0] < lately_m[1] < over_m[1]
    assert made.where.scale._anchor is None


def test_a_tag_while_the_other_axle_counts_is_placed_by_the_ground(judged: Judged) -> None:
    """Tacho A latches the pulses of a tag but is unhealthy, so 400 pulses/s for 0.1 s count
    instead."""
    made = going()
    made.cycles(3, 8, 8, radar_mps=4.0, healthy=(False, True))
    made.over_ground(3.8, 4.1)
    made.track.rate_pulses_per_s = 400.0
    made.cycle(dt_s=0.0, tacho_age_s=9.0, tags=(read(made, since=7, age_s=0.1),))

    (reading,) = judged.readings
    assert not made.odometry._slip
    assert reading.claim_m == pytest.approx(62.0 + 0.395)
    assert reading.bound_m == pytest.approx(0.06 + 0.024 + PULSE_M + 0.03 + 0.03)
    assert reading.pulses == made.where.pulses - 40


@pytest.mark.parametrize(("ahead_s", "age_s"), [(0.0, 0.0), (-0.05, 0.05), (0.5, 0.0)])
def test_the_window_is_that_of_the_last_sample(
    judged: Judged, ahead_s: float, age_s: float
) -> None:
    """Over ground the train was further back at the sample; a sample from the future counts as
    one of now."""
    made = going()
    made.where.low_m, made.where.high_m = 61.9, 62.0
    made.where.ground_low_m, made.where.ground_high_m = 61.5, 62.5
    made.over_ground(-3.0, 4.0)
    made.track.stamp_s += ahead_s
    made.cycle(dt_s=0.0, tacho_age_s=9.0, tags=(read(made, since=0, age_s=0.05),))

    assert judged.windows == [near(61.5 - 4.0 * age_s, 62.5 + 3.0 * age_s)]


def test_a_train_that_turns_round_at_a_tag_may_pass_it_again_at_once() -> None:
    """The reader reported the tag 20 pulses ago, and the train went back by 22."""
    made = going(1, front_m=61.0)
    assert made.cycle(dt_s=0.0, tags=(read(made, since=20, age_s=0.05),)).accepted_tag_ids == (7,)
    again = made.cycle(-22, dt_s=0.5, tags=(read(made, since=20, age_s=0.01),))

    assert again.accepted_tag_ids == (7,)


def test_a_train_that_ran_back_over_a_tag_may_pass_it_again() -> None:
    made = going()
    made.cycle(8, 8, radar_mps=4.0, tags=(read(made, since=-10, age_s=0.015),))
    told = made.cycle(-8, -8, tags=(read(made, since=6, age_s=0.01),))

    assert told.accepted_tag_ids == (7,)


# A reading that may be a second one.


@pytest.mark.parametrize("gap", ["with the tag", "before", "left behind", "never"])
def test_a_tag_after_missing_telegrams_may_be_read_anywhere_within_reach(
    judged: Judged, monkeypatch: pytest.MonkeyPatch, gap: str
) -> None:
    """The bound is half a metre to either side, and the reading measures no wheel."""
    told: list[float] = []
    corrected: list[tuple[float, float, float]] = []
    measured: list[int] = []
    monkeypatch.setattr(
        Localisation,
        "refer",
        lambda self, front, since, over, bound_m, restarts: told.append(bound_m),
    )
    monkeypatch.setattr(Localisation, "correct", lambda self, *args: corrected.append(args))
    monkeypatch.setattr(Localisation, "measure", lambda self, *args: measured.append(1))
    cycles_since = {"before": 2, "left behind": 15}.get(gap)
    made = going(front_m=52.4 - 0.16 * (0 if cycles_since is None else 1 + cycles_since))
    if cycles_since is not None:
        made.cycle(8, 8, radar_mps=4.0, tag_gap=True)
        made.cycles(cycles_since, 8, 8, radar_mps=4.0)
    made.over_ground(4.0, 4.0)
    made.track.rate_pulses_per_s = 400.0
    tag = read(made, since=20, age_s=0.05)
    accepted = made.cycle(dt_s=0.0, tags=(tag,), tag_gap=gap == "with the tag").accepted_tag_ids

    off_m = 0.5 if gap in ("with the tag", "before") else 0.0
    assert accepted == (7,)
    assert judged.readings[0].bound_m == pytest.approx(0.06 + off_m + 0.024 + PULSE_M)
    assert told == near(0.06 + off_m + 0.024 + PULSE_M)
    assert corrected == [near(62.0, 20.0, 0.024 + off_m)]
    assert len(measured) == (0 if off_m else 1)


def test_a_reading_after_a_refused_first_one_counts_as_the_second(
    judged: Judged,
) -> None:
    """The first reading was outside its window. The second one, 30 cm further, is not at the
    centre either."""
    made = going(front_m=40.0)
    first = made.cycle(8, 8, radar_mps=4.0, tags=(read(made, since=0, age_s=0.05),))
    made.cycle(8, 8, radar_mps=4.0, tags=(read(made, since=0, age_s=0.05),))

    assert [refused.reason for refused in first.refused_tags] == [TagRefusal.OUTSIDE_WINDOW]
    bounds_m = [reading.bound_m for reading in judged.readings]
    # The offset is 16 pulses and one more, plus the bound of the first reading.
    assert bounds_m[1] - bounds_m[0] == pytest.approx(0.17 + bounds_m[0], abs=0.01)


def test_a_tag_counts_as_left_by_the_least_distance_of_a_pulse(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The bound uses all declared wheels and not only the measured one."""
    told: list[tuple[float, float]] = []

    def followed(self: References, _: Any, least_m: float, now_s: float, **others: Any) -> None:
        told.append((least_m, now_s))

    monkeypatch.setattr(References, "follow", followed)
    made = going(cycles=2, scale_error_low_ratio=-0.01, scale_error_high_ratio=0.03)

    least_m, most_m = made.where.scale.declared_m
    assert [each for each, _ in told] == [least_m] * 2
    assert told[1][1] == made.odometry._time.now_s
    assert least_m < most_m


def test_the_earliest_time_of_a_reading_allows_for_its_age_and_the_bound_of_its_stamp(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    told_s: list[float] = []

    def off_centre(self: References, site: Any, pulses: int, most_m: float, read_s: float) -> float:
        told_s.append(read_s)
        return 0.0

    monkeypatch.setattr(References, "off_centre_m", off_centre)
    made = going(**SCALE)
    made.cycle(dt_s=0.0, tags=(read(made, since=20, age_s=0.05),))

    stamp_s = made.odometry._config.tag_stamp_s
    assert told_s == [pytest.approx(made.odometry._time.now_s - 0.05 - stamp_s)]
    assert stamp_s > 0.0


def test_a_reading_before_the_first_motion_is_remembered(judged: Judged) -> None:
    """The controller started next to a tag, so the reader may have reported it before."""
    made = Desk(front_m=61.9)
    made.cycles(2, 8, 8, radar_mps=4.0)
    made.cycle(8, 8, radar_mps=4.0, tags=(read(made, since=0, age_s=0.05),))

    assert judged.readings[0].bound_m > 0.56


def test_a_repeated_tag_within_its_reach_keeps_the_known_interval(judged: Judged) -> None:
    """The train runs 40 pulses on and 58 back and passes the tag again, measured by the wheels."""
    made = going(2, front_m=59.9)
    before = made.cycle(dt_s=0.0, tags=(read(made, since=20, age_s=0.05),)).front_m
    for cycles, *steps in ((20, 1, 1), (30, 0, 0), (10, -1, 0), (24, -1, -1)):
        made.cycles(cycles, *steps)
    assert not made.odometry._slip
    again = made.cycle(dt_s=0.0, tags=(read(made, since=0, age_s=0.01),)).front_m

    first, second = judged.readings
    assert second.pulses - first.pulses == 2
    off_m = first.bound_m + 0.03
    assert second.bound_m == pytest.approx(off_m + 0.06 + PULSE_M, abs=0.01)
    assert again.high - again.low < before.high - before.low + 0.2


# A place that is lost.


def test_with_a_lost_position_the_first_tag_is_neither_accepted_nor_refused() -> None:
    """The tags are 30 m or 3000 pulses apart; the second one gives the position."""
    made = going(proof=PlaceProof.UNKNOWN, front_m=400.0)
    first = made.cycle(8, 8, radar_mps=4.0, tags=(read(made, since=-10, age_s=0.015),))
    assert (first.accepted_tag_ids, first.refused_tags) == ((), ())
    assert not first.localised
    again = made.cycle(8, 8, radar_mps=4.0, tags=(read(made, since=0, age_s=0.1),))
    assert again.accepted_tag_ids == ()
    assert again.refused_tags == (RefusedTag(7, TagRefusal.REPEATED, 0.0),)
    assert not again.localised
    made.cycles(186, 8, 8, radar_mps=4.0)
    found = made.cycle(8, 8, radar_mps=4.0, tags=(read(made, since=-10, age_s=0.015, tag_id=8),))

    assert found.accepted_tag_ids == (8,)
    assert found.refused_tags == ()
    assert found.localised
    assert found.front_m.best == pytest.approx(92.06, abs=0.02)
    assert found.front_m.low > 91.5
    assert found.front_m.high < 92.5


def test_a_recovered_position_has_the_bound_of_its_tag(monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[tuple[float, float]] = []
    restart = Localisation.restart

    def beginning(self: Localisation, front_m: float, bound_m: float) -> None:
        begun.append((front_m, bound_m))
        restart(self, front_m, bound_m)

    monkeypatch.setattr(Localisation, "restart", beginning)
    made = going(proof=PlaceProof.UNKNOWN, front_m=400.0)
    made.cycle(8, 8, radar_mps=4.0, tags=(read(made, since=-10, age_s=0.015),))
    made.cycles(187, 8, 8, radar_mps=4.0)
    assert begun == []
    made.cycle(8, 8, radar_mps=4.0, tags=(read(made, since=-10, age_s=0.015, tag_id=8),))

    assert begun == [near(92.06, 0.06 + 0.006 * 4.0 + PULSE_M)]


@pytest.mark.parametrize(("cycles", "found"), [(97, False), (137, True), (180, False)])
def test_a_lost_position_is_recovered_by_the_ground_distance_after_a_slip(
    cycles: int, *, found: bool
) -> None:
    """The wheels turned at half the speed for two seconds, while the radar measured up to 30 m."""
    made = going(proof=PlaceProof.UNKNOWN, front_m=400.0)
    made.cycle(8, 8, radar_mps=4.0, tags=(read(made, since=-10, age_s=0.015),))
    made.cycles(50, 4, 4, radar_mps=4.0)
    made.cycles(cycles, 8, 8, radar_mps=4.0)
    told = made.cycle(8, 8, radar_mps=4.0, tags=(read(made, since=-10, age_s=0.015, tag_id=8),))

    assert told.localised is found


# Where it begins, and what it watches.


@pytest.mark.parametrize(("front_m", "missed"), [(61.42, 1), (61.44, 0)])
def test_a_tag_that_the_train_may_stand_over_at_the_start_need_not_be_read(
    front_m: float, missed: int
) -> None:
    """The tag is half a metre, a pulse and its own 6 cm ahead of the antenna, which is 2 m
    behind the front."""
    made = Desk(front_m=front_m)
    for _ in range(70):
        told = made.cycle(8, 8, radar_mps=4.0)

    assert told.missed_tags == missed


def test_a_tag_counts_as_missed_once_the_rearmost_antenna_is_past_it() -> None:
    made = going()
    before = 0
    for _ in range(150):
        told = made.cycle(8, 8, radar_mps=4.0)
        late_m = 0.06 + 0.5 * told.speed_mps.best
        passed = told.front_m.low - 2.0 - late_m > 60.0
        assert (told.missed_tags == 1) is passed
        before += not passed
    assert 0 < before < 150


def test_the_place_is_lost_once_both_ends_are_further_apart_than_allowed() -> None:
    made = going(localisation_limit_m=2.0, tags=())
    wide = 0
    for _ in range(400):
        told = made.cycle(8, 8, radar_mps=4.0)
        wide += told.front_m.high - told.front_m.low > 2.0
        assert told.localised is (wide == 0)
    assert 0 < wide < 400


# Cold movement.


def test_a_waiting_train_gets_its_proof_and_a_wider_interval() -> None:
    waiting, proven = (Desk(proof=PlaceProof.REMEMBERED) for _ in range(2))
    for made in (waiting, proven):
        assert not made.cycles(3, 0, 0).localised
    told = proven.cycle(0, 0, cold=ColdMovement(-1.25, True))
    silent = waiting.cycle(0, 0)

    assert told.localised
    assert not silent.localised
    assert told.front_m.low == pytest.approx(silent.front_m.low - 1.25)
    assert told.front_m.high == pytest.approx(silent.front_m.high + 1.25)


def test_a_train_that_was_moved_too_far_loses_its_position_and_its_interval_stays() -> None:
    made, silent = (Desk(proof=PlaceProof.REMEMBERED) for _ in range(2))
    told = made.cycle(0, 0, cold=ColdMovement(5.0, True))

    assert told.lost_cause == "moved by 5.0 m while it was off"
    assert told.front_m == silent.cycle(0, 0).front_m


def test_a_train_with_a_known_position_requires_no_proof() -> None:
    made, silent = Desk(), Desk()
    told = made.cycle(0, 0, cold=ColdMovement(50.0, False))

    assert told.localised
    assert told == silent.cycle(0, 0)


@pytest.mark.parametrize(
    ("wheels_m", "ground_m", "bound_m"),
    [
        ((9.0, 10.5), (9.5, 10.25), 1.0),
        ((9.5, 10.5), (9.0, 10.25), 1.0),
        ((9.5, 11.0), (9.25, 10.5), 1.0),
        ((9.5, 10.5), (9.25, 11.0), 1.0),
        ((11.0, 11.5), (11.0, 11.25), 1.5),
        ((8.5, 9.0), (8.75, 9.0), 1.5),
    ],
)
def test_the_stored_position_is_the_furthest_end_of_either_interval(
    wheels_m: tuple[float, float], ground_m: tuple[float, float], bound_m: float
) -> None:
    made = Desk()
    made.where.low_m, made.where.high_m = wheels_m
    made.where.ground_low_m, made.where.ground_high_m = ground_m

    assert made.odometry.record().bound_m == pytest.approx(bound_m)


@pytest.mark.parametrize(
    ("refused", "widens", "pairs", "calls"),
    [
        (False, False, False, ["accept, expected"]),
        (True, False, False, []),
        (True, False, True, []),
        (True, True, False, ["embrace"]),
        (True, True, True, ["restart", "accept, unexpected"]),
    ],
)
def test_a_refused_tag_widens_the_intervals_or_restarts_them_with_the_tag_before(
    monkeypatch: pytest.MonkeyPatch, *, refused: bool, widens: bool, pairs: bool, calls: list[str]
) -> None:
    refusal = RefusedTag(7, TagRefusal.CONTRADICTED, 0.3) if refused else None
    called: list[str] = []

    def accept(_: References, reading: LocatedTag, windows: Windows | None) -> None:
        called.append("accept, unexpected" if windows is None else "accept, expected")

    monkeypatch.setattr(References, "judge", lambda *_, disputed: refusal)
    monkeypatch.setattr(References, "widens", lambda *_: widens)
    monkeypatch.setattr(References, "pairs", lambda *_: pairs)
    monkeypatch.setattr(References, "accept", accept)
    monkeypatch.setattr(Localisation, "embrace", lambda *_: called.append("embrace"))
    monkeypatch.setattr(Localisation, "restart", lambda *_: called.append("restart"))
    made = going()
    told = made.cycle(8, 8, radar_mps=4.0, tags=(read(made, since=-10, age_s=0.015),))

    assert called == calls
    accepted = bool(calls) and calls != ["embrace"]
    assert told.accepted_tag_ids == ((7,) if accepted else ())
    assert told.refused_tags == (() if accepted else (refusal,))
