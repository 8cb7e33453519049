"""Braking distances of protection against the declared worst motion, summed in small steps."""

import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from firmware_py.trackdb import LineMap
from metro_hil.metrics.worst_motion import (
    CONFIG,
    FAR_M,
    GRAVITY_MPS2,
    KMH,
    STEP_S,
    Section,
    WorstCase,
    ceilings,
    declared_reach_m,
    fastest_by_halving,
    intervals,
    line_of,
    sections,
    steps_blur_m,
    worst_stop_m,
)
from vobc.atp.braking import SafeBraking
from vobc.vocabulary import Interval

OVERSPEED_MPS = 8.0 * KMH
SHIPPED = WorstCase.of(CONFIG)
PUBLISHED_M = {
    (20.0, 0.0): 41.0,
    (20.0, -30.0): 58.0,
    (40.0, 0.0): 107.0,
    (40.0, -30.0): 151.0,
    (60.0, 0.0): 204.0,
    (60.0, -30.0): 288.0,
    (80.0, 0.0): 333.0,
    (80.0, -30.0): 468.0,
}
"""Braking distance in m by speed in km/h and gradient in per mille: the IEEE 1474.1 model with a
GEBR of 1.0 m/s²."""
PUBLISHED_CASE = WorstCase(
    runaway_mps2=0.9, runaway_s=0.3, build_up_s=0.75, guaranteed_decel_mps2=1.0
)
WARNING_LEAD_S = CONFIG.service_lead_s + CONFIG.warning_lead_s
PERMITTED_LEAD_S = WARNING_LEAD_S + CONFIG.permitted_lead_s
SLACK_MPS = 1e-5
ROUNDING_M = 1e-8
"""Rounding error of about a thousand additions to a chainage of some thousand metres, m."""
LONGER_M = 1e-4
"""Search tolerance as distance, m. Protection finds the speed within 1e-6 m/s on the safe side;
the time to stop converts this."""
gradient_profiles = st.lists(
    st.tuples(
        st.sampled_from([0.0, 0.0, 3.0, 120.0]), st.floats(5.0, 400.0), st.floats(-40.0, 40.0)
    ),
    max_size=12,
).map(sections)


def endless(gradient_permille: float) -> LineMap:
    return line_of(((0.0, 6000.0, gradient_permille),), ((0.0, 6000.0, 40.0),))


@pytest.mark.parametrize(("kmh", "gradient_permille"), list(PUBLISHED_M))
def test_the_published_distances_follow_within_two_metres_from_eight_kmh_overspeed(
    kmh: float, gradient_permille: float
) -> None:
    published_m = PUBLISHED_M[kmh, gradient_permille]
    case = PUBLISHED_CASE
    curve = SafeBraking(1.0, case.runaway_mps2, case.runaway_s, case.build_up_s).on(
        gradient_permille
    )

    replayed_m = worst_stop_m(
        endless(gradient_permille), case, 1000.0, kmh * KMH + OVERSPEED_MPS, reach_m=100.0
    )

    assert replayed_m == pytest.approx(published_m, abs=2.0)
    assert curve.speed_mps(replayed_m, target_mps=0.0) == pytest.approx(
        kmh * KMH + OVERSPEED_MPS, abs=0.01
    )


def test_without_the_overspeed_no_reaction_time_gives_the_published_distances() -> None:
    """For every plausible runaway, cut and build-up, at least one distance computed from the
    bare speed is off."""

    def worst_off_m(case: WorstCase, over_mps: float) -> float:
        offs_m = []
        for (kmh, gradient_permille), published_m in PUBLISHED_M.items():
            fall_mps2 = -GRAVITY_MPS2 * gradient_permille / 1000.0
            first_mps = kmh * KMH + over_mps
            cut_mps = first_mps + (case.runaway_mps2 + fall_mps2) * case.runaway_s
            bite_mps = cut_mps + fall_mps2 * case.build_up_s
            way_m = 0.5 * (first_mps + cut_mps) * case.runaway_s
            way_m += 0.5 * (cut_mps + bite_mps) * case.build_up_s
            way_m += bite_mps**2 / (2.0 * (1.0 - fall_mps2))
            offs_m.append(abs(way_m - published_m))
        return max(offs_m)

    cases = [
        WorstCase(0.1 * push, 0.05 * cut, 0.05 * build, 1.0)
        for push in range(8, 13)
        for cut in range(30)
        for build in range(30)
    ]

    assert min(worst_off_m(case, 0.0) for case in cases) > 2.0
    assert min(worst_off_m(case, OVERSPEED_MPS) for case in cases) < 2.0


