"""The ceiling of a line against hand calculations, and how much of the line it evaluates."""

from dataclasses import replace

import pytest

from can_dbc.vobc import TargetKind
from metro_hil.metrics.worst_motion import CONFIG, FAR_M, GRAVITY_MPS2, Section, line_of
from vobc.atp.braking import SafeBraking
from vobc.atp.ceiling import CeilingMap
from vobc.atp.profile import BrakingProfile
from vobc.vocabulary import Ceiling, Interval, Restriction, SupervisedTarget

LENGTH_M = 64.0
SET = replace(
    CONFIG,
    warning_margin_mps=0.5,
    service_margin_mps=1.0,
    emergency_margin_mps=2.0,
    service_lead_s=0.5,
    warning_lead_s=0.25,
    permitted_lead_s=0.75,
    interval_step_m=0.5,
)
LEADS_S = (1.5, 0.75, 0.5, 0.0)
"""The permitted speed leads the warning by 0.75 s; the warning leads the service brake by 0.25
s."""
MARGINS_MPS = (0.0, 0.5, 1.0, 2.0)
BRAKING = SafeBraking(guaranteed_decel_mps2=1.0, runaway_mps2=1.0, runaway_s=1.0, build_up_s=2.0)
HALF = -0.5 * 1000.0 / GRAVITY_MPS2
"""Gradient in per mille whose downhill force takes 0.5 m/s²."""
PROFILES_KEPT = 256


def map_of(
    *speed_limits: Section, gradients: tuple[Section, ...] = (), braking: SafeBraking = BRAKING
) -> CeilingMap:
    return CeilingMap(SET, braking, line_of(gradients, speed_limits), train_length_m=LENGTH_M)


def at(front_m: float) -> Interval:
    return Interval(front_m, front_m, front_m)


def four(ceiling: Ceiling) -> tuple[float, float, float, float]:
    return (
        ceiling.permitted_mps,
        ceiling.warning_mps,
        ceiling.service_mps,
        ceiling.emergency_mps,
    )


def needed_m(speed_mps: float, *, target_mps: float, lead_s: float) -> float:
    """Braking distance on the level: the 3 s of reaction take 2.5 m more than at constant speed."""
    braked_m = 0.5 * ((speed_mps + 1.0) ** 2 - target_mps**2)
    return speed_mps * (lead_s + 3.0) + 2.5 + braked_m


def uniform(limit_mps: float) -> tuple[float, float, float, float]:
    permitted, warning, service, emergency = MARGINS_MPS
    return limit_mps + permitted, limit_mps + warning, limit_mps + service, limit_mps + emergency


OPEN = map_of((0.0, 6000.0, 20.0))


@pytest.mark.parametrize("index", range(4))
def test_each_of_the_four_speeds_stops_at_the_end_of_authority_after_its_own_lead(
    index: int,
) -> None:
    """From 10 m/s the emergency limit needs 93 m, and each second of lead 10 m more. There is no
    margin."""
    end_m = 1000.0 + needed_m(10.0, target_mps=0.0, lead_s=LEADS_S[index])

    ceiling = OPEN.at(at(1000.0), end_m)

    assert four(ceiling)[index] == pytest.approx(10.0)
    assert ceiling.distance_to_authority_m == end_m - 1000.0


@pytest.mark.parametrize("index", range(4))
@pytest.mark.parametrize("temporary", [True, False])
def test_each_of_the_four_speeds_meets_a_lower_limit_plus_its_own_margin(
    temporary: bool, index: int
) -> None:
    target_mps = 6.0 + MARGINS_MPS[index]
    at_m = 1000.0 + needed_m(12.0, target_mps=target_mps, lead_s=LEADS_S[index])
    slow = Restriction(at_m, 5000.0, 6.0)
    civil = map_of((0.0, at_m, 20.0), (at_m, 6000.0, 6.0))

    ceiling = (OPEN if temporary else civil).at(at(1000.0), FAR_M, (slow,) if temporary else ())

    assert four(ceiling)[index] == pytest.approx(12.0)


def test_without_a_restriction_the_four_speeds_exceed_the_limit_by_their_margins() -> None:
    assert OPEN.at(at(1000.0), FAR_M) == Ceiling(*uniform(20.0), FAR_M - 1000.0)


