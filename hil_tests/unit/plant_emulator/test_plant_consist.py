"""The moving train against independent oracles: exact linear theory, energy, momentum, statics."""

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.trackdb import (
    CurveSection,
    GradientSection,
    LineMap,
    SpeedSection,
    Station,
    TunnelSection,
    load_line,
)
from plant_emulator.consist import Consist
from plant_emulator.train_config import ConsistModel, ResistanceConfig, Spread, load_train
from plant_emulator.train_config import TrainConfig as Train

STEP_S = 0.01
TRAIN = load_train("florence4")
POINT = replace(TRAIN, model=ConsistModel.POINT_MASS)
NO_DRAG = ResistanceConfig(0.0, 0.0, 0.0, Spread(0.0, 0.0))


def line_of(
    gradients: tuple[GradientSection, ...] = (),
    curves: tuple[CurveSection, ...] = (),
    tunnels: tuple[TunnelSection, ...] = (),
) -> LineMap:
    return LineMap(
        name="test",
        start_m=-1000.0,
        end_m=20000.0,
        stations=(Station("A", 0.0, -50.0, 1.0),),
        speed_sections=(SpeedSection(-1000.0, 20000.0, 25.0),),
        gradients=gradients,
        curves=curves,
        tunnels=tunnels,
    )


def slope(gradient_permille: float) -> LineMap:
    return line_of((GradientSection(-1000.0, 20000.0, gradient_permille),))


LEVEL = line_of()


def make(train: Train = TRAIN, line: LineMap = LEVEL, front_m: float = 0.0) -> Consist:
    return Consist(train, line, front_m=front_m, step_s=STEP_S)


def throw(consist: Consist, speed_mps: float) -> Consist:
    consist.car_speeds_mps[:] = [speed_mps] * len(consist.cars)
    consist.speed_mps = speed_mps
    return consist


def inertias(consist: Consist) -> npt.NDArray[np.float64]:
    return np.array([car.inertia_kg for car in consist.cars])


def exact_states(
    consist: Consist, drive_n: float, step_s: float, count: int
) -> npt.NDArray[np.float64]:
    """Positions, then speeds, of the linear chain at every step, by the matrix exponential."""
    cars = len(consist.cars)
    chain = np.zeros((cars, cars))
    for index in range(cars - 1):
        chain[index : index + 2, index : index + 2] += np.array([[-1.0, 1.0], [1.0, -1.0]])
    mass = inertias(consist)[:, None]
    system = np.zeros((2 * cars + 1, 2 * cars + 1))
    system[:cars, cars : 2 * cars] = np.eye(cars)
    system[cars : 2 * cars, :cars] = TRAIN.coupler.stiffness_n_per_m * chain / mass
    system[cars : 2 * cars, cars : 2 * cars] = TRAIN.coupler.damping_ns_per_m * chain / mass
    system[cars : 2 * cars, -1] = [
        drive_n * car.drive_share / car.inertia_kg for car in consist.cars
    ]
    once = matrix_exponential(system * step_s)
    state = np.zeros(2 * cars + 1)
    state[-1] = 1.0
    states = []
    for _ in range(count):
        state = once @ state
        states.append(state[:-1])
    return np.array(states)


