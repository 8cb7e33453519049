"""The energy check against hand calculations, exact on both sides of each limit."""

import math
from dataclasses import replace

import pytest

from metro_hil.metrics.worst_motion import CONFIG, FAR_M, GRAVITY_MPS2, Section, line_of
from vobc.atp.energy_check import EnergyCheck, Replicas
from vobc.vocabulary import Interval, Restriction

LENGTH_M = 64.0
CYCLE_S = 0.125
SET = replace(
    CONFIG,
    warning_margin_mps=0.5,
    service_margin_mps=1.0,
    emergency_margin_mps=2.0,
    guaranteed_decel_mps2=1.0,
    runaway_mps2=1.0,
    sensing_s=0.125,
    traction_cut_s=0.5,
    overruns_max=2,
    brake_build_up_s=2.0,
    interval_step_m=0.5,
    replica_band_mps=0.25,
    replica_cycles_max=0,
)
"""Traction acts for 1 s: sensing, three cycles and the cut. Then the brake needs 2 s to act."""
QUARTER = -0.25 * 1000.0 / GRAVITY_MPS2
HALF = 2.0 * QUARTER
ALL = 4.0 * QUARTER
"""Gradients in per mille whose downhill force takes 0.25, 0.5 and 1 m/s²."""
OPEN: tuple[Section, ...] = ((0.0, 6000.0, 40.0),)
JUST_MPS = 1e-9


def check_of(*gradients: Section, limits: tuple[Section, ...] = OPEN) -> EnergyCheck:
    return EnergyCheck(SET, line_of(gradients, limits), train_length_m=LENGTH_M, cycle_s=CYCLE_S)


def at(front_m: float) -> Interval:
    return Interval(front_m, front_m, front_m)


def exceeded_from(
    check: EnergyCheck,
    front_m: Interval,
    speed_mps: float,
    end_m: float = FAR_M,
    restrictions: tuple[Restriction, ...] = (),
) -> bool:
    """Whether the check changes to exceeded exactly at this speed."""
    over = check.exceeded(front_m, speed_mps + JUST_MPS, end_m, restrictions)
    under = check.exceeded(front_m, speed_mps - JUST_MPS, end_m, restrictions)
    return over and not under


def test_from_ten_metres_per_second_93_metres_are_just_too_short() -> None:
    """The distances are 10.5 m until the cut, 22 m until the brake acts and 60.5 m from 11 m/s
    to standstill."""
    level = check_of()

    assert level.exceeded(at(1000.0), 10.0, 1093.0)
    assert not level.exceeded(at(1000.0), 10.0, math.nextafter(1093.0, math.inf))
    assert exceeded_from(level, at(1000.0), 10.0, 1093.0)


def test_each_tolerated_missed_cycle_adds_a_cycle_of_traction() -> None:
    """Without missed cycles, traction is cut after 0.75 s at 10.75 m/s and 7.78125 m."""
    at_once = EnergyCheck(
        replace(SET, overruns_max=0), line_of((), OPEN), train_length_m=LENGTH_M, cycle_s=CYCLE_S
    )

    way_m = 7.78125 + 21.5 + 0.5 * 10.75**2

    assert exceeded_from(at_once, at(1000.0), 10.0, 1000.0 + way_m)


@pytest.mark.parametrize("way_m", [10.6, 20.0, 52.5])
def test_the_remaining_energy_at_a_lower_limit_is_compared_with_the_allowed_one(
    way_m: float,
) -> None:
    """Each metre takes 1 of the 60.5 J/kg at the point where the brake acts. The three distances
    leave 9.99, 9 and 4 m/s."""
    left_mps = math.sqrt(11.0**2 - 2.0 * way_m)
    slow = Restriction(1032.5 + way_m, 1033.0 + way_m, left_mps - 2.0)
    civil = check_of(
        limits=((0.0, slow.start_m, 40.0), (slow.start_m, slow.end_m, slow.limit_mps),
                (slow.end_m, 6000.0, 40.0))
    )  # fmt: skip

    assert exceeded_from(check_of(), at(1000.0), 10.0, FAR_M, (slow,))
    assert exceeded_from(civil, at(1000.0), 10.0)


def test_restrictions_count_in_any_order_and_one_violated_restriction_is_enough() -> None:
    """From 11 m/s where the brake acts, the train has 9.27, 9.0 and 6.78 m/s at the three
    restrictions."""
    strict = Restriction(1052.5, 1060.0, 7.0)
    loose = Restriction(1050.0, 1051.0, 7.4)
    later = Restriction(1070.0, 1080.0, 7.5)

    for restrictions in ((loose, strict, later), (later, strict, loose), (strict, later, loose)):
        assert exceeded_from(check_of(), at(1000.0), 10.0, FAR_M, restrictions)
        assert exceeded_from(check_of(), at(1000.0), 10.0, 1093.0, (later, loose))


