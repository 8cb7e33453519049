"""The braking profile of a line against figures by hand and against motion from edge to edge."""

import math
import random
from collections.abc import Iterator, Sequence

import pytest

from metro_hil.metrics.worst_motion import GRAVITY_MPS2, Section, line_of, sections
from vobc.atp import profile as under_test
from vobc.atp.braking import BrakingCurve, SafeBraking
from vobc.atp.profile import BrakingProfile

CLOSE_MPS = 1e-6
"""The profile lies so much under the exact speed at most."""
ROUNDING_MPS = 1e-9
BRAKING = SafeBraking(guaranteed_decel_mps2=1.0, runaway_mps2=1.0, runaway_s=1.0, build_up_s=2.0)
"""Round numbers: on the level a train gains 1 m/s over v + 0.5 m, then runs 2 * (v + 1) m."""
QUARTER = -0.25 * 1000.0 / GRAVITY_MPS2
HALF = 2.0 * QUARTER
"""Falls that take a quarter and half a metre per second squared, in per mille."""
LONG = ((0.0, 6000.0, 40.0),)
UNDER_M = 100.0
NO_LIMIT_MPS = 60.0
LOOKS_WITHOUT_END = 400


def profile_of(*gradients: Section, under_m: float = UNDER_M) -> BrakingProfile:
    return BrakingProfile(BRAKING, line_of(gradients, LONG), under_m=under_m)


def work_j_per_kg(profile: BrakingProfile, from_m: float, to_m: float) -> float:
    return profile.work_j_per_kg(to_m) - profile.work_j_per_kg(from_m)


def speed_to(
    profile: BrakingProfile,
    front_m: float,
    target_m: float,
    *,
    target_mps: float = 0.0,
    lead_s: float = 0.0,
    below_mps: float = NO_LIMIT_MPS,
) -> float:
    return profile.speed_mps(
        front_m,
        profile.work_j_per_kg(target_m),
        target_mps=target_mps,
        lead_s=lead_s,
        below_mps=below_mps,
    )


def test_a_curve_holds_what_is_gained_in_the_reaction_on_a_fall() -> None:
    """1 m/s2 of traction and 0.25 of fall for 0.5 s, then the fall alone for 2 s.

    0.625 m/s more at the cut, 1.125 m/s more when the brake bites; beyond v * 2.5 s the way is
    0.15625 m until the cut, 1.25 m at the gain and 0.5 m of more fall from there on.
    """
    braking = SafeBraking(1.0, 1.0, 0.5, 2.0)

    assert braking.falling(0.25) == BrakingCurve(0.75, 2.5, 1.125, 1.90625)
    assert braking.falling(0.0) == BrakingCurve(1.0, 2.5, 0.5, 1.125)
    assert braking.on(QUARTER).gain_m == pytest.approx(1.90625)


def test_from_ten_metres_per_second_that_curve_leads_down_to_five() -> None:
    """15 m of lead and 25 m of reaction, 1.90625 m of gain, 11.125 to 5 m/s at 0.75 m/s2."""
    curve = BrakingCurve(0.75, 2.5, 1.125, 1.90625)
    braked_m = (11.125**2 - 5.0**2) / 1.5

    assert curve.speed_mps(
        15.0 + 25.0 + 1.90625 + braked_m, target_mps=5.0, lead_s=1.5
    ) == pytest.approx(10.0)
    assert curve.speed_mps(25.0 + 1.90625 + braked_m, target_mps=5.0) == pytest.approx(10.0)


def test_from_ten_metres_per_second_that_curve_needs_so_far_to_standstill() -> None:
    curve = BrakingCurve(0.75, 2.5, 1.125, 1.90625)
    braked_m = 11.125**2 / 1.5

    assert curve.stopping_m(10.0, lead_s=1.5) == pytest.approx(41.90625 + braked_m)
    assert curve.stopping_m(10.0) == pytest.approx(26.90625 + braked_m)


