"""How the predictive law reacts to slip, to brakes of other parts and to unknown brake delays."""

import dataclasses
from collections import deque
from typing import Any

import pytest

from firmware_py.trackdb import load_line
from hil_tests.unit.vobc.ato import ato_rig
from vobc.ato import Ato, AtoConfig
from vobc.ato.laws.law import Target
from vobc.ato.laws.predictive import Predictive
from vobc.ato.model.adhesion import AdhesionEstimate
from vobc.ato.settings.ato import BrakeBelief, SlipperyRail
from vobc.vocabulary import AtoInput

LINE = load_line("florence")
S = 1_000_000_000


def rig_to_iii(config: AtoConfig | None = None, **settings: Any) -> ato_rig.Rig:
    stop = dataclasses.replace(LINE.station("III"), dwell_s=1.0)
    ato = Ato(config or AtoConfig(), LINE, 3000.0, [stop, LINE.station("IV")])
    return ato_rig.Rig(ato, LINE, ato_rig.RigSettings(start_scale_known=True, **settings), 3000.0)


def law_of(rig: ato_rig.Rig) -> Predictive:
    law = rig.ato.strategy
    assert isinstance(law, Predictive)
    return law


def hardest_mps2(rig: ato_rig.Rig) -> float:
    return -min(demand.accel_mps2 for demand in rig.trace.demands)


def test_a_rail_counts_as_slippery_for_the_remembered_time_only() -> None:
    rail = AdhesionEstimate(AtoConfig(slippery=SlipperyRail(memory_s=100.0)), LINE)
    assert not rail.slippery

    rail.observe(10 * S, slips=True)
    assert rail.slippery
    assert rail.manner.config.braking.decel_mps2 == SlipperyRail().decel_mps2
    rail.observe(109 * S, slips=False)
    assert rail.slippery
    rail.observe(110 * S, slips=False)
    assert not rail.slippery
    assert rail.manner.config.braking.decel_mps2 == AtoConfig().braking.decel_mps2


SLIPPING = AtoInput(
    now_ns=10 * S,
    dt_s=0.05,
    enabled=True,
    front_m=3200.0,
    speed_mps=12.0,
    accel_mps2=-1.0,
    standstill=False,
    accepted_tag_ids=(),
    gradient_permille=0.0,
    ceiling_mps=19.0,
    authority_end_m=4500.0,
    load_kg=20_000.0,
    traction_ratio=1.0,
    traction_mps2=2.0,
    doors_locked=True,
    doors_open=False,
    door_enabled=False,
    holding_applied=False,
    slips=True,
)


@pytest.mark.parametrize(
    ("change", "is_believed"),
    [({}, True), ({"enabled": False}, False), ({"protection_brakes": True}, False)],
)
def test_slip_under_a_brake_of_others_does_not_mark_the_rail_slippery(
    change: dict[str, Any], is_believed: bool
) -> None:
    """On a dry rail the law asks for 0.8 m/s² of traction, on a slippery one for at most half of
    it."""
    law = Predictive(AtoConfig(), LINE, 0.05)
    law.set_off(SLIPPING, 0.0)
    law.observe(dataclasses.replace(SLIPPING, **change), 1)
    law.set_off(dataclasses.replace(SLIPPING, slips=False, speed_mps=0.0), 0.0)
    now_ns, speed_mps, hardest_pull_mps2 = 10 * S, 0.0, 0.0
    for _ in range(120):
        now_ns += S // 20
        seen = dataclasses.replace(SLIPPING, now_ns=now_ns, speed_mps=speed_mps, slips=False)
        law.observe(seen, 1)
        pull_mps2 = law.drive(seen, Target(4500.0, True)).accel_mps2
        law.issued(pull_mps2)
        speed_mps += 0.05 * pull_mps2
        hardest_pull_mps2 = max(hardest_pull_mps2, pull_mps2)

    assert (hardest_pull_mps2 < 0.4) is is_believed
    assert (hardest_pull_mps2 > 0.6) is not is_believed


@pytest.mark.parametrize(("slows_m", "lets_go"), [(300.0, False), (400.0, True)])
def test_a_brake_application_shortly_before_the_stopping_curve_is_not_released(
    slows_m: float, lets_go: bool
) -> None:
    """Another law limits the speed to 11 m/s from there on. The braking for the stop begins at
    110 m."""
    law, target = Predictive(AtoConfig(), LINE, 0.05), Target(4500.0, True)
    seen = dataclasses.replace(SLIPPING, slips=False, front_m=3900.0, speed_mps=14.0)
    law.set_off(seen, 0.0)
    under_way, demands_mps2 = deque([0.0] * 12), [0.0]
    while seen.speed_mps > 0.5:
        if target.at_m - seen.front_m <= slows_m:
            law.most_mps = 11.0
        law.observe(seen, 1)
        demands_mps2.append(law.drive(seen, target).accel_mps2)
        law.issued(demands_mps2[-1])
        under_way.append(demands_mps2[-1])
        speed_mps = max(0.0, seen.speed_mps + 0.05 * under_way.popleft())
        seen = dataclasses.replace(
            seen,
            now_ns=seen.now_ns + S // 20,
            front_m=seen.front_m + 0.05 * speed_mps,
            speed_mps=speed_mps,
        )

    first = next(n for n, demand_mps2 in enumerate(demands_mps2) if demand_mps2 < -0.1)
    assert (max(demands_mps2[first:]) >= 0.0) is lets_go


