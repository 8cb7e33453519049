"""The train as a whole on its line, controlled by typed commands."""

import itertools
from dataclasses import replace
from importlib import resources
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from can_dbc.brake import BrakeCommand
from can_dbc.cab import CabMode
from can_dbc.doors import DoorCommand
from can_dbc.nodes import Direction
from can_dbc.traction import TractionCommand
from firmware_py.settings import SettingsError, shipped_names
from firmware_py.trackdb import GradientSection, LineMap, load_line
from plant_emulator.sensors.tag_reader import TagPass
from plant_emulator.train_config import PACKAGE, TrainConfig, load_train, with_overrides
from plant_emulator.world import STEP_NS, STEP_S, World, plan_scenario

FLORENCE = load_line("florence")
START_M = 2050.0
"""A chainage where the longest shipped train stands on level track."""
TRAIN = load_train("florence4")
EASY = replace(TRAIN.resistance, error_ratio=replace(TRAIN.resistance.error_ratio, low=0, high=0))
RELEASED = BrakeCommand(service_decel_mps2=0.0, emergency_released=True, holding_released=True)
EMERGENCY = replace(RELEASED, emergency_released=False)
OPEN_RIGHT = DoorCommand(enable_left=False, enable_right=True, open_left=False, open_right=True)


def driving(force_n: float) -> TractionCommand:
    return TractionCommand(force_n=force_n, direction=Direction.FORWARD, traction_permitted=True)


COASTING = driving(0.0)


def world_of(
    train: TrainConfig = TRAIN, line: LineMap = FLORENCE, seed: int = 1, front_m: float = 0.0
) -> World:
    return World(train, line, seed=seed, front_m=front_m)


def drive(
    world: World,
    duration_s: float,
    brake: BrakeCommand | None = RELEASED,
    traction: TractionCommand | None = COASTING,
    doors: DoorCommand | None = None,
) -> World:
    """Send commands every 50 ms, or none."""
    for step in range(round(duration_s / STEP_S)):
        if step % 5 == 0:
            if brake is not None:
                world.brake.hear(brake, world.now_ns)
            if traction is not None:
                world.traction.hear(traction, world.now_ns)
            if doors is not None:
                world.doors.hear(doors, world.now_ns)
        world.step()
    return world


def running(speed_mps: float, train: TrainConfig = TRAIN, seed: int = 1) -> World:
    """A released train with this speed on level track."""
    world = world_of(train, seed=seed, front_m=START_M)
    drive(world, 8.0)
    assert world.speed_mps == 0.0
    world.consist.car_speeds_mps[:] = [speed_mps] * len(world.consist.cars)
    world.consist.speed_mps = speed_mps
    return world


def test_without_any_command_the_train_does_not_move_at_all() -> None:
    world = drive(world_of(front_m=700.0), 20.0, brake=None, traction=None)
    assert world.consist.car_fronts_m == [700.0] * 4
    assert world.speed_mps == 0.0


def test_traction_does_not_move_a_train_in_emergency() -> None:
    world = drive(world_of(), 5.0, EMERGENCY, driving(200_000.0))
    assert world.front_m == 0.0
    assert world.traction.traction_cut


def test_the_holding_brake_holds_against_starting_effort_on_a_gradient() -> None:
    """The train moves with the release of the brake and not before."""
    holding = replace(RELEASED, holding_released=False)
    world = drive(world_of(front_m=740.0), 3.0, holding, driving(60_000.0))
    assert world.front_m == 740.0

    drive(world, 3.0, RELEASED, driving(60_000.0))

    assert world.front_m > 740.0


def test_a_train_released_on_a_climb_rolls_back_and_its_tachos_show_it() -> None:
    world = drive(world_of(front_m=740.0), 5.0, RELEASED)
    frame = world.tachos.frame(world.now_ns)
    assert world.front_m < 739.5
    assert frame.direction is Direction.REVERSE
    assert frame.pulses_a > 60_000


def test_a_running_train_without_commands_stops_by_itself() -> None:
    world = running(15.0)
    drive(world, 20.0, brake=None, traction=None)
    assert world.speed_mps == 0.0
    # The silence takes 0.15 s, the dead time 0.3 s and the build-up 0.4 s; then 1.2 m/s² act.
    assert world.front_m - START_M <= 15.0 * (0.15 + 0.3 + 0.4) + 15.0**2 / 2.4
    assert world.brake.losses == 1
    assert world.traction.losses == 1