def test_where_no_speed_stops_in_time_the_curve_gives_the_target_and_never_less() -> None:
    """Without any reaction a train that is 1 m beyond its target would have to be -2 (m/s)**2."""
    at_once = BrakingCurve(1.0, 0.0, 0.0, 0.0)

    assert at_once.speed_mps(-1.0, target_mps=0.0) == 0.0
    assert at_once.speed_mps(-1.0, target_mps=3.0) == 3.0
    assert at_once.speed_mps(0.125, target_mps=0.0) == 0.5


def test_the_brake_holds_a_train_down_to_a_twentieth_and_not_less() -> None:
    weak = SafeBraking(0.3, 1.0, 0.5, 2.0)

    assert SafeBraking(0.05, 0.0, 0.0, 0.0).falling(0.0).decel_mps2 == 0.05
    with pytest.raises(ValueError, match=r"where the gradient takes 0\.000 m/s2 of it$"):
        SafeBraking(math.nextafter(0.05, 0.0), 0.0, 0.0, 0.0).falling(0.0)
    assert weak.falling(0.2).decel_mps2 == pytest.approx(0.1)
    with pytest.raises(ValueError, match=r"^guaranteed_decel_mps2 0\.3 does not hold .* 0\.260 m"):
        weak.falling(0.26)


@pytest.mark.parametrize(
    "settings", [(0.0, 1.0, 1.0, 1.0), (1.0, -0.1, 1.0, 1.0), (1.0, 1.0, -0.1, 1.0),
                 (1.0, 1.0, 1.0, -0.1)]
)  # fmt: skip
def test_a_model_that_brakes_by_nothing_or_reacts_before_its_time_is_no_model(
    settings: tuple[float, float, float, float],
) -> None:
    with pytest.raises(AssertionError):
        SafeBraking(*settings)
    assert SafeBraking(0.5, 0.0, 0.0, 0.0).guaranteed_decel_mps2 == 0.5


def test_the_brake_takes_a_joule_each_metre_on_the_level_and_less_on_a_fall() -> None:
    """From the front at the start of the fall to the rear off its end."""
    profile = profile_of((1000.0, 1400.0, QUARTER))

    assert work_j_per_kg(profile, 900.0, 1000.0) == pytest.approx(100.0)
    assert work_j_per_kg(profile, 1000.0, 1500.0) == pytest.approx(375.0)
    assert work_j_per_kg(profile, 1500.0, 1700.0) == pytest.approx(200.0)
    assert work_j_per_kg(profile, 999.0, 1001.0) == pytest.approx(1.75)
    assert work_j_per_kg(profile, 1499.0, 1501.0) == pytest.approx(1.75)


@pytest.mark.parametrize("gradients", [(), ((0.0, 6000.0, 30.0),), ((0.0, 6000.0, 0.0),)])
def test_on_the_level_and_on_a_climb_each_metre_is_a_joule_even_before_the_line(
    gradients: Sequence[Section],
) -> None:
    profile = profile_of(*gradients)

    assert work_j_per_kg(profile, -50.0, 70.0) == pytest.approx(120.0)
    assert work_j_per_kg(profile, 5900.0, 6500.0) == pytest.approx(600.0)


def test_a_line_that_falls_from_its_start_is_level_before_it() -> None:
    profile = profile_of((0.0, 300.0, QUARTER))

    assert work_j_per_kg(profile, -40.0, 0.0) == pytest.approx(40.0)
    assert work_j_per_kg(profile, 0.0, 400.0) == pytest.approx(300.0)


def test_a_line_that_falls_only_at_its_end_is_level_until_there() -> None:
    assert work_j_per_kg(profile_of((5000.0, 6000.0, QUARTER)), 0.0, 5000.0) == pytest.approx(5e3)


