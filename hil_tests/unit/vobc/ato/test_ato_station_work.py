"""ATO at stations: doors, dwell, departure, authority and ceiling as other parts decide them."""

import dataclasses
import itertools
import math
from typing import Any

import pytest

from can_dbc.vobc import AtoPhase
from firmware_py import settings
from firmware_py.trackdb import Station, load_line
from hil_tests.unit.vobc.ato import ato_rig
from vobc.ato import Ato, AtoConfig

LINE = load_line("florence")
JERK_STEP_MPS2 = 0.6 * 0.05 + 1e-9


def hop(dwell_s: float = 3.0, **options: Any) -> ato_rig.Rig:
    """Run from II to III (500 m) and on to IV; the train stands at II."""
    stops = [dataclasses.replace(LINE.station(name), dwell_s=dwell_s) for name in ("III", "IV")]
    given = {"seed": 1, "start_scale_known": True, **options}
    return ato_rig.Rig(
        Ato(AtoConfig(), LINE, 3000.0, stops), LINE, ato_rig.RigSettings(**given), 3000.0
    )


def phases(rig: ato_rig.Rig) -> list[AtoPhase]:
    seen: list[AtoPhase] = []
    for demand in rig.trace.demands:
        if not seen or demand.phase is not seen[-1]:
            seen.append(demand.phase)
    return seen


def at_rest(rig: ato_rig.Rig) -> bool:
    return rig.still_s > 5.0 and rig.held and rig.now_s > 10.0


def test_a_hop_goes_through_its_phases_in_order() -> None:
    rig = hop()
    rig.run(lambda rig: rig.ato.phase is AtoPhase.DEPARTING and len(rig.stops) == 1)

    assert phases(rig) == [
        AtoPhase.OFF,
        AtoPhase.HOLDING,
        AtoPhase.DEPARTING,
        AtoPhase.RUNNING,
        AtoPhase.APPROACHING,
        AtoPhase.STOPPING,
        AtoPhase.STOPPED,
        AtoPhase.DOORS_OPEN,
        AtoPhase.DOORS_CLOSING,
        AtoPhase.DEPARTING,
    ]


def test_the_doors_stay_open_for_the_dwell_and_at_the_last_stop_for_good() -> None:
    rig = hop(dwell_s=20.0)
    rig.run(ato_rig.served(2))
    rig.run(lambda rig: rig.ato.phase is AtoPhase.DOORS_OPEN)
    for _ in range(1200):
        demand = rig.step()

    trace = rig.trace
    wide_open_s = 0.05 * sum(
        demand.open_doors and demand.phase is AtoPhase.DOORS_OPEN and 3400.0 < front_m < 3600.0
        for demand, front_m in zip(trace.demands, trace.fronts_m, strict=True)
    )
    assert wide_open_s == pytest.approx(20.0 + 2.5, abs=0.3)
    assert demand.phase is AtoPhase.DOORS_OPEN
    assert demand.open_doors
    assert demand.hold


def test_a_starting_station_is_served_only_if_it_has_a_dwell_time() -> None:
    def first_phases(dwell_s: float) -> list[AtoPhase]:
        start = dataclasses.replace(LINE.station("II"), dwell_s=dwell_s)
        rig = ato_rig.Rig(
            Ato(AtoConfig(), LINE, 3000.0, [start, LINE.station("III")]),
            LINE,
            ato_rig.RigSettings(),
            3000.0,
        )
        rig.run(lambda rig: rig.ato.phase is AtoPhase.DEPARTING)
        return phases(rig)

    assert AtoPhase.DOORS_OPEN not in first_phases(0.0)
    assert AtoPhase.DOORS_OPEN in first_phases(2.0)


def test_doors_are_not_asked_to_open_before_protection_enables_them() -> None:
    rig = hop()
    rig.door_permission = rig.jog_permitted = False
    rig.run(ato_rig.served(1))
    for _ in range(100):
        assert not rig.step().open_doors
    assert rig.ato.phase is AtoPhase.STOPPED

    rig.door_permission = True
    rig.step()

    assert rig.step().open_doors