@pytest.mark.parametrize(("kmh", "gradient_permille"), list(PUBLISHED_M))
def test_the_shipped_parameters_never_assume_less_than_the_published_distance(
    kmh: float, gradient_permille: float
) -> None:
    """Example: at 80 + 8 km/h on -30 per mille the curve begins at 468 m or earlier."""
    ceiling_map = ceilings(endless(gradient_permille), length_m=68.59)
    front_m = intervals(1000.0, 0.0, 0.0)
    speed_mps = kmh * KMH + OVERSPEED_MPS

    point_m = fastest_by_halving(
        speed_mps,
        lambda away_m: ceiling_map.at(front_m, front_m.high + away_m).emergency_mps,
        top_mps=1000.0,
    )

    assert point_m >= PUBLISHED_M[kmh, gradient_permille]
    assert point_m == pytest.approx(
        worst_stop_m(endless(gradient_permille), SHIPPED, 1000.0, speed_mps, reach_m=68.59),
        rel=0.001,
    )


@given(
    gradients=gradient_profiles,
    front_m=st.floats(50.0, 2500.0),
    to_end_m=st.floats(1.0, 600.0),
    length_m=st.floats(18.0, 160.0),
    below_m=st.floats(0.0, 12.0),
    above_m=st.floats(0.0, 12.0),
)
def test_from_each_limit_after_its_lead_the_worst_motion_needs_exactly_the_distance_left(
    gradients: tuple[Section, ...],
    front_m: float,
    to_end_m: float,
    length_m: float,
    below_m: float,
    above_m: float,
) -> None:
    line = line_of(gradients, ((0.0, 6000.0, 60.0),))
    interval = intervals(front_m, below_m, above_m)

    assert_each_limit_needs_the_whole_way(line, interval, to_end_m, length_m)


@example(front_m=100.0, to_edge_m=40.0, to_end_m=300.0, before_permille=-1.0, after_permille=-40.0)
@given(
    front_m=st.floats(100.0, 200.0),
    to_edge_m=st.floats(-100.0, 90.0),
    to_end_m=st.floats(20.0, 400.0),
    before_permille=st.floats(-40.0, 0.0),
    after_permille=st.floats(-40.0, 0.0),
)
def test_a_fall_that_changes_in_the_lead_or_the_reaction_counts_from_there_on(
    front_m: float,
    to_edge_m: float,
    to_end_m: float,
    before_permille: float,
    after_permille: float,
) -> None:
    """The front or the rear of a train of 60 m reaches the edge during the worst-case motion."""
    edge_m = front_m + to_edge_m
    gradients = sections([(0.0, edge_m, before_permille), (0.0, 3000.0, after_permille)])
    line = line_of(gradients if edge_m > 0.0 else (), ((0.0, 6000.0, 60.0),))

    assert_each_limit_needs_the_whole_way(line, intervals(front_m, 0.0, 0.0), to_end_m, 60.0)


def assert_each_limit_needs_the_whole_way(
    line: LineMap,
    interval: Interval,
    to_end_m: float,
    length_m: float,
) -> None:
    """Check that each of the four limits, after its lead, needs the whole distance. A limit of
    zero needs none."""
    ceiling = ceilings(line, length_m=length_m).at(interval, interval.high + to_end_m)
    reach_m = declared_reach_m(interval, length_m)
    for speed_mps, lead_s in (
        (ceiling.emergency_mps, 0.0),
        (ceiling.service_mps, CONFIG.service_lead_s),
        (ceiling.warning_mps, WARNING_LEAD_S),
        (ceiling.permitted_mps, PERMITTED_LEAD_S),
    ):
        needed_m = worst_stop_m(
            line, SHIPPED, interval.high, speed_mps, reach_m=reach_m, lead_s=lead_s
        )
        assert needed_m <= to_end_m + ROUNDING_M or speed_mps == 0.0
        assert needed_m >= to_end_m - LONGER_M