def test_under_a_train_on_two_falls_the_steeper_one_counts() -> None:
    """The gentle one until the front comes to the steep one, and again from its end on."""
    profile = profile_of(
        (1000.0, 1050.0, QUARTER), (1080.0, 1090.0, HALF), (1090.0, 1150.0, QUARTER)
    )

    assert work_j_per_kg(profile, 1000.0, 1080.0) == pytest.approx(0.75 * 80.0)
    assert work_j_per_kg(profile, 1080.0, 1190.0) == pytest.approx(0.5 * 110.0)
    assert work_j_per_kg(profile, 1190.0, 1250.0) == pytest.approx(0.75 * 60.0)
    assert work_j_per_kg(profile, 1250.0, 1300.0) == pytest.approx(50.0)


def test_at_ten_metres_per_second_a_train_needs_93_metres_on_the_level() -> None:
    """10.5 m until the cut, 22 m until the brake bites, 60.5 m from 11 m/s to standstill."""
    level = profile_of()

    assert speed_to(level, 1000.0, 1093.0) == pytest.approx(10.0)
    assert speed_to(level, 1000.0, 1093.0 + 15.0, lead_s=1.5) == pytest.approx(10.0)
    assert speed_to(level, 1000.0, 1093.0 - 8.0, target_mps=4.0) == pytest.approx(10.0)
    assert speed_to(level, 1000.0, 1093.0, below_mps=9.0) == 9.0
    assert speed_to(level, 1000.0, 1040.0, target_mps=12.0) == 12.0
    assert speed_to(level, 1000.0, 1040.0, target_mps=12.0, below_mps=11.0) == 11.0


@pytest.mark.parametrize("run_on_m", [0.0, 1.0, 400.0])
def test_a_fall_where_the_brake_bites_or_later_lengthens_the_braking_only(
    run_on_m: float,
) -> None:
    """Exactly where it bites, too: there the closed form holds to the last digit."""
    edge_m = 1000.0 + 10.5 + 22.0 + run_on_m
    profile = profile_of((edge_m, 5000.0, QUARTER))
    on_the_level_m = min(run_on_m, 60.5)
    stop_m = 1032.5 + on_the_level_m + (60.5 - on_the_level_m) / 0.75

    assert speed_to(profile, 1000.0, stop_m) == pytest.approx(10.0, abs=ROUNDING_MPS)


def test_a_fall_that_begins_at_the_cut_speeds_the_train_up_until_the_brake_bites() -> None:
    """11 m/s at the cut after 10.5 m, 11.5 m/s after another 22.5 m, then 0.75 m/s2."""
    profile = profile_of((1010.5, 5000.0, QUARTER))
    stop_m = 1010.5 + 22.5 + 0.5 * 11.5**2 / 0.75

    found_mps = speed_to(profile, 1000.0, stop_m)

    assert 10.0 - CLOSE_MPS <= found_mps <= 10.0 + ROUNDING_MPS
    assert speed_to(profile, 1000.0, stop_m, below_mps=9.0) == 9.0
    late_m = stop_m - 0.5 * 5.0**2 / 0.75
    assert 10.0 - CLOSE_MPS <= speed_to(profile, 1000.0, late_m, target_mps=5.0) <= 10.0
    found_mps = speed_to(profile, 980.0, stop_m, lead_s=2.0)
    assert 10.0 - CLOSE_MPS <= found_mps <= 10.0 + ROUNDING_MPS


@pytest.mark.parametrize(
    ("below_mps", "found_mps"), [(9.99, 9.99), (10.0, 10.0), (10.01, 10.0), (11.0, 10.0)]
)
def test_a_train_that_is_just_not_too_fast_keeps_its_speed(
    below_mps: float, found_mps: float
) -> None:
    """As before, 11 m/s at the cut and 11.5 m/s when the brake bites; exact to the last digit."""
    profile = profile_of((1010.5, 5000.0, QUARTER))
    work_at_target = profile.work_j_per_kg(1033.0) + 0.5 * 11.5**2

    speed_mps = profile.speed_mps(
        1000.0, work_at_target, target_mps=0.0, lead_s=0.0, below_mps=below_mps
    )

    assert found_mps - CLOSE_MPS <= speed_mps <= found_mps
    assert speed_mps == found_mps or below_mps > found_mps