def test_losing_the_door_enabling_withdraws_the_request() -> None:
    rig = hop(dwell_s=30.0)
    rig.run(lambda rig: rig.doors_position == 1.0)

    rig.door_permission = False

    assert not rig.step().open_doors


def test_the_train_never_pulls_away_with_doors_unlocked() -> None:
    """The doors do not follow the close command; the rig asserts that the train stands
    meanwhile."""
    rig = hop(dwell_s=1.0)
    rig.run(lambda rig: rig.doors_position == 1.0)
    rig.doors_stuck_open = True
    for _ in range(600):
        demand = rig.step()
        assert demand.accel_mps2 <= 0.0
        assert demand.hold
    assert rig.ato.phase is AtoPhase.DOORS_CLOSING

    rig.doors_stuck_open = False
    rig.run(lambda rig: rig.front_m > 3600.0)


def test_a_door_that_unlocks_before_the_train_moves_cancels_the_departure() -> None:
    rig = hop()
    rig.run(lambda rig: rig.ato.phase is AtoPhase.DEPARTING)
    rig.step()

    rig.doors_stuck_open = True
    rig.held = rig.hold_asked = True
    rig.doors_position = 0.01
    demand = rig.step()

    assert demand.phase is AtoPhase.HOLDING
    assert demand.accel_mps2 <= 0.0
    assert demand.hold


