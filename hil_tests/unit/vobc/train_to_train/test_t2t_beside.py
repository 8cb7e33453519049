"""A train that has stood for long reports itself to the adjacent areas, so that their masters
can account for its axles."""

import pytest

from hil_tests.unit.vobc.train_to_train.t2t_chair import Chair
from hil_tests.unit.vobc.train_to_train.test_t2t_train import Ride, beat, ns
from zenoh_config.t2t import BROADCAST, NO_TRAIN

LONG_MS = 20_000
PERIOD_MS = 200
"""Report period of such a train: two cycles, ms."""


def standing(front_m: float, *areas: int) -> Ride:
    """A train that has stood for long since its start; a master commands each of these areas."""
    ride = Ride()
    ride.step(0, front_m=front_m, standstill=True)
    ride.step(LONG_MS, front_m=front_m, standstill=True)
    ride.step(LONG_MS, *[beat(area) for area in areas], front_m=front_m, standstill=True)
    return ride


def told(ride: Ride, at_ms: float, front_m: float, area: int, *, standstill: bool = True) -> bool:
    stepped = ride.step(at_ms, front_m=front_m, standstill=standstill)
    return bool(ride.reports(stepped, area))


@pytest.mark.parametrize(
    ("front_m", "area", "tells"),
    [
        (500.0, 2, True),
        (500.0, 3, False),  # That area is not next to its own.
        (3000.0, 1, True),
        (3000.0, 3, True),
        (5500.0, 2, True),
        (5500.0, 1, False),
    ],
)
def test_a_train_that_has_stood_for_long_reports_to_the_adjacent_areas(
    front_m: float, area: int, *, tells: bool
) -> None:
    ride = standing(front_m, 1, 2, 3)

    assert told(ride, LONG_MS + PERIOD_MS, front_m, area) is tells


def test_the_report_holds_its_place_and_term_and_nothing_about_its_neighbours() -> None:
    ride = Ride()
    ride.step(0, standstill=True)
    ride.step(LONG_MS, standstill=True)

    stepped = ride.step(LONG_MS, beat(2, term=6), standstill=True)

    (report,) = ride.reports(stepped, 2)
    assert (report.term, report.destination, report.echo_ns) == (6, BROADCAST, 77)
    assert (report.front_max_m, report.rear_min_m, report.standstill) == (500.0, 420.0, True)
    assert (report.comes_from, report.behind, report.member) == (0, NO_TRAIN, False)
    assert dict(stepped.roles).get(2) is None


def test_it_reports_half_as_often_as_a_member_and_on_time() -> None:
    ride = standing(500.0, 2)
    due_ms = [at_ms for at_ms in range(LONG_MS + 1, LONG_MS + 501) if told(ride, at_ms, 500.0, 2)]
    assert due_ms == [LONG_MS + PERIOD_MS, LONG_MS + 2 * PERIOD_MS]

    ride = standing(500.0, 2)
    at_ns, found = ns(LONG_MS), list[int]()
    while not found and at_ns < ns(LONG_MS + 1000):
        at_ns = ride.core.next_due_ns()
        found += [at_ns] if told(ride, at_ns / 1e6, 500.0, 2) else []
    # Its own area makes it run a step every 100 ms.
    assert ns(LONG_MS + PERIOD_MS) <= found[0] < ns(LONG_MS + PERIOD_MS + 100)


def test_an_area_without_a_master_gets_no_report_and_causes_no_step() -> None:
    ride = standing(500.0)
    steps, at_ns = 0, ns(LONG_MS)
    while at_ns < ns(LONG_MS + 1000):
        at_ns = ride.core.next_due_ns()
        assert not told(ride, at_ns / 1e6, 500.0, 2)
        steps += 1
    assert steps < 30


@pytest.mark.parametrize(("stands_ms", "tells"), [(LONG_MS - 1, False), (LONG_MS, True)])
def test_a_movement_restarts_the_standing_time(stands_ms: float, *, tells: bool) -> None:
    ride = standing(500.0, 2)
    moved_ms = LONG_MS + 1000
    assert told(ride, moved_ms, 500.0, 2, standstill=False) is False

    assert told(ride, moved_ms + stands_ms, 500.0, 2) is tells


def test_a_lost_train_does_not_report_and_its_standing_time_restarts() -> None:
    ride = standing(500.0, 2)

    stepped = ride.step(LONG_MS + PERIOD_MS, localised=False, standstill=True)

    assert ride.reports(stepped, 2) == []
    assert told(ride, LONG_MS + 2 * PERIOD_MS, 500.0, 2) is False


@pytest.mark.parametrize(
    ("front_m", "applies"), [(1199.9, False), (1200.0, True), (1500.0, True), (4090.0, False)]
)
def test_a_train_far_before_an_area_does_not_apply_but_accounts_for_axles(
    front_m: float, *, applies: bool
) -> None:
    """A train applies for the roster only within 800 m before the area."""
    chair = Chair((), area=2, sections=True)
    chair.reports(3, front_m)

    assert (3 in chair.master._applicants) is applies
    assert [each.source for each, _ in chair.master._around._passed.values()] == (
        [] if applies else [3]
    )