def test_a_train_that_would_be_too_fast_at_its_target_is_held_to_the_target() -> None:
    """The fall begins in the reaction; of that alone even a train at standstill comes 2.5 m far."""
    profile = profile_of((1001.0, 5000.0, QUARTER))

    assert speed_to(profile, 1000.0, 1002.5) == 0.0
    assert speed_to(profile, 1000.0, 1005.0, target_mps=8.0) == 8.0


def falls_of(gradients: Sequence[Section], under_m: float, at_m: float) -> tuple[float, float]:
    """Under a front that has just come here: the fall, and where the next change may be."""
    falls_mps2, changes_m = [0.0], [math.inf]
    for start_m, end_m, gradient_permille in gradients:
        clear_m = end_m + under_m
        changes_m += [change_m for change_m in (start_m, clear_m) if change_m > at_m]
        if start_m <= at_m < clear_m:
            falls_mps2.append(-gradient_permille * GRAVITY_MPS2 / 1000.0)
    return max(falls_mps2), min(changes_m)


def arrival_mps(
    gradients: Sequence[Section], under_m: float, front_m: float, speed_mps: float,
    lead_s: float, target_m: float,
) -> float:  # fmt: skip
    """Speed at the target after the worst motion, from edge to edge; 0 if it stops before."""
    phases = [(1.0, 1.0), (0.0, 2.0), (-1.0, math.inf)]
    at_m = front_m + speed_mps * lead_s
    while at_m < target_m and phases:
        push_mps2, left_s = phases[0]
        fall_mps2, next_m = falls_of(gradients, under_m, at_m)
        accel_mps2 = push_mps2 + fall_mps2
        room_m = min(next_m, target_m) - at_m
        reached = speed_mps**2 + 2.0 * accel_mps2 * room_m
        if reached < 0.0:
            return 0.0
        end_mps = math.sqrt(reached)
        needed_s = 2.0 * room_m / (speed_mps + end_mps)
        if needed_s > left_s:
            at_m += speed_mps * left_s + 0.5 * accel_mps2 * left_s**2
            speed_mps += accel_mps2 * left_s
            phases.pop(0)
        else:
            phases[0] = (push_mps2, left_s - needed_s)
            at_m, speed_mps = min(next_m, target_m), end_mps
    return speed_mps


def states() -> Iterator[tuple[tuple[Section, ...], float, float, float, float, float]]:
    """Gradients, reach, front, lead, way and target speed by chance; most cross an edge."""
    rng = random.Random(7)
    for _ in range(400):
        pieces = [
            (rng.choice((0.0, 2.0, 40.0)), rng.uniform(5.0, 90.0), rng.uniform(-45.0, 10.0))
            for _ in range(12)
        ]
        yield (
            sections(pieces),
            rng.uniform(10.0, 120.0),
            rng.uniform(1.0, 500.0),
            rng.choice((0.0, 0.6, 1.6)),
            rng.uniform(20.0, 500.0),
            rng.choice((0.0, 0.0, 6.0, 12.0)),
        )


def test_over_falls_of_all_kinds_the_speed_is_the_highest_that_is_not_too_fast() -> None:
    """Never over it; and a train that is a millionth faster arrives over its target speed."""
    counted = 0
    for gradients, under_m, front_m, lead_s, way_m, target_mps in states():
        profile = profile_of(*gradients, under_m=under_m)
        target_m = front_m + way_m
        found_mps = speed_to(profile, front_m, target_m, target_mps=target_mps, lead_s=lead_s)
        under_mps, over_mps = found_mps - ROUNDING_MPS, found_mps + CLOSE_MPS + ROUNDING_MPS

        if found_mps > target_mps:
            counted += 1
            arrived_mps = arrival_mps(gradients, under_m, front_m, under_mps, lead_s, target_m)
            assert arrived_mps <= target_mps
        assert arrival_mps(gradients, under_m, front_m, over_mps, lead_s, target_m) > target_mps
    assert counted > 250