def matrix_exponential(matrix: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Matrix exponential by scaling, Taylor series and squaring."""
    result, term = np.eye(len(matrix)), np.eye(len(matrix))
    for order in range(1, 20):
        term = term @ (matrix / 1024.0) / order
        result = result + term
    for _ in range(10):
        result = result @ result
    return result


def oscillation_error(step_s: float) -> tuple[float, float]:
    """Largest error of position and speed of any car in 20 s after a step of 100 kN."""
    train = replace(TRAIN, resistance=NO_DRAG)
    consist = Consist(train, LEVEL, front_m=0.0, step_s=step_s)
    consist.load(100_000.0, 0.0, 0.0)
    count = round(20.0 / step_s)
    found = []
    for _ in range(count):
        consist.step()
        found.append([*consist.car_fronts_m, *consist.car_speeds_mps])
    error = np.abs(np.array(found) - exact_states(consist, 100_000.0, step_s, count))
    cars = len(consist.cars)
    return float(error[:, :cars].max()), float(error[:, cars:].max())


def test_the_integrator_keeps_its_error_bound_against_the_exact_chain() -> None:
    position_m, speed_mps = oscillation_error(STEP_S)

    assert position_m < 0.02e-3
    assert speed_mps < 0.1e-3


def test_halving_the_step_quarters_the_error() -> None:
    coarse_m, coarse_mps = oscillation_error(STEP_S)
    fine_m, fine_mps = oscillation_error(STEP_S / 2.0)

    assert coarse_m / fine_m == pytest.approx(4.0, rel=0.25)
    assert coarse_mps / fine_mps == pytest.approx(4.0, rel=0.25)


def test_couplers_conserve_momentum() -> None:
    consist = make(replace(TRAIN, resistance=NO_DRAG))
    consist.car_speeds_mps[:] = [10.0, 9.0, 11.0, 10.5]
    before = float(inertias(consist) @ np.array(consist.car_speeds_mps))

    for _ in range(6000):
        consist.step()

    after = float(inertias(consist) @ np.array(consist.car_speeds_mps))
    assert after == pytest.approx(before, rel=1e-12)
    assert consist.car_speeds_mps == pytest.approx([consist.speed_mps] * 4, abs=1e-4)


def davis_n(train: Train, mass_kg: float, speed_mps: float) -> float:
    davis = train.resistance
    weight_kn = mass_kg * 9.81 / 1000.0
    return weight_kn * (
        davis.a_n_per_kn
        + davis.b_n_per_kn_per_mps * speed_mps
        + davis.c_n_per_kn_per_mps2 * speed_mps**2
    )


def test_the_energy_of_a_journey_over_the_florence_line_adds_up() -> None:
    """The run has traction, coasting and braking over a climb, a curve and a fall; energy is
    conserved."""
    line = load_line("florence")
    consist = make(TRAIN, line, front_m=500.0)
    work_j = losses_j = turnover_j = 0.0

    def height_j() -> float:
        rear_offset_m, total_j = 0.0, 0.0
        for car, front_m in zip(consist.cars, consist.car_fronts_m, strict=True):
            places_m = front_m - rear_offset_m - car.length_m * (np.arange(400) + 0.5) / 400.0
            total_j += car.mass_kg * 9.81 * float(np.mean([line.height_m(x) for x in places_m]))
            rear_offset_m += car.length_m
        return total_j

    start_j = height_j()
    for step in range(16_000):
        drive_n = 120_000.0 if step < 3000 else 30_000.0 if step < 14_000 else 0.0
        brake_n = 60_000.0 if step >= 14_000 else 0.0
        consist.load(drive_n, 0.5 * brake_n, 0.5 * brake_n)
        before_m, before_mps = list(consist.car_fronts_m), list(consist.car_speeds_mps)
        consist.step()
        moved_m = np.array(consist.car_fronts_m) - before_m
        speeds_mps = (np.array(consist.car_speeds_mps) + before_mps) / 2.0
        drive_j = float(np.dot(consist.drives_n, moved_m))
        work_j += drive_j
        turnover_j += abs(drive_j)
        losses_j += float(np.dot(consist.brakes_n, np.abs(moved_m)))
        rates_mps = np.diff(speeds_mps)
        losses_j += TRAIN.coupler.damping_ns_per_m * float(rates_mps @ rates_mps) * STEP_S
        rear_offset_m = 0.0
        for car, front_m, speed_mps, way_m in zip(
            consist.cars, consist.car_fronts_m, speeds_mps, moved_m, strict=True
        ):
            losses_j += davis_n(TRAIN, car.mass_kg, speed_mps) * way_m
            head_m = front_m - way_m / 2.0 - rear_offset_m
            under_m = max(0.0, min(head_m, 1700.0) - max(head_m - car.length_m, 1600.0))
            curve_n = car.mass_kg * 9.81e-3 * 500.0 / (100.0 - 30.0) * under_m / car.length_m
            losses_j += curve_n * way_m
            rear_offset_m += car.length_m

    stored_j = consist.kinetic_j() + consist.coupler_j() + height_j() - start_j
    assert consist.front_m > 2000.0
    assert turnover_j > 1.0e8
    assert work_j == pytest.approx(stored_j + losses_j, abs=1e-4 * turnover_j)


@pytest.mark.parametrize("train", [TRAIN, POINT], ids=["multi_mass", "point_mass"])
def test_coasting_down_follows_the_davis_formula(train: Train) -> None:
    """The oracle integrates the scalar equation with a fourth-order Runge-Kutta method."""
    consist = throw(make(train), 20.0)
    mass_kg = train.mass_kg

    def decel(speed_mps: float) -> float:
        return davis_n(train, mass_kg, speed_mps) / (1.08 * mass_kg)

    speed_mps, way_m, h = 20.0, 0.0, 0.01
    for _ in range(10_000):
        consist.step()
        k1 = -decel(speed_mps)
        k2 = -decel(speed_mps + h / 2 * k1)
        k3 = -decel(speed_mps + h / 2 * k2)
        k4 = -decel(speed_mps + h * k3)
        way_m += h * speed_mps + h * h / 6 * (k1 + k2 + k3)
        speed_mps += h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)

    assert consist.speed_mps == pytest.approx(speed_mps, abs=1e-5)
    assert consist.front_m == pytest.approx(way_m, abs=1e-3)


def test_a_coasting_train_comes_to_rest_and_stays() -> None:
    consist = throw(make(), 1.0)
    while consist.speed_mps != 0.0:
        consist.step()
    rest_m = list(consist.car_fronts_m)

    for _ in range(1000):
        consist.step()

    assert consist.car_fronts_m == rest_m
    assert consist.standing


def test_constant_effort_ends_at_the_speed_where_resistance_equals_it() -> None:
    consist = throw(make(), 24.0)
    effort_n = 12_000.0
    consist.load(effort_n, 0.0, 0.0)
    davis = TRAIN.resistance
    per_kn = effort_n / (TRAIN.mass_kg * 9.81e-3)
    a, b, c = davis.a_n_per_kn - per_kn, davis.b_n_per_kn_per_mps, davis.c_n_per_kn_per_mps2
    terminal_mps = (-b + math.sqrt(b * b - 4.0 * a * c)) / (2.0 * c)

    for _ in range(150_000):
        consist.step()

    assert consist.speed_mps == pytest.approx(terminal_mps, rel=1e-4)


@pytest.mark.parametrize("gradient_permille", [30.0, -30.0])
@pytest.mark.parametrize("train", [TRAIN, POINT], ids=["multi_mass", "point_mass"])
def test_a_braked_train_on_a_gradient_stands_exactly(
    train: Train, gradient_permille: float
) -> None:
    consist = make(train, slope(gradient_permille), front_m=500.0)
    brake_n = 0.8 * consist.inertia_kg
    consist.load(0.0, 0.5 * brake_n, 0.5 * brake_n)

    for _ in range(3000):
        consist.step()

    assert consist.car_fronts_m == [500.0] * len(consist.cars)
    assert consist.speed_mps == 0.0


@pytest.mark.parametrize(("gradient_permille", "sign"), [(30.0, -1.0), (-30.0, 1.0)])
def test_an_unbraked_train_rolls_downhill(gradient_permille: float, sign: float) -> None:
    """Newton's law with rotating masses: (gravity - static resistance) / 1.08 at the start."""
    consist = make(TRAIN, slope(gradient_permille), front_m=500.0)

    for _ in range(100):
        consist.step()

    rolling_mps2 = 9.81 * (0.030 - 0.002) / 1.08
    assert consist.speed_mps == pytest.approx(sign * rolling_mps2 * 1.0, rel=2e-3)
    assert consist.front_m - 500.0 == pytest.approx(sign * rolling_mps2 * 0.5, rel=2e-2)


def test_running_resistance_alone_holds_a_train_on_a_slight_gradient() -> None:
    held, rolling = make(TRAIN, slope(1.9)), make(TRAIN, slope(2.1))

    for _ in range(500):
        held.step()
        rolling.step()

    assert held.front_m == 0.0
    assert rolling.front_m < 0.0


def test_a_gradient_acts_on_the_share_of_the_train_that_lies_on_it() -> None:
    """A rigid train runs slowly up a ramp; the force follows from the mean gradient under its
    length."""
    line = line_of((GradientSection(100.0, 130.0, 30.0), GradientSection(130.0, 400.0, -10.0)))
    train = replace(POINT, resistance=NO_DRAG)
    consist = throw(make(train, line, front_m=90.0), 5.0)

    while consist.front_m < 260.0:
        middle_m = consist.front_m + consist.speed_mps * STEP_S / 2.0
        mean_permille = line.mean_gradient_permille(middle_m - train.length_m, middle_m)
        before_mps = consist.speed_mps
        consist.step()
        decel_mps2 = (before_mps - consist.speed_mps) / STEP_S
        assert decel_mps2 == pytest.approx(9.81 * mean_permille / 1000.0 / 1.08, abs=1e-9)


@pytest.mark.parametrize(
    ("radius_m", "per_kn"), [(100.0, 500.0 / 70.0), (299.0, 500.0 / 269.0), (400.0, 650.0 / 345.0)]
)
def test_a_curve_resists_by_roeckl(radius_m: float, per_kn: float) -> None:
    line = line_of(curves=(CurveSection(-500.0, 5000.0, radius_m),))
    consist = throw(make(replace(POINT, resistance=NO_DRAG), line), 10.0)

    for _ in range(100):
        consist.step()

    lost_mps = 9.81 * per_kn / 1000.0 / 1.08 * 1.0
    assert 10.0 - consist.speed_mps == pytest.approx(lost_mps, rel=1e-9)


@pytest.mark.parametrize("train", [TRAIN, POINT], ids=["multi_mass", "point_mass"])
def test_a_tunnel_multiplies_the_air_drag_of_each_car_whose_middle_is_inside(train: Train) -> None:
    """Without couplers' play, the deceleration is that of all cars' drag together."""
    davis = ResistanceConfig(0.0, 0.0, 0.008, Spread(0.0, 0.0))
    line = line_of(tunnels=(TunnelSection(30.0, 90.0, 2.5), TunnelSection(90.0, 110.0, 4.0)))
    consist = throw(make(replace(train, resistance=davis), line), 20.0)
    ratios = set()
    while consist.speed_mps > 0.0 and consist.front_m < 220.0:
        before_mps, front_m = consist.speed_mps, consist.front_m + consist.speed_mps * STEP_S / 2.0
        consist.step()
        drag_n, behind_m = 0.0, 0.0
        for car in consist.cars:
            middle_m = front_m - behind_m - car.length_m / 2.0
            ratio = 4.0 if 90.0 <= middle_m < 110.0 else 2.5 if 30.0 <= middle_m < 90.0 else 1.0
            drag_n += ratio * car.weight_n / 1000.0 * 0.008 * before_mps**2
            behind_m += car.length_m
            ratios.add(ratio)
        lost_n = (before_mps - consist.speed_mps) / STEP_S * consist.inertia_kg
        assert lost_n == pytest.approx(drag_n, rel=0.02)
    assert ratios == {1.0, 2.5, 4.0}


def test_braking_ends_where_constant_deceleration_ends() -> None:
    """d = v² / 2a; the step in which the train stops may add half of itself at most."""
    consist = throw(make(replace(POINT, resistance=NO_DRAG)), 15.0)
    brake_n = 0.9 * consist.inertia_kg
    consist.load(0.0, 0.5 * brake_n, 0.5 * brake_n)

    while consist.speed_mps > 0.0:
        consist.step()

    assert consist.front_m == pytest.approx(15.0**2 / 1.8, abs=0.5 * 0.9 * STEP_S**2)
    assert consist.speed_mps == 0.0


@given(
    brakes_mps2=st.lists(st.floats(0.0, 1.5), min_size=1, max_size=8),
    speed_mps=st.floats(0.0, 22.0),
    motor_share=st.floats(0.0, 1.0),
)
def test_brakes_never_add_energy(
    brakes_mps2: list[float], speed_mps: float, motor_share: float
) -> None:
    consist = throw(make(), speed_mps)
    energy_j = consist.kinetic_j()
    slack_j = 1e-4 * energy_j + 1e-9

    for brake_mps2 in brakes_mps2:
        brake_n = brake_mps2 * consist.inertia_kg
        consist.load(0.0, motor_share * brake_n, (1.0 - motor_share) * brake_n)
        for _ in range(150):
            consist.step()
        left_j = consist.kinetic_j() + consist.coupler_j()
        assert left_j <= energy_j + slack_j
        energy_j = left_j


@given(
    speed_mps=st.floats(-20.0, 20.0),
    brake_mps2=st.floats(0.0, 1.5),
    gradient_permille=st.floats(-40.0, 40.0),
)
def test_friction_never_drives_a_rigid_train_the_other_way(
    speed_mps: float, brake_mps2: float, gradient_permille: float
) -> None:
    """The speed may only pass through zero if gravity is stronger than everything that holds."""
    consist = throw(make(POINT, slope(gradient_permille), front_m=5000.0), speed_mps)
    brake_n = brake_mps2 * consist.inertia_kg
    consist.load(0.0, 0.5 * brake_n, 0.5 * brake_n)
    weight_n = POINT.mass_kg * 9.81
    held = brake_n + 0.002 * weight_n >= abs(gradient_permille) / 1000.0 * weight_n

    for _ in range(600):
        before_mps = consist.speed_mps
        consist.step()
        if held:
            assert consist.speed_mps * before_mps >= 0.0
            assert abs(consist.speed_mps) <= abs(before_mps)


def test_stiff_couplers_are_resolved_by_sub_steps() -> None:
    """With a hundred times the stiffness the train stays together and keeps its momentum."""
    coupler = replace(TRAIN.coupler, stiffness_n_per_m=3.0e8, damping_ns_per_m=3.0e6)
    consist = make(replace(TRAIN, coupler=coupler, resistance=NO_DRAG))
    consist.load(100_000.0, 0.0, 0.0)

    for _ in range(1000):
        consist.step()

    assert consist.speed_mps == pytest.approx(100_000.0 / consist.inertia_kg * 10.0, rel=1e-9)
    assert max(consist.car_fronts_m) - min(consist.car_fronts_m) < 1e-3


def test_both_models_agree_on_the_mean_motion() -> None:
    line = load_line("florence")
    fine, rigid = make(TRAIN, line, 500.0), make(POINT, line, 500.0)

    for step in range(6000):
        drive_n = 120_000.0 if step < 2500 else 0.0
        fine.load(drive_n, 0.0, 0.0)
        rigid.load(drive_n, 0.0, 0.0)
        fine.step()
        rigid.step()

    assert fine.speed_mps == pytest.approx(rigid.speed_mps, abs=0.01)
    assert fine.front_m == pytest.approx(rigid.front_m, abs=0.5)


def test_a_train_beyond_the_line_runs_on_level_track() -> None:
    """No gradient is known out there, so the motion does not change."""
    line = load_line("florence")
    consist = throw(make(replace(TRAIN, resistance=NO_DRAG), line, 4690.0), 10.0)

    for _ in range(500):
        consist.step()

    assert consist.speed_mps == pytest.approx(10.0)