def test_a_train_slower_than_a_limit_ahead_plus_margin_needs_no_brake() -> None:
    """The runaway alone would bring the train over the limit: 10.5 m ahead it may have 11 m/s."""
    slow = Restriction(1010.5, 1100.0, 8.5)

    assert check_of().exceeded(at(1000.0), 10.49, FAR_M, (slow,)) is False
    assert check_of().exceeded(at(1000.0), 10.5, FAR_M, (slow,)) is True


def test_a_train_that_stops_exactly_where_two_restrictions_begin_keeps_both() -> None:
    """From 10 m/s the train stops after 93 m."""
    two = (Restriction(1093.0, 1100.0, 5.0), Restriction(1093.0, 1200.0, 6.0))

    assert check_of().exceeded(at(1000.0), 10.0, FAR_M, two) is False


@pytest.mark.parametrize("front_m", [1000.0, 1050.0, 1163.999])
def test_the_limit_that_the_train_is_under_counts_with_its_margin(front_m: float) -> None:
    slow = Restriction(1000.0, 1100.0, 6.0)
    civil = check_of(limits=((0.0, 1000.0, 40.0), (1000.0, 1100.0, 6.0), (1100.0, 6000.0, 40.0)))

    for check, extra in ((check_of(), (slow,)), (civil, ())):
        assert check.exceeded(at(front_m), 8.0, FAR_M, extra)
        assert not check.exceeded(at(front_m), math.nextafter(8.0, 0.0), FAR_M, extra)
        assert not check.exceeded(at(1164.0), 20.0, FAR_M, extra), "its rear is clear"
        unsure = Interval(1163.0, 1170.0, 1180.0)
        assert check.exceeded(unsure, 20.0, FAR_M, extra), "its rear may not be clear"


def test_the_first_and_the_last_limit_hold_beyond_the_ends_of_the_line() -> None:
    line = check_of(limits=((0.0, 3000.0, 10.0), (3000.0, 6000.0, 20.0)))

    assert exceeded_from(line, at(-200.0), 12.0)
    assert exceeded_from(line, at(1500.0), 12.0)
    assert exceeded_from(line, at(5000.0), 22.0)
    assert exceeded_from(line, at(9000.0), 22.0)


def test_a_fall_that_begins_at_the_cut_speeds_the_train_up_until_the_brake_bites() -> None:
    """The speed is 11 m/s at the cut after 10.5 m and 11.5 m/s after another 22.5 m; then 0.75
    m/s² acts."""
    check = check_of((1010.5, 5000.0, QUARTER))

    assert exceeded_from(check, at(1000.0), 10.0, 1033.0 + 0.5 * 11.5**2 / 0.75)


def test_a_fall_that_begins_in_the_middle_of_the_runaway_pulls_for_the_rest_of_it() -> None:
    """After half a second the train has 10.5 m/s and 5.125 m. Then 1.25 m/s² act for half a
    second, up to 11.125 m/s."""
    check = check_of((1005.125, 5000.0, QUARTER))
    cut_m = 1005.125 + 0.5 * 10.5 + 0.5 * 1.25 * 0.25
    bites_m = cut_m + 2.0 * 11.125 + 0.5 * 0.25 * 4.0

    assert exceeded_from(check, at(1000.0), 10.0, bites_m + 0.5 * 11.625**2 / 0.75)


def test_a_fall_ends_when_the_rear_of_the_hindmost_train_is_off_it() -> None:
    """The rear leaves the fall while the train brakes: 32.5 m of reaction, then 5 m with half of
    the brake.

    The interval of 0.9 m counts as 1 m, so the fall acts until 64 m + 1 m after its end.
    """
    check = check_of((900.0, 972.5, HALF))
    front_m = Interval(999.1, 999.5, 1000.0)
    bites_mps = 10.0 + 1.5 + 1.0
    bites_m = 1000.0 + 10.75 + 2.0 * 11.5 + 0.5 * 0.5 * 4.0
    on_it_m = 972.5 + 65.0 - bites_m
    left_j_per_kg = 0.5 * bites_mps**2 - 0.5 * on_it_m

    assert on_it_m > 2.0
    assert exceeded_from(check, front_m, 10.0, 972.5 + 65.0 + left_j_per_kg)


def test_an_edge_shortly_before_the_stop_keeps_the_remaining_energy() -> None:
    """A tenth of a joule per kg is left at the edge, and from there each metre takes 0.75 J/kg."""
    check = check_of((1092.9, 5000.0, QUARTER))

    assert exceeded_from(check, at(1000.0), 10.0, 1092.9 + 0.1 / 0.75)