def test_doors_that_never_report_open_do_not_hold_the_train_forever(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rig = hop(dwell_s=2.0)
    rig.run(ato_rig.served(1))
    physics = rig._hold_and_doors

    def stuck_half_way() -> None:
        physics()
        rig.doors_position = min(rig.doors_position, 0.5)

    monkeypatch.setattr(rig, "_hold_and_doors", stuck_half_way)

    rig.run(lambda rig: rig.front_m > 3550.0, limit_s=60.0)


def test_a_train_without_authority_stays() -> None:
    rig = hop()
    rig.authority_end_m = 3002.0
    for _ in range(400):
        demand = rig.step()
        assert demand.accel_mps2 <= 0.0
        assert demand.hold
    assert rig.ato.phase is AtoPhase.HOLDING


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("end_m", [3060.0, 3200.0, 3450.0, 3499.0])
def test_an_authority_short_of_the_stop_is_respected(end_m: float, seed: int) -> None:
    """The front stops within 2.5 m before the end of authority and goes on when the end moves."""
    rig = hop(seed=seed, brake_delay_s=None)
    rig.authority_end_m = end_m
    rig.run(at_rest)

    assert max(rig.trace.fronts_m) < end_m
    assert rig.front_m > end_m - 2.5
    assert rig.ato.phase is AtoPhase.HOLDING

    rig.authority_end_m = LINE.end_m
    rig.run(ato_rig.served(1))
    assert abs(rig.stops[0].error_m) <= 0.10


def safe_speed_mps(distance_m: float, lead_s: float) -> float:
    """Speed that a safe braking model allows: the lead time, 0.43 s of runaway, 1.05 s of brake
    build-up, 1.0 m/s²."""

    def needed_m(speed_mps: float) -> float:
        after_mps = speed_mps + 0.43
        return speed_mps * (lead_s + 0.43) + 0.43**2 / 2.0 + after_mps * 1.05 + after_mps**2 / 2.0

    low_mps, high_mps = 0.0, 30.0
    for _ in range(40):
        middle_mps = (low_mps + high_mps) / 2.0
        if needed_m(middle_mps) <= distance_m:
            low_mps = middle_mps
        else:
            high_mps = middle_mps
    return low_mps


@pytest.mark.parametrize("end_m", [3060.0, 3200.0, 3450.0])
def test_protection_never_warns_before_the_end_of_authority(end_m: float) -> None:
    """The permitted speed is 1.6 s ahead of the emergency curve and the warning 1.0 s; the front
    is known within 0.3 m."""
    rig = hop(brake_delay_s=None)
    rig.authority_end_m = end_m
    while not at_rest(rig):
        room_m = end_m - rig.front_m - 0.3
        rig.ceiling_mps = safe_speed_mps(room_m, 1.6)
        rig.step()
        if rig.speed_mps > 0.0:
            assert rig.speed_mps < safe_speed_mps(room_m, 1.0)

    assert 1.0 < end_m - rig.front_m < 2.5


def test_a_train_whose_ceiling_vanishes_comes_to_rest_and_is_held() -> None:
    rig = hop()
    rig.run(lambda rig: rig.front_m > 3100.0)
    rig.ceiling_mps = 0.0

    rig.run(at_rest, limit_s=120.0)

    assert rig.ato.phase is AtoPhase.HOLDING


def test_an_authority_extended_during_the_approach_is_used() -> None:
    """The law releases the brake without a jolt when the end of authority moves on."""
    rig = hop()
    rig.authority_end_m = 3300.0
    rig.run(lambda rig: rig.front_m > 3240.0)
    assert rig.ato.phase is AtoPhase.APPROACHING
    rig.authority_end_m = LINE.end_m

    rig.run(ato_rig.served(1))

    assert min(rig.trace.speeds_mps[-800:-400]) > 1.0
    assert abs(rig.stops[0].error_m) <= 0.10


def test_an_authority_that_ends_at_a_station_keeps_the_doors_open() -> None:
    rig = hop(dwell_s=1.0)
    rig.authority_end_m = 3500.5
    rig.run(ato_rig.served(1))
    for _ in range(400):
        demand = rig.step()
    assert demand.phase is AtoPhase.DOORS_OPEN

    rig.authority_end_m = LINE.end_m
    rig.run(lambda rig: rig.front_m > 3550.0, limit_s=60.0)


@pytest.mark.parametrize("front_m", [3100.0, 3200.0, 3300.0])
def test_a_ceiling_that_falls_suddenly_is_followed_without_a_jolt(front_m: float) -> None:
    rig = hop()
    rig.run(lambda rig: rig.front_m > front_m)
    rig.ceiling_mps = 25.0 / 3.6
    for _ in range(400):
        if rig.front_m > 3450.0:
            break
        rig.step()
    slow_mps = rig.speed_mps
    rig.ceiling_mps = 100.0
    rig.run(ato_rig.served(1))

    assert slow_mps <= 25.0 / 3.6
    assert abs(rig.stops[0].error_m) <= 0.10
    demands = rig.trace.demands
    for before, after in itertools.pairwise(demands):
        assert abs(after.accel_mps2 - before.accel_mps2) <= JERK_STEP_MPS2


def test_a_disabled_train_brakes_to_rest_and_goes_on_when_enabled_again() -> None:
    rig = hop()
    rig.run(lambda rig: rig.front_m > 3100.0)
    rig.enabled = False
    rig.run(at_rest)
    assert rig.ato.phase is AtoPhase.OFF
    assert rig.hold_asked

    rig.enabled = True
    rig.run(ato_rig.served(1))

    assert abs(rig.stops[0].error_m) <= 0.10


@pytest.mark.parametrize("front_m", [3050.0, 3150.0, 3350.0, 3460.0, 3490.0])
def test_a_short_loss_of_the_enabling_in_motion_does_not_end_the_run(front_m: float) -> None:
    rig = hop(brake_delay_s=None)
    rig.run(lambda rig: rig.front_m > front_m)
    rig.enabled = False
    for _ in range(20):
        rig.step()
    rig.enabled = True

    rig.run(ato_rig.served(1))

    assert abs(rig.stops[0].error_m) <= 0.10


@pytest.mark.parametrize("front_m", [3004.0, 3120.0, 3250.0, 3480.0, 3496.0])
def test_after_an_emergency_between_stations_the_train_reaches_its_stop(front_m: float) -> None:
    rig = hop()
    rig.run(lambda rig: rig.front_m > front_m)
    rig.emergency = True
    rig.run(at_rest)
    rig.emergency = False

    rig.run(ato_rig.served(1))

    assert abs(rig.stops[0].error_m) <= 0.30


@pytest.mark.parametrize("short_m", [0.5, 0.8, 2.0, 4.5, 8.0])
def test_a_train_that_stands_short_of_the_stop_jogs_to_it(short_m: float) -> None:
    station = dataclasses.replace(LINE.station("III"), dwell_s=2.0)
    start_m = 3500.0 - short_m
    rig = ato_rig.Rig(
        Ato(AtoConfig(), LINE, start_m, [station]),
        LINE,
        ato_rig.RigSettings(seed=1, start_scale_known=True, brake_delay_s=None),
        start_m,
    )

    rig.run(ato_rig.served(1), limit_s=90.0)

    assert abs(rig.stops[0].error_m) <= 0.30
    if short_m <= AtoConfig().station.jog_reach_m:
        assert max(rig.trace.speeds_mps) <= 5.0 / 3.6


def test_a_train_that_stands_too_far_stays_and_asks_for_nothing() -> None:
    station = dataclasses.replace(LINE.station("III"), dwell_s=2.0)
    start_m = 3500.25
    rig = ato_rig.Rig(
        Ato(AtoConfig(), LINE, start_m, [station]), LINE, ato_rig.RigSettings(), start_m
    )
    rig.shift_m = 0.3
    for _ in range(200):
        demand = rig.step()
        assert demand.hold
        assert demand.accel_mps2 <= 0.0
        assert not demand.open_doors
    assert demand.phase is AtoPhase.HOLDING


def test_a_jump_of_the_position_does_not_step_the_demand() -> None:
    rig = hop()
    rig.run(lambda rig: rig.front_m > 3440.0)
    before = rig.trace.demands[-1].accel_mps2
    rig.shift_m = 1.0

    after = rig.step().accel_mps2

    assert abs(after - before) <= JERK_STEP_MPS2


def test_a_clock_that_steps_brings_no_jolt() -> None:
    rig = hop()
    while len(rig.stops) < 1:
        rig.told_late_s = 0.08 if len(rig.trace.demands) % 20 == 10 else 0.0
        rig.step()

    asked_mps2 = [demand.accel_mps2 for demand in rig.trace.demands]
    jolts = [abs(b - a) for a, b in itertools.pairwise(asked_mps2)]
    assert max(jolts) <= JERK_STEP_MPS2


def test_without_stops_the_train_stays() -> None:
    rig = ato_rig.Rig(Ato(AtoConfig(), LINE, 3000.0, []), LINE, ato_rig.RigSettings(), 3000.0)
    for _ in range(100):
        demand = rig.step()

    assert demand.phase is AtoPhase.HOLDING
    assert demand.distance_to_stop_m == math.inf


def test_without_line_supply_the_train_coasts_and_still_stops() -> None:
    rig = hop()
    rig.run(lambda rig: rig.front_m > 3200.0)
    rig.traction_ratio = 0.0

    rig.run(ato_rig.served(1))

    assert abs(rig.stops[0].error_m) <= 0.10


def test_an_unknown_strategy_is_refused_with_the_nearest_name() -> None:
    with pytest.raises(ValueError, match=r"predictve is unknown; did you mean predictive\?"):
        Ato(AtoConfig(strategy="predictve"), LINE, 0.0, LINE.stations)


def test_a_tuning_table_is_read_and_its_mistakes_are_named() -> None:
    config = settings.build(
        AtoConfig, {"strategy": "pid_literal", "braking": {"decel_mps2": 0.6}}, "x.toml"
    )
    assert config.braking.decel_mps2 == 0.6

    with pytest.raises(settings.SettingsError, match=r"x.toml: braking: .*decel"):
        settings.build(AtoConfig, {"braking": {"decel_mps2": 0.1}}, "x.toml")
    with pytest.raises(settings.SettingsError, match=r"brake\.lags_s: unknown key.*lag_s"):
        settings.build(AtoConfig, {"brake": {"lags_s": 1.0}}, "x.toml")


def test_stops_behind_the_start_are_left_out() -> None:
    ato = Ato(AtoConfig(), LINE, 3000.0, LINE.stations)

    next_stop = ato.next_stop
    assert isinstance(next_stop, Station)
    assert next_stop.name == "II"