def test_without_the_traction_command_the_train_coasts() -> None:
    world = running(10.0)
    drive(world, 2.0, RELEASED, driving(100_000.0))
    drive(world, 1.0, RELEASED, None)
    assert world.drive_n == 0.0
    assert world.brake_n == 0.0
    assert world.speed_mps > 9.0


def test_an_open_door_cuts_traction() -> None:
    world = drive(world_of(), 5.0, replace(RELEASED, holding_released=False), COASTING, OPEN_RIGHT)
    assert not world.doors.locked
    drive(world, 3.0, RELEASED, driving(100_000.0), OPEN_RIGHT)
    assert world.drive_n == 0.0
    assert world.front_m == 0.0


@pytest.mark.parametrize("name", shipped_names(PACKAGE))
@pytest.mark.parametrize("load_ratio", [0.0, 1.0])
def test_the_emergency_brake_meets_the_assumptions_of_protection(
    name: str, load_ratio: float
) -> None:
    """The deceleration is 1.0 m/s² on the level after an equivalent delay of 1.05 s, at any
    load."""
    train = with_overrides(load_train(name), load_ratio=load_ratio)
    world = running(22.0, train)
    drive(world, 30.0, EMERGENCY, driving(200_000.0))
    assert world.speed_mps == 0.0
    assert world.front_m - START_M <= 22.0 * 1.05 + 22.0**2 / 2.0


@settings(max_examples=20)
@given(
    speed_mps=st.floats(0.5, 22.0),
    decel_mps2=st.floats(0.2, 1.0),
    seed=st.integers(0, 1000),
    load_ratio=st.floats(0.0, 1.0),
)
def test_a_service_braked_train_stops_and_then_does_not_move(
    speed_mps: float, decel_mps2: float, seed: int, load_ratio: float
) -> None:
    world = running(speed_mps, with_overrides(TRAIN, load_ratio=load_ratio), seed)
    service = replace(RELEASED, service_decel_mps2=decel_mps2)
    drive(world, 3.0 + 1.2 * speed_mps / decel_mps2, service)
    assert world.speed_mps == 0.0
    rest_m = list(world.consist.car_fronts_m)

    drive(world, 3.0, service)

    assert world.consist.car_fronts_m == rest_m


def test_slippery_rails_show_on_the_driven_axle_only() -> None:
    world = drive(world_of(), 8.0)
    world.adhesion_ratio = 0.06
    drive(world, 6.0, RELEASED, driving(150_000.0))
    counted_a, counted_b = (axle.rolled_m for axle in world.tachos.axles)

    assert world.drive_n == pytest.approx(0.06 * 2 * (35_000 + 6_800) * 9.81)
    assert counted_a > world.front_m + 1.0
    assert counted_b == pytest.approx(world.front_m, abs=0.1)


def test_sliding_wheels_count_less_than_the_distance() -> None:
    world = running(15.0)
    world.adhesion_ratio = 0.04
    before_m = world.tachos.axles[0].rolled_m
    drive(world, 4.0, EMERGENCY)
    rolled_m = world.tachos.axles[0].rolled_m - before_m

    decel_mps2 = 0.04 * 9.81 / 1.08
    assert world.speed_mps == pytest.approx(15.0 - decel_mps2 * 3.65, abs=0.4)
    assert rolled_m < world.front_m - START_M - 2.0


def test_adhesion_limits_the_brake_together_with_traction() -> None:
    world = running(15.0)
    world.adhesion_ratio = 0.04
    drive(world, 2.0, replace(RELEASED, service_decel_mps2=1.0), driving(20_000.0))
    assert world.drive_n == pytest.approx(20_000.0, rel=0.01)
    assert world.brake_n == pytest.approx(0.04 * 157_200.0 * 9.81)


def test_the_effort_at_the_rail_is_the_energy_of_the_train() -> None:
    """On the level without resistance, electrical energy times efficiency is kinetic plus
    coupler energy."""
    free = replace(EASY, a_n_per_kn=0.0, b_n_per_kn_per_mps=0.0, c_n_per_kn_per_mps2=0.0)
    train = replace(TRAIN, resistance=free)
    world = drive(world_of(train, front_m=START_M), 8.0)
    drive(world, 30.0, RELEASED, driving(80_000.0))

    mechanical_j = world.power.traction_j * train.traction.efficiency_ratio
    stored_j = world.consist.kinetic_j() + world.consist.coupler_j()
    assert stored_j > 1.0e7
    # The coupler dampers took the small rest.
    assert stored_j <= mechanical_j <= 1.002 * stored_j


