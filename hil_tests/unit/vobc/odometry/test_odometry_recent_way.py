"""The distance over ground since an instant in the last cycles, against randomly sampled speeds."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vobc.odometry.recent_way import RecentWay

MOST_MPS2 = 1.7
PARTS = 20
"""Parts of a cycle, in each of which the train may accelerate differently."""


def way(*steps: tuple[float, float, float]) -> RecentWay:
    made = RecentWay(MOST_MPS2)
    for dt_s, least_m, most_m in steps:
        made.add(dt_s, least_m, most_m)
    return made


def near(low_m: float, high_m: float) -> object:
    return pytest.approx((low_m, high_m), abs=1e-12)


def test_whole_cycles_are_added_up_from_the_last_one_back() -> None:
    made = way((0.1, 1.0, 2.0), (0.2, 10.0, 30.0), (0.1, 0.25, 0.5))

    assert made.since(0.0) == near(0.0, 0.0)
    assert made.since(0.1) == near(0.25, 0.5)
    assert made.since(0.3 - 1e-15) == near(10.25, 30.5)


def test_the_speed_in_part_of_a_cycle_may_differ_from_the_mean() -> None:
    """The last 0.15 s of a cycle of 0.2 s deviate by at most 1.7 / 2 * 0.15 * 0.05 m from their
    share."""
    made = way((0.2, 10.0, 30.0), (0.1, 0.25, 0.5))

    assert made.since(0.25) == near(0.25 + 7.5 - 0.006375, 0.5 + 22.5 + 0.006375)
    assert made.since(0.15) == near(0.25 + 2.5 - 0.006375, 0.5 + 7.5 + 0.006375)


def test_no_distance_is_known_from_before_the_oldest_kept_cycle() -> None:
    made = way((0.1, 1.0, 2.0))
    assert made.since(0.05) is not None
    assert made.since(0.1) is None
    assert made.since(5.0) is None
    made.forget()
    assert made.since(0.0) is None


def test_the_number_of_kept_cycles_is_bounded() -> None:
    """64 cycles of an eighth of a second make 8 s."""
    made = way(*[(0.125, 1.0, 1.0)] * 200)

    assert made.since(7.95) is not None
    assert made.since(8.0) is None


def test_a_cycle_of_zero_duration_adds_its_distance() -> None:
    """The very first cycle takes no time."""
    assert way((0.1, 1.0, 2.0), (0.0, 0.0, 0.0)).since(0.0) == near(0.0, 0.0)


@given(
    begin_mps=st.floats(-3.0, 20.0),
    accel_mps2=st.lists(st.floats(-MOST_MPS2, MOST_MPS2), min_size=PARTS, max_size=5 * PARTS),
    cycle_s=st.floats(0.01, 0.2),
    share=st.floats(0.0, 1.0, exclude_max=True),
)
def test_no_train_leaves_the_bounds_within_a_cycle(
    begin_mps: float, accel_mps2: list[float], cycle_s: float, share: float
) -> None:
    """The estimate receives the exact distance of each cycle and nothing else."""
    cycles = len(accel_mps2) // PARTS
    part_s = cycle_s / PARTS
    speeds_mps = begin_mps + part_s * np.cumsum([0.0, *accel_mps2[: cycles * PARTS]])
    parts_m = [0.5 * part_s * (one + other) for one, other in pairwise(speeds_mps)]
    made = RecentWay(MOST_MPS2)
    for cycle in range(cycles):
        moved_m = math.fsum(parts_m[cycle * PARTS : (cycle + 1) * PARTS])
        made.add(cycle_s, moved_m, moved_m)

    back = round(share * (cycles * PARTS - 1))
    told = made.since(back * part_s)

    assert told is not None
    true_m = math.fsum(parts_m[len(parts_m) - back :])
    assert told[0] - 1e-9 <= true_m <= told[1] + 1e-9


def test_the_bounds_within_a_cycle_are_reached_at_maximum_acceleration() -> None:
    """From standstill at 1.7 m/s² for 0.2 s the train runs 34 mm, of which 25.5 mm are in the
    last half."""
    made = way((0.2, 0.034, 0.034))

    told = made.since(0.1)
    assert told is not None
    assert told[1] == pytest.approx(0.0255)
    assert told[0] == pytest.approx(0.0085)