def test_on_a_slippery_rail_the_demand_stays_within_the_adhesion() -> None:
    rig = rig_to_iii(AtoConfig(slippery=SlipperyRail(from_start=True)), seed=3)
    rig.run(ato_rig.served(1))

    driving = [d.accel_mps2 for d in rig.trace.demands if d.target_mps > 0.0]
    assert max(driving) <= SlipperyRail().accel_mps2 + 1e-9
    assert -min(driving) <= 0.54
    assert abs(rig.stops[0].error_m) <= 0.10


@pytest.mark.parametrize("gain", [0.75, 0.85])
def test_the_law_raises_the_demand_of_a_weak_brake_as_far_as_the_train_keeps_the_limit(
    gain: float,
) -> None:
    rig = rig_to_iii(brake_gain=gain, seed=5)
    rig.run(ato_rig.served(1))

    assert hardest_mps2(rig) * gain <= 0.8 + 1e-9
    assert abs(rig.stops[0].error_m) <= 0.10


def test_the_demand_of_a_strong_brake_stays_within_the_comfort_limit() -> None:
    rig = rig_to_iii(brake_gain=1.25, seed=5)
    rig.run(ato_rig.served(1))

    assert hardest_mps2(rig) <= 0.8 + 1e-9
    assert abs(rig.stops[0].error_m) <= 0.10


def test_a_weak_brake_on_a_slippery_rail_gets_no_greater_demand() -> None:
    rig = rig_to_iii(AtoConfig(slippery=SlipperyRail(from_start=True)), seed=3, brake_gain=0.75)
    rig.run(ato_rig.served(1))

    assert -min(demand.accel_mps2 for demand in rig.trace.demands) <= 0.8 + 1e-9


@pytest.mark.parametrize("gain", [0.85, 1.15])
def test_the_law_goes_on_learning_the_brake_while_an_axle_slides_a_little(gain: float) -> None:
    """Odometry reports slip from before the braking on, and measures the speed by other means."""
    rig = rig_to_iii(brake_gain=gain, seed=5)
    rig.run(lambda rig: rig.front_m > 3250.0)
    rig.orders["slips"] = True
    rig.run(lambda rig: rig.front_m > 3490.0)

    assert law_of(rig)._model.gain_ratio == pytest.approx(gain - 1.0, abs=0.06)


def test_a_brake_of_others_does_not_change_the_learnt_gain() -> None:
    """Protection brakes twice as hard as ATO demanded for two seconds; the learnt gain stays."""
    rig = rig_to_iii(seed=4, brake_gain=1.0)
    rig.run(lambda rig: rig.front_m > 3330.0)
    before = law_of(rig)._model.gain_ratio
    rig.orders["protection_brakes"] = True
    for _ in range(40):
        rig.speed_mps -= 0.5 * rig.cycle_s
        rig.step()
    after = law_of(rig)._model.gain_ratio

    assert after == pytest.approx(before, abs=1e-9)


def test_the_decay_of_a_released_brake_of_others_does_not_change_the_learnt_gain() -> None:
    """A law that took this for its own, stronger brake would begin the next braking too late.
    Behind another train, one overran the mark by 2.4 m."""
    rig = rig_to_iii(seed=4, brake_gain=1.0)
    rig.run(lambda rig: rig.front_m > 3330.0)
    before = law_of(rig)._model.gain_ratio
    for cycle in range(80):
        rig.orders["protection_brakes"] = cycle < 40
        rig.speed_mps -= 0.5 * rig.cycle_s if cycle < 65 else 0.0
        rig.step()
    after = law_of(rig)._model.gain_ratio

    assert after == pytest.approx(before, abs=1e-9)


@pytest.mark.parametrize("delay_s", [0.05, 0.2, 0.4, 1.0, 1.4, 2.4, 2.9])
def test_every_brake_delay_is_identified_and_compensated(delay_s: float) -> None:
    belief = BrakeBelief(air_delays_s=(0.0,))
    rig = rig_to_iii(AtoConfig(brake=belief), seed=7, brake_delay_s=delay_s, brake_gain=1.0)
    rig.run(lambda rig: rig.front_m > 3400.0)
    # The link and the cycle add to the delay, and an unknown lag appears as dead time.
    found_s = law_of(rig).brake_dead_time_s
    rig.run(ato_rig.served(1))

    assert found_s == pytest.approx(delay_s + 0.03, abs=0.2)
    assert abs(rig.stops[0].error_m) <= (0.08 if delay_s < 2.0 else 0.30)


def test_braking_is_planned_for_the_longest_dead_time_so_far() -> None:
    rig = rig_to_iii(seed=7, brake_delay_s=1.5, brake_gain=1.0)
    rig.run(lambda rig: rig.front_m > 3000.0)
    before_s = law_of(rig).brake_dead_time_s
    rig.run(ato_rig.served(1))
    model = law_of(rig)._model
    model.issue(0.0)
    for _ in range(200):
        model.step(0.0, 0.0, 1)

    assert before_s == BrakeBelief().first_dead_time_s
    assert model.dead_time_s == pytest.approx(1.53, abs=0.15)