def test_braking_feeds_back_the_power_of_the_motors() -> None:
    world = running(19.0)
    start_j = world.consist.kinetic_j()
    service = replace(RELEASED, service_decel_mps2=0.6)
    drive(world, 45.0, service)

    share = TRAIN.brake.service.electric.share_ratio
    efficiency = TRAIN.brake.service.electric.efficiency_ratio
    assert world.speed_mps == 0.0
    assert world.power.braking_j < share * efficiency * start_j
    assert world.power.braking_j > 0.85 * share * efficiency * start_j


def test_every_tag_of_the_line_is_read_once_where_it_lies() -> None:
    """The run covers the whole line; the truth at the stamp is interpolated from the logged
    motion."""
    ideal = load_train("florence4_ideal")
    world = drive(world_of(ideal, front_m=-1.0), 3.0)
    track: list[tuple[int, float]] = []
    passes: list[TagPass] = []
    while world.front_m < 4600.0:
        force_n = 100_000.0 if world.speed_mps < 19.0 else 10_000.0
        drive(world, STEP_S * 5, RELEASED, driving(force_n))
        track.append((world.now_ns, world.front_m))
        if world.tag_reader.tags_read > len(passes):
            assert world.tag_reader.last is not None
            passes.append(world.tag_reader.last)

    assert [each.site for each in passes] == [
        site for site in FLORENCE.tags if site.position_m < 4598.0
    ]
    for each in passes:
        after = next(index for index, (at_ns, _) in enumerate(track) if at_ns >= each.true_ns)
        if after == 0:
            continue
        (t0, x0), (t1, x1) = track[after - 1], track[after]
        # Between two points 50 ms apart the speed changes by 4 cm/s at most.
        front_m = x0 + (x1 - x0) * (each.true_ns - t0) / (t1 - t0)
        assert front_m - 2.0 == pytest.approx(each.site.position_m, abs=0.002)


def test_the_load_weighs_on_the_train_and_is_reported() -> None:
    full = world_of(with_overrides(TRAIN, load_ratio=1.0))
    empty = world_of(with_overrides(TRAIN, load_ratio=0.0))
    assert full.consist.mass_kg == pytest.approx(184_400.0)
    assert empty.consist.mass_kg == pytest.approx(130_000.0)
    assert full.load_status().load_kg == pytest.approx(54_400.0)
    assert full.load_status().cars == 4


def test_the_gradient_under_the_train_is_its_mean() -> None:
    assert world_of(front_m=750.0).gradient_permille == pytest.approx(30.0)
    assert world_of(front_m=650.0 + 68.59 / 2).gradient_permille == pytest.approx(15.0)


def test_the_desk_is_unattended_and_permissive() -> None:
    desk = World(TRAIN, FLORENCE, seed=1, front_m=0.0, desk_mode=CabMode.MANUAL).desk
    assert desk.mode is CabMode.MANUAL
    assert desk.emergency_released
    assert desk.no_passenger_alarm
    assert not desk.reset_requested


def trace(seed: int, **changes: float) -> list[tuple[float, float, int, float]]:
    train = with_overrides(TRAIN, **changes)
    world = world_of(train, seed=seed)
    rows = []
    for command in (RELEASED, replace(RELEASED, service_decel_mps2=0.5), RELEASED):
        for _ in range(20):
            drive(world, 0.5, command, driving(100_000.0))
            tacho = world.tachos.frame(world.now_ns)
            doppler = world.doppler.frame(world.consist.car_speeds_mps[0])
            rows.append((world.front_m, world.speed_mps, tacho.pulses_a, doppler.speed_mps))
    return rows


def test_the_same_seed_gives_the_same_run_to_the_last_bit() -> None:
    assert trace(7) == trace(7)
    assert trace(7) != trace(8)


def test_fixing_one_error_changes_no_other_sample() -> None:
    drawn, fixed = trace(7), trace(7, odometer_error_ratio=0.0)
    assert [row[:2] + row[3:] for row in drawn] == [row[:2] + row[3:] for row in fixed]
    assert [row[2] for row in drawn] != [row[2] for row in fixed]