def test_of_two_falls_under_the_train_the_steeper_one_pulls() -> None:
    """The second fall leaves half of the brake; after it only the first one counts again."""
    check = check_of((1033.0, 1040.0, QUARTER), (1043.0, 1047.0, HALF), (1047.0, 1300.0, QUARTER))
    at_second_j = 60.5 - 0.5 - 0.75 * 10.0
    clear_m = 1047.0 + LENGTH_M
    clear_j = at_second_j - 0.5 * (clear_m - 1043.0)

    assert clear_j > 1.0
    assert exceeded_from(check, at(1000.0), 10.0, clear_m + clear_j / 0.75)


@pytest.mark.parametrize("gradient_permille", [0.0, 30.0])
def test_a_climb_gives_no_credit(gradient_permille: float) -> None:
    check = check_of((900.0, 1050.0, gradient_permille))

    assert exceeded_from(check, at(1000.0), 10.0, 1093.0)


@pytest.mark.parametrize("gradient_permille", [ALL, 1.1 * ALL])
def test_on_a_fall_that_takes_all_of_the_brake_energy_is_always_exceeded(
    gradient_permille: float,
) -> None:
    check = check_of((0.0, 6000.0, gradient_permille))

    assert check.exceeded(at(1000.0), 0.1, 5900.0)


@pytest.mark.parametrize("speed_mps", [0.0, 5.0, math.inf, math.nan])
def test_at_the_end_of_authority_any_speed_is_too_much(speed_mps: float) -> None:
    level = check_of()

    assert level.exceeded(Interval(900.0, 950.0, 1000.0), speed_mps, 1000.0)
    assert level.exceeded(Interval(900.0, 950.0, 1000.5), speed_mps, 1000.0)
    assert level.exceeded(at(1000.0), speed_mps, math.nan)


@pytest.mark.parametrize(
    ("front_m", "speed_mps"),
    [
        (Interval(-math.inf, 950.0, 960.0), 1.0),
        (Interval(900.0, 950.0, math.inf), 1.0),
        (Interval(math.nan, 950.0, 960.0), 1.0),
        (at(1000.0), math.nan),
        (at(1000.0), math.inf),
    ],
)
def test_a_non_finite_position_or_speed_counts_as_exceeded(
    front_m: Interval, speed_mps: float
) -> None:
    assert check_of().exceeded(front_m, speed_mps, math.inf)
    assert not check_of().exceeded(at(1000.0), 1.0, math.inf)


def test_at_standstill_only_the_runaway_counts() -> None:
    """The train moves half a metre until the cut, 2 m until the brake acts and half a metre
    more."""
    level = check_of()

    for speed_mps in (0.0, -30.0):
        assert level.exceeded(at(1000.0), speed_mps, 1003.0)
        assert not level.exceeded(at(1000.0), speed_mps, 1003.000001)


@pytest.mark.parametrize(
    ("emergency_mps", "speed_mps", "agree"),
    [
        (42.25, 42.0, True),
        (math.nextafter(42.25, math.inf), 42.0, False),
        (41.75, 41.75, True),
        (41.0, 41.75, True),
        (41.0, math.nextafter(41.75, 0.0), False),
        (0.0, -30.0, False),
        (0.25, -30.0, True),
    ],
)
def test_exactly_at_the_band_the_computations_still_agree(
    emergency_mps: float, speed_mps: float, agree: bool
) -> None:
    """On an open line with a limit of 40 m/s plus 2 m/s margin, the check's own limit is 42 m/s."""
    assert Replicas(SET, check_of()).agree(emergency_mps, at(1000.0), speed_mps, FAR_M) is agree


def test_both_computations_get_the_same_position_authority_and_restrictions() -> None:
    slow = Restriction(1000.0, 1100.0, 6.0)
    replicas = Replicas(SET, check_of())

    def said(
        emergency_mps: float, front_m: float, speed_mps: float, end_m: float, *extra: Restriction
    ) -> tuple[bool, bool]:
        agree = replicas.agree(emergency_mps, at(front_m), speed_mps, end_m, extra)
        return agree, replicas.exceeded

    assert said(8.0, 1050.0, 7.9, FAR_M, slow) == (True, False)
    assert said(8.0, 1050.0, 8.0, FAR_M, slow) == (True, True)
    assert said(10.0, 1000.0, 10.0, 1093.0) == (True, True)
    assert said(10.0, 1000.0, 10.0, 1200.0) == (False, False)


def test_two_cycles_of_difference_are_tolerated_only_if_configured() -> None:
    two = Replicas(replace(SET, replica_cycles_max=2), check_of())

    def cycle(emergency_mps: float) -> bool:
        return two.agree(emergency_mps, at(1000.0), 15.0, FAR_M)

    assert two.exceeded is False, "nothing was said before the first cycle"
    assert [cycle(10.0) for _ in range(4)] == [True, True, False, False]
    assert [cycle(42.0), *(cycle(10.0) for _ in range(3))] == [True, True, True, False]