class Looks:
    """Counts the looks at the way ahead, and may mistake the growth of what it sees."""

    def __init__(self, patch: pytest.MonkeyPatch, growth_ratio: float = 1.0) -> None:
        self.counts = [0]
        look = BrakingProfile._excess

        def counted(profile: BrakingProfile, *args: float) -> tuple[float, float]:
            self.counts[-1] += 1
            assert self.counts[-1] < LOOKS_WITHOUT_END
            excess, slope = look(profile, *args)
            return excess, growth_ratio * slope

        patch.setattr(under_test.BrakingProfile, "_excess", counted)

    def __call__(self) -> int:
        """Since the last call."""
        self.counts.append(0)
        return self.counts[-2]


@pytest.mark.parametrize("growth_ratio", [0.1, 0.25, 0.5, 2.0, 4.0])
def test_a_speed_is_found_even_where_its_growth_is_mistaken(
    growth_ratio: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Steps that are far too long or short leave the speeds in question, or hardly move in them."""
    profile = profile_of((1003.0, 1008.0, HALF), (1010.5, 5000.0, QUARTER), (5000.0, 6000.0, HALF))
    right_mps = [speed_to(profile, 1000.0, 1003.0 + 7.0 * n) for n in range(40)]
    looks = Looks(monkeypatch, growth_ratio)

    for n, speed_mps in enumerate(right_mps):
        looks()
        found_mps = speed_to(profile, 1000.0, 1003.0 + 7.0 * n)
        assert found_mps == pytest.approx(speed_mps, abs=2.0 * CLOSE_MPS)


def test_a_first_guess_that_is_right_is_kept_to_the_last_digit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def five_is_right(*args: float) -> tuple[float, float]:
        return args[2] - 5.0, 1.0

    monkeypatch.setattr(under_test.BrakingProfile, "_excess", five_is_right)

    assert profile_of()._across(0.0, 0.0, 0.0, guess_mps=5.0, low_mps=0.0, high_mps=9.0) == 5.0


def test_at_or_over_what_the_target_permits_two_looks_are_enough(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """One at the highest speed of interest, one at the target's speed; also if it is 10 m/s."""
    profile = profile_of((1010.5, 5000.0, QUARTER))
    ten_mps = profile.work_j_per_kg(1033.0) + 0.5 * 11.5**2 - 0.5 * 10.0**2
    looks = Looks(monkeypatch)

    for more_j_per_kg in (0.0, -0.2, -50.0):
        looks()
        assert (
            profile.speed_mps(
                1000.0, ten_mps + more_j_per_kg, target_mps=10.0, lead_s=0.0, below_mps=30.0
            )
            == 10.0
        )
        assert looks() == 2
    profile.speed_mps(1000.0, ten_mps + 0.2, target_mps=10.0, lead_s=0.0, below_mps=30.0)
    assert looks() > 2


def test_a_speed_is_found_in_few_looks_at_the_way_ahead(monkeypatch: pytest.MonkeyPatch) -> None:
    """Protection has to answer in each cycle: the worst state may not take it long."""
    looks = Looks(monkeypatch)
    counts: list[int] = []
    for gradients, under_m, front_m, lead_s, way_m, target_mps in states():
        profile = profile_of(*gradients, under_m=under_m)
        looks()
        speed_to(profile, front_m, front_m + way_m, target_mps=target_mps, lead_s=lead_s)
        counts.append(looks())

    assert max(counts) <= 9
    assert sum(counts) <= 4.4 * len(counts)
