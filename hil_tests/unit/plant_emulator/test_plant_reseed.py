"""Many continuations of one prefix: from the branch on, samples come from another seed."""

from typing import Any

from can_dbc.brake import BrakeCommand
from can_dbc.nodes import Direction
from can_dbc.traction import TractionCommand
from firmware_py.trackdb import load_line
from plant_emulator.sensors.tag_reader import TagPass
from plant_emulator.train_config import load_train
from plant_emulator.world import STEP_S, World

TRAIN, LINE = load_train("florence4"), load_line("florence")
RELEASED = BrakeCommand(service_decel_mps2=0.0, emergency_released=True, holding_released=True)
BRAKING = BrakeCommand(service_decel_mps2=0.7, emergency_released=True, holding_released=True)
DRIVING = TractionCommand(force_n=150_000.0, direction=Direction.FORWARD, traction_permitted=True)
COASTING = TractionCommand(force_n=0.0, direction=Direction.FORWARD, traction_permitted=True)
BRANCH_S = 25.0


def driven(
    seed: int, reseed: int | None = None
) -> tuple[World, list[tuple[Any, ...]], list[TagPass]]:
    """Start, run, brake, run on and brake again; return all noise every 50 ms, and all tags."""
    world = World(TRAIN, LINE, seed=seed, front_m=1100.0)
    rows, tags = list[tuple[Any, ...]](), list[TagPass]()
    for step in range(round(60.0 / STEP_S)):
        t_s = step * STEP_S
        if step == round(BRANCH_S / STEP_S) and reseed is not None:
            world.reseed(reseed)
        if step % 5 == 0:
            braking = 30.0 < t_s < 36.0 or t_s > 45.0
            world.brake.hear(BRAKING if braking else RELEASED, world.now_ns)
            world.traction.hear(DRIVING if t_s < 20.0 else COASTING, world.now_ns)
            speed_mps = world.consist.car_speeds_mps[0]
            rows.append(
                (
                    world.front_m,
                    world.brake_n,
                    world.doppler.frame(speed_mps).speed_mps,
                    world.imu.frame(world.now_ns, speed_mps, 0.0).accel_mps2,
                )
            )
        world.step()
        last = world.tag_reader.last
        if last is not None and (not tags or last is not tags[-1]):
            tags.append(last)
    return world, rows, tags


def test_a_branch_is_the_same_up_to_its_instant_and_different_after_it() -> None:
    _, alone, _ = driven(1)
    _, branched, _ = driven(1, reseed=7)
    rows = round(BRANCH_S / 0.05)
    assert branched[:rows] == alone[:rows]
    assert all(
        one[2:] != other[2:] for one, other in zip(branched[rows:], alone[rows:], strict=True)
    )
    assert branched[-1][0] != alone[-1][0], "it stops elsewhere"


def test_the_same_branch_is_the_same_run() -> None:
    assert driven(1, reseed=7)[1:] == driven(1, reseed=7)[1:]
    assert driven(1, reseed=7)[1:] != driven(1, reseed=8)[1:]


def test_parameters_sampled_once_per_run_stay() -> None:
    world, other = driven(1, reseed=7)[0], World(TRAIN, LINE, seed=1, front_m=1100.0)
    assert world.tachos.error == other.tachos.error
    quiet_mps = [w.doppler.frame(15.0).speed_mps for w in (world, other)]
    assert quiet_mps[0] != quiet_mps[1]
    for each in (world, other):
        each.reseed(3)
    # With the same noise, only scale and bias differ.
    assert world.doppler.frame(15.0) == other.doppler.frame(15.0)
    shown = [w.imu.frame(w.now_ns + 10**15, 0.0, 0.0).accel_mps2 for w in (world, other)]
    assert abs(shown[0] - shown[1]) < 1e-4


def test_a_continuation_samples_like_a_run_of_that_seed() -> None:
    """This covers the brake's first dead time, lag and gain, and the places of the tags ahead."""
    branched, run = (
        World(TRAIN, LINE, seed=1, front_m=1100.0),
        World(TRAIN, LINE, seed=7, front_m=1100.0),
    )
    branched.reseed(7)
    forces_n = []
    for world in (branched, run):
        for step in range(1500):
            if step % 5 == 0:
                world.brake.hear(BRAKING if step > 1000 else RELEASED, world.now_ns)
                world.traction.hear(COASTING, world.now_ns)
            if step == 1000:
                world.consist.car_speeds_mps[:] = [15.0] * 4
                world.consist.speed_mps = 15.0
            world.step()
            if step > 1000:
                forces_n.append(world.brake.motor_n + world.brake.trailer_n)
    half = len(forces_n) // 2
    assert forces_n[:half] == forces_n[half:]
    assert branched.brake.service.dead_time_s == run.brake.service.dead_time_s


def test_tags_ahead_get_the_offset_of_the_new_seed_and_passed_ones_stay() -> None:
    def felt(seed: int, reseed: int | None = None) -> dict[int, float]:
        _, _, tags = driven(seed, reseed)
        return {each.site.tag_id: each.pulses / 256.0 for each in tags}

    one, branched = felt(1), felt(1, reseed=7)
    assert list(one) == list(branched)
    same = [tag_id for tag_id in one if one[tag_id] == branched[tag_id]]
    assert 0 < len(same) < len(one)
    assert same == list(one)[: len(same)]


def test_a_brake_that_is_on_keeps_its_gain_until_it_is_applied_again() -> None:
    """A branch therefore never makes a force jump."""
    worlds = [World(TRAIN, LINE, seed=1, front_m=2000.0) for _ in range(2)]
    for step in range(900):
        for number, world in enumerate(worlds):
            if step % 5 == 0:
                world.brake.hear(BRAKING if step >= 300 else RELEASED, world.now_ns)
            if step == 600 and number:
                world.reseed(9)
            world.step()
        assert worlds[0].brake.motor_n == worlds[1].brake.motor_n