def test_the_target_is_the_one_that_lowers_the_permitted_speed_most() -> None:
    """The line's limit falls at 1400 m, the restriction at 1300 m, the authority ends later."""
    civil = map_of((0.0, 1400.0, 20.0), (1400.0, 6000.0, 6.0))
    slow = (Restriction(1300.0, 1350.0, 8.0),)

    def target(front: Interval, end_m: float, extra: tuple[Restriction, ...] = ()) -> object:
        return civil.at(front, end_m, extra).target

    near = Interval(1290.0, 1295.0, 1298.0)
    assert target(near, FAR_M) == SupervisedTarget(TargetKind.LINE_LIMIT, 6.0, 102.0)
    assert target(near, FAR_M, slow) == SupervisedTarget(TargetKind.RESTRICTION, 8.0, 2.0)
    assert target(near, 1340.0, slow) == SupervisedTarget(TargetKind.END, 0.0, 42.0)
    assert target(at(200.0), FAR_M, slow) is None, "no curve is lower than the limit here"
    bite_m = needed_m(19.9 + MARGINS_MPS[0], target_mps=6.0 + MARGINS_MPS[0], lead_s=LEADS_S[0])
    assert target(at(1400.0 - bite_m), FAR_M) is not None, "only the permitted speed is lower"
    assert target(at(1400.0), FAR_M) is None, "the limit under the train is no target"
    assert target(at(1342.5), 1340.0) == SupervisedTarget(TargetKind.END, 0.0, -2.5)


def test_a_target_that_lowers_only_the_upper_limits_is_not_shown() -> None:
    """Its permitted speed is its limit, which already holds under the train."""
    level = map_of((0.0, 6000.0, 6.0))
    equal = (Restriction(1010.0, 1100.0, 6.0),)

    assert level.at(at(1000.0), FAR_M, equal).target is None


def test_a_metre_before_the_end_a_slow_train_is_still_permitted() -> None:
    at_once = map_of((0.0, 6000.0, 20.0), braking=SafeBraking(1.0, 0.0, 0.0, 0.0))

    assert at_once.at(at(999.5), 1000.0).emergency_mps == pytest.approx(1.0)
    assert at_once.at(at(1000.0), 1000.0).emergency_mps == 0.0


def test_a_limit_counts_from_the_front_at_its_start_to_the_rear_at_its_end() -> None:
    civil = map_of((0.0, 1000.0, 20.0), (1000.0, 1100.0, 6.0), (1100.0, 6000.0, 20.0))
    slow = Restriction(1000.0, 1100.0, 6.0)

    for ceilings, extra in ((civil, ()), (OPEN, (slow,))):
        for front_m in (1000.0, 1100.0, 1163.999):
            assert four(ceilings.at(at(front_m), FAR_M, extra)) == uniform(6.0)
        assert four(ceilings.at(at(1164.0), FAR_M, extra)) == uniform(20.0)
        unsure = Interval(1163.0, 1180.0, 1190.0)
        assert four(ceilings.at(unsure, FAR_M, extra)) == uniform(6.0)


def test_a_limit_higher_than_the_one_before_it_has_no_effect() -> None:
    stairs = map_of((0.0, 1000.0, 6.0), (1000.0, 1200.0, 9.0), (1200.0, 6000.0, 20.0))

    for front_m in (900.0, 999.0):
        assert four(stairs.at(at(front_m), FAR_M)) == uniform(6.0)
    assert four(stairs.at(at(1100.0), FAR_M)) == uniform(9.0)


def test_a_lower_limit_behind_a_low_one_counts_too() -> None:
    """The limits are 6 m/s in 30 m and then 2 m/s, which determines the emergency limit here."""
    second_m = 1000.0 + needed_m(7.0, target_mps=4.0, lead_s=0.0)
    stairs = map_of((0.0, 1030.0, 20.0), (1030.0, second_m, 6.0), (second_m, 6000.0, 2.0))

    assert stairs.at(at(1000.0), FAR_M).emergency_mps == pytest.approx(7.0)