def test_time_passes_while_the_train_stands() -> None:
    world = running(10.0)
    front_m, now_ns = world.front_m, world.now_ns
    world.pass_over(50)
    assert (world.front_m, world.now_ns) == (front_m, now_ns + 50 * STEP_NS)


def test_a_scenario_takes_the_whole_line_by_default() -> None:
    scenario = plan_scenario()
    assert (scenario.start.name, scenario.destination.name) == ("Start", "IV")
    assert scenario.train.name == "florence4"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"consist": "florence5"}, "florence5.*nearest valid shipped name: florence4"),
        ({"line": "florenze"}, "florenze.*nearest valid shipped name: florence"),
        ({"start": "V"}, "--from V.*has no station V; it has Start, I, II, III, IV"),
        ({"end": "V"}, "--to V"),
        ({"start": "III", "end": "II"}, "--to II.*not beyond III"),
        ({"load_ratio": 1.5}, "florence4.*load_ratio 1.5 is not in 0..1"),
        ({"load_ratio": float("nan")}, "load_ratio nan"),
        ({"odometer_error_ratio": 0.5}, "odometer_error_ratio"),
        ({"real": {"brake.servce.lag_s": 1}}, "florence4: brake.servce: .* valid key: service"),
        ({"real": {"cars.4.tare_kg": 1}}, "florence4: cars.4: no such entry; .* 0 to 3"),
        ({"real": {"rail.adhesion_ratio": 2}}, "florence4: rail: adhesion_ratio 2.0 is not in"),
        ({"desk_mode": "manul"}, "desk_mode: 'manul': nearest valid value: manual"),
    ],
)
def test_an_impossible_scenario_is_refused_with_the_reason(
    changes: dict[str, object], words: str
) -> None:
    with pytest.raises(SettingsError, match=words):
        plan_scenario(**changes)  # type: ignore[arg-type]


def test_a_scenario_may_change_the_true_train() -> None:
    real = {"brake.service.gain_ratio": 0.9, "cars.0.tare_kg": 36_000, "load_ratio": 0.2}
    scenario = plan_scenario(real=real, odometer_error_ratio=0.01, desk_mode="manual")

    gain_ratio = scenario.train.brake.service.gain_ratio
    assert (gain_ratio.low, gain_ratio.high) == (0.9, 0.9)
    assert scenario.train.mass_kg == pytest.approx(131_000.0 + 0.2 * 4 * 13_600.0)
    assert scenario.train.sensors.odometer_error_ratio.high == 0.01
    assert scenario.desk_mode is CabMode.MANUAL


def test_a_train_must_fit_behind_its_start(tmp_path: Path) -> None:
    shipped = resources.files("plant_emulator") / "consists" / "florence4.toml"
    text = shipped.read_text(encoding="utf-8")
    path = tmp_path / "long.toml"
    path.write_text(text.replace("length_m = 17.455", "length_m = 60.0"), encoding="utf-8")

    with pytest.raises(SettingsError, match="reaches back over the line's start"):
        plan_scenario(consist=str(path))


def test_a_gradient_over_the_whole_run_changes_its_energy_by_the_height() -> None:
    """With the same effort over the same distance, the energies differ by mass times height."""
    free = replace(EASY, a_n_per_kn=0.0, b_n_per_kn_per_mps=0.0, c_n_per_kn_per_mps2=0.0)
    train = replace(TRAIN, resistance=free)
    ends_j = []
    for gradient_permille in (0.0, 10.0):
        line = replace(FLORENCE, gradients=(GradientSection(-120.0, 4700.0, gradient_permille),))
        world = drive(world_of(train, line), 3.0, replace(RELEASED, holding_released=False))
        while world.front_m < 300.0:
            drive(world, STEP_S, RELEASED, driving(100_000.0))
        drive_j = world.power.traction_j * train.traction.efficiency_ratio
        ends_j.append(drive_j - world.consist.kinetic_j() - world.consist.coupler_j())
        reached_m = world.front_m

    assert ends_j[1] - ends_j[0] == pytest.approx(157_200.0 * 9.81 * 0.010 * reached_m, rel=5e-3)


def test_steps_follow_each_other_without_a_gap() -> None:
    world = world_of()
    instants_ns = []
    for _ in range(5):
        world.step()
        instants_ns.append(world.now_ns)
    assert {later - earlier for earlier, later in itertools.pairwise(instants_ns)} == {STEP_NS}
