"""Whether known trains account for all axles between two places, against a second, iterative
computation."""

import itertools
from collections.abc import Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vobc.train_to_train.authority import Counted, StandingTrain, all_explained


def touches(section: Counted, train: StandingTrain) -> bool:
    return section.start_m < train.front_m and train.rear_m < section.end_m


def is_explained(
    run: Sequence[Counted], trains: Sequence[StandingTrain], seen_m: tuple[float, float]
) -> bool:
    """The same rule for trains at rest.

    No train comes or leaves. A train that extends beyond the counted track accounts for no axles.
    """
    if any(each.occupied and not each.axles for each in run):
        return False
    there = [each for each in trains if run[0].start_m < each.middle_m < run[-1].end_m]
    if any(each.rear_m < seen_m[0] or seen_m[1] < each.front_m for each in there):
        return False
    for at in range(len(run)):
        counted = sum(each.axles for each in run[: at + 1])
        joint_m = run[at].end_m
        if counted < sum(each.axles for each in there if each.front_m <= joint_m):
            return False
        if counted > sum(each.axles for each in there if each.rear_m < joint_m):
            return False
    return sum(each.axles for each in run) == sum(each.axles for each in there)


def step_by_step(
    sections: Sequence[Counted], standing: Sequence[StandingTrain], from_m: float, to_m: float
) -> bool:
    """Iterative computation: a train in a concerned section makes every section under it
    concerned."""
    there: list[StandingTrain] = []
    while True:
        concerned = [each for each in sections if each.end_m > from_m and each.start_m < to_m]
        now = [train for train in standing if any(touches(each, train) for each in concerned)]
        if len(now) == len(there):
            break
        there = now
        from_m = min([from_m, *[each.rear_m for each in there]])
        to_m = max([to_m, *[each.front_m for each in there]])
    runs = [list(run) for _, run in itertools.groupby(concerned, key=lambda each: each.occupied)]
    return all(is_explained(run, there, (sections[0].start_m, sections[-1].end_m)) for run in runs)


@st.composite
def tracks(draw: st.DrawFn) -> list[Counted]:
    """Sections in running order, some of them unreported."""
    made, at_m = [], 0.0
    for _ in range(draw(st.integers(0, 8))):
        length_m = float(draw(st.integers(1, 6)))
        axles = draw(st.sampled_from([0, 0, 2, 2, 4]))
        occupied = axles > 0 or draw(st.integers(0, 9)) == 0
        if draw(st.integers(0, 7)):
            made.append(Counted(at_m, at_m + length_m, occupied, axles))
        at_m += length_m
    return made


trains = st.lists(
    st.tuples(st.integers(-4, 40), st.integers(0, 7), st.sampled_from([2, 2, 4])).map(
        lambda drawn: StandingTrain(0.5 * drawn[0], 0.5 * drawn[0] + drawn[1], drawn[2])
    ),
    max_size=7,
)


@settings(max_examples=400, deadline=None)
@given(tracks(), trains, st.integers(-4, 60), st.integers(0, 30))
def test_the_result_equals_the_iterative_computation(
    sections: list[Counted], standing: list[StandingTrain], from_m: int, length_m: int
) -> None:
    start_m, end_m = 0.5 * from_m, 0.5 * (from_m + length_m)
    wanted = step_by_step(sections, standing, start_m, end_m)
    for order in (standing, standing[::-1]):
        assert all_explained(sections, order, from_m=start_m, to_m=end_m) is wanted


def test_a_run_extends_both_ways_while_trains_stand_on_joints() -> None:
    """Ten sections of 10 m with a train of 2 axles on each joint; the check starts in the
    middle."""
    middle = {"from_m": 45.0, "to_m": 55.0}
    standing = [StandingTrain(10.0 * n - 4.0, 10.0 * n + 4.0, 2) for n in range(1, 10)]
    axles = [1, *(2 for _ in range(8)), 1]
    sections = [Counted(10.0 * n, 10.0 * n + 10.0, True, axles[n]) for n in range(10)]
    more = sections[-1]._replace(axles=2)

    assert all_explained(sections, standing, **middle)
    assert not all_explained([*sections[:-1], more], standing, **middle), "19 axles are not 18"
    assert not all_explained(sections, standing[1:], **middle), "one at the rear is not told of"


@pytest.mark.parametrize(
    ("sections", "standing", "between_m"),
    [
        # The run ends where the first of the trains begins; the axles behind do not belong to them.
        (
            [Counted(0.0, 2.0, True, 4), Counted(2.0, 4.0, False, 0)],
            [StandingTrain(0.0, 2.0, 2)],
            (2.0, 4.0),
        ),
        # The last train that the computation finds stands behind a section reported as clear.
        (
            [
                Counted(0.0, 2.0, True, 2),
                Counted(2.0, 4.0, False, 0),
                Counted(4.0, 6.0, True, 2),
                Counted(6.0, 8.0, True, 2),
            ],
            [StandingTrain(0.5, 2.5, 2), StandingTrain(3.5, 5.5, 2), StandingTrain(5.5, 6.5, 2)],
            (4.5, 5.5),
        ),
    ],
)
def test_the_result_does_not_depend_on_the_order_of_the_trains(
    sections: list[Counted], standing: list[StandingTrain], between_m: tuple[float, float]
) -> None:
    from_m, to_m = between_m
    assert step_by_step(sections, standing, from_m, to_m)
    assert all_explained(sections, standing, from_m=from_m, to_m=to_m)