def test_an_interval_of_nine_tenths_of_a_metre_counts_as_one_metre() -> None:
    """The rear leaves the fall at most 65 m after its end: 64 m of train and 1 m of interval."""
    fall = map_of((0.0, 6000.0, 20.0), gradients=((900.0, 1000.0, HALF),))

    def emergency_mps(width_m: float, front_m: float) -> float:
        front = Interval(front_m - width_m, front_m, front_m)
        return fall.at(front, front_m + 93.0).emergency_mps

    assert emergency_mps(0.9, 1065.0) == pytest.approx(10.0), "off it"
    assert emergency_mps(0.9, 1064.8) < 9.999, "0.2 m to go"
    assert emergency_mps(0.5, 1064.5) == pytest.approx(10.0), "a step counts as one step"
    assert emergency_mps(0.5, 1064.3) < 9.999
    assert emergency_mps(0.0, 1064.0) == pytest.approx(10.0), "a known place is no wider"
    assert emergency_mps(0.0, 1063.8) < 9.999


@pytest.mark.parametrize("top_mps", [20.0, 30.0])
def test_an_end_of_authority_counts_as_soon_as_it_binds(top_mps: float) -> None:
    """The line has one fast section; the test moves the end of authority towards the train."""
    ceilings = map_of((0.0, 500.0, 5.0), (500.0, 5000.0, top_mps), (5000.0, 6000.0, 3.0))
    binds_m = needed_m(top_mps + 2.0, target_mps=0.0, lead_s=0.0)

    for way_m in range(20, int(binds_m)):
        emergency_mps = ceilings.at(at(1000.0), 1000.0 + way_m).emergency_mps
        stop_m = needed_m(emergency_mps, target_mps=0.0, lead_s=0.0)
        assert stop_m == pytest.approx(way_m, abs=1e-6)


def test_an_end_of_authority_binds_in_time_where_only_part_of_the_line_falls() -> None:
    """The brake has 0.5 m/s² left. The train runs at 22 m/s, and at 24.5 m/s when the brake
    acts."""
    ceilings = map_of((0.0, 6000.0, 20.0), gradients=((500.0, 5000.0, HALF),))
    reaction_m = 22.0 + 0.5 * 1.5 + 2.0 * (22.0 + 1.5) + 0.5 * 0.5 * 4.0
    binds_m = reaction_m + 24.5**2

    seen = ceilings.at(at(1000.0), 1000.0 + binds_m - 1.0)
    free = ceilings.at(at(1000.0), 1000.0 + binds_m + 1.0)

    assert 21.9 < seen.emergency_mps < 22.0
    assert free.emergency_mps == 22.0


class Counted:
    """Counts how many profiles the ceiling evaluates and creates."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.asked, self.made = 0, 0
        asked, made = BrakingProfile.speed_mps, BrakingProfile.__init__

        def count_asked(*args: float, **named: float) -> float:
            self.asked += 1
            return asked(*args, **named)  # type: ignore[arg-type]

        def count_made(*args: float, **named: float) -> None:
            self.made += 1
            made(*args, **named)  # type: ignore[arg-type]

        patch.setattr(BrakingProfile, "speed_mps", count_asked)
        patch.setattr(BrakingProfile, "__init__", count_made)


def test_restrictions_that_cannot_bind_yet_cost_no_curve(monkeypatch: pytest.MonkeyPatch) -> None:
    """Four curves lead to restrictions near ahead. Those far away, behind, or without effect
    cost none."""
    sections: list[Section] = [(0.0, 1100.0, 20.0), (1100.0, 2500.0, 15.0)]
    sections += [(2500.0 + 100.0 * n, 2600.0 + 100.0 * n, 14.0 - n % 2) for n in range(30)]
    ceilings = map_of(*sections)
    far = tuple(Restriction(3000.0 + n, 3001.0 + n, 5.0) for n in range(10))
    behind = Restriction(100.0, 200.0, 5.0)
    counted = Counted(monkeypatch)

    ceilings.at(at(1000.0), FAR_M, (*far, behind))

    assert counted.asked == 4
    ceilings.at(at(1000.0), 1300.0, (*far, Restriction(1200.0, 1250.0, 5.0)))
    assert counted.asked == 4 + 3 * 4


def test_the_number_of_cached_profiles_is_bounded(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    counted = Counted(monkeypatch)
    ceilings = map_of((0.0, 6000.0, 20.0))

    def look(steps: int) -> None:
        ceilings.at(Interval(3000.0 - 0.5 * steps, 3000.0, 3000.0), FAR_M)

    for steps in [*range(PROFILES_KEPT), *range(PROFILES_KEPT)]:
        look(steps)
    assert counted.made == PROFILES_KEPT, "each made once"
    look(PROFILES_KEPT)
    look(0)
    assert counted.made == PROFILES_KEPT + 2, "the cache was full, so the profile was made again"