@given(
    gradients=gradient_profiles,
    front_m=st.floats(50.0, 2500.0),
    to_limit_m=st.floats(20.0, 500.0),
    limit_mps=st.floats(2.0, 18.0),
    length_m=st.floats(18.0, 160.0),
)
def test_from_the_limit_the_worst_motion_just_meets_a_lower_limit_where_it_begins(
    gradients: tuple[Section, ...],
    front_m: float,
    to_limit_m: float,
    limit_mps: float,
    length_m: float,
) -> None:
    at_m = front_m + to_limit_m
    line = line_of(gradients, ((0.0, at_m, 60.0), (at_m, 6000.0, limit_mps)))
    target_mps = limit_mps + CONFIG.emergency_margin_mps

    ceiling = ceilings(line, length_m=length_m).at(intervals(front_m, 0.0, 0.0), FAR_M)

    speed_mps = ceiling.emergency_mps
    assume(speed_mps > target_mps)
    needed_m = worst_stop_m(
        line, SHIPPED, front_m, speed_mps, reach_m=length_m, target_mps=target_mps
    )
    assert to_limit_m - LONGER_M <= needed_m <= to_limit_m + ROUNDING_M


@given(
    gradients=gradient_profiles,
    front_m=st.floats(50.0, 2500.0),
    to_end_m=st.floats(1.0, 500.0),
    length_m=st.floats(18.0, 160.0),
    width_m=st.floats(0.0, 20.0),
    inside_ratio=st.floats(0.0, 1.0),
    slower_ratio=st.floats(0.3, 1.0),
    quicker_ratio=st.floats(0.0, 1.0),
)
def test_no_front_of_the_interval_that_is_slower_or_brakes_sooner_passes_its_authority(
    gradients: tuple[Section, ...],
    front_m: float,
    to_end_m: float,
    length_m: float,
    width_m: float,
    inside_ratio: float,
    slower_ratio: float,
    quicker_ratio: float,
) -> None:
    """The worst-case train has one place in the interval, the mean gradient under it and any
    quicker reaction."""
    line = line_of(gradients, ((0.0, 6000.0, 40.0),))
    interval = intervals(front_m + width_m, width_m, 0.0)
    end_m = interval.high + to_end_m

    limit_mps = ceilings(line, length_m=length_m).at(interval, end_m).emergency_mps

    assume(limit_mps > 0.0)
    at_m, speed_mps = front_m + inside_ratio * width_m, limit_mps * slower_ratio
    runaway_s = SHIPPED.runaway_s * quicker_ratio
    bites_s = runaway_s + SHIPPED.build_up_s * quicker_ratio
    time_s, step_s = 0.0, 2.0 * STEP_S
    while speed_mps > 0.0:
        push_mps2 = 1.0 if time_s < runaway_s else 0.0 if time_s < bites_s else -1.0
        rise_permille = line.mean_gradient_permille(at_m - length_m, at_m)
        accel_mps2 = push_mps2 - GRAVITY_MPS2 * rise_permille / 1000.0
        at_m += speed_mps * step_s
        speed_mps += accel_mps2 * step_s
        time_s += step_s
    assert at_m <= end_m + step_s * (limit_mps + 2.0) + steps_blur_m(limit_mps)


@pytest.mark.parametrize("to_end_m", [15.0, 40.0, 100.0, 200.0, 320.0, 450.0])
def test_the_permitted_speed_is_within_two_percent_of_the_best_possible(
    to_end_m: float,
) -> None:
    """The best train uses its whole lead, moves as badly as declared and stops at the last
    moment."""
    line = line_of((), ((0.0, 6000.0, 60.0),))
    best_mps = fastest_by_halving(
        to_end_m,
        lambda speed_mps: worst_stop_m(
            line, SHIPPED, 1000.0, speed_mps, reach_m=100.0, lead_s=PERMITTED_LEAD_S
        ),
    )

    ceiling = ceilings(line, length_m=68.59).at(intervals(1000.0, 0.0, 0.0), 1000.0 + to_end_m)

    assert 0.98 * best_mps <= ceiling.permitted_mps <= best_mps + 0.002


@given(
    gradients=gradient_profiles,
    front_m=st.floats(50.0, 2500.0),
    to_end_m=st.floats(0.5, 700.0),
    more_m=st.floats(0.0, 50.0),
    length_m=st.floats(18.0, 160.0),
)
def test_more_distance_never_lowers_a_limit(
    gradients: tuple[Section, ...],
    front_m: float,
    to_end_m: float,
    more_m: float,
    length_m: float,
) -> None:
    ceiling_map = ceilings(line_of(gradients), length_m=length_m)
    interval = intervals(front_m, 0.0, 0.0)

    near = ceiling_map.at(interval, front_m + to_end_m)
    far = ceiling_map.at(interval, front_m + to_end_m + more_m)

    assert far.emergency_mps >= near.emergency_mps - SLACK_MPS
    assert far.service_mps >= near.service_mps - SLACK_MPS
    assert far.warning_mps >= near.warning_mps - SLACK_MPS
    assert far.permitted_mps >= near.permitted_mps - SLACK_MPS
