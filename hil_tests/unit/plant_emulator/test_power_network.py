"""The DC network against other solution methods and against physical laws."""

import dataclasses
import math
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plant_emulator.power.network import (
    Inverter,
    Load,
    Network,
    NetworkError,
    Section,
    Storage,
    Substation,
    Voltages,
)

AT_M = (0.0, 1900.0, 3799.0, 5824.0, 7788.0)
VOLTAGES = Voltages()


def line(no_load_v: float = 836.0, source_ohm: float = 0.015, ohm_per_km: float = 0.02) -> Network:
    names = [f"S{index}" for index in range(len(AT_M))]
    sections = [
        Section(names[index], names[index + 1], AT_M[index], AT_M[index + 1], ohm_per_km)
        for index in range(len(AT_M) - 1)
    ]
    return Network(sections, [Substation(name, no_load_v, source_ohm) for name in names])


loads = st.builds(
    Load,
    at_m=st.floats(0.0, 7788.0),
    wants_w=st.one_of(st.just(0.0), st.floats(0.0, 2.4e6)),
    gives_w=st.one_of(st.just(0.0), st.floats(0.0, 2.6e6)),
    auxiliary_w=st.floats(0.0, 2.0e5),
)


@settings(max_examples=150, deadline=None)
@given(trains=st.lists(loads, min_size=0, max_size=9), weak=st.booleans())
def test_power_is_conserved_and_every_instant_has_a_solution(
    trains: list[Load], weak: bool
) -> None:
    network = line(850.0, 0.015, 0.03) if weak else line()

    fed, balance = network.solve(trains)

    assert network.unconverged == 0
    assert abs(balance.error_w) <= 1.0
    for train in fed:
        assert VOLTAGES.floor_v < train.voltage_v <= VOLTAGES.chops_all_v + 1.0
        assert 0.0 <= train.resistor_w <= train.regenerated_w + 1e-6
    # A rectifier takes no power back.
    assert balance.sources_w >= 0.0


@settings(max_examples=25, deadline=None)
@given(trains=st.lists(loads, min_size=1, max_size=5))
def test_kirchhoffs_law_holds_at_every_node(trains: list[Load]) -> None:
    """The test uses the whole conductance matrix, with rectifiers and trains as documented."""
    network = line()
    fed, _ = network.solve(trains)
    places = [(at_m, -1) for at_m in AT_M] + [(t.at_m, k) for k, t in enumerate(trains)]
    # A train exactly at a joint belongs between it and the joint before; at the first joint it
    # belongs behind it.
    places.sort(key=lambda place: (place[0], place[1] < 0 and place[0] > 0.0))
    n = len(places)
    matrix = np.zeros((n, n))
    for i in range(n - 1):
        gap_m = max(0.1, places[i + 1][0] - places[i][0])
        siemens = 1.0 / (0.02 * gap_m / 1000.0)
        matrix[i, i] += siemens
        matrix[i + 1, i + 1] += siemens
        matrix[i, i + 1] -= siemens
        matrix[i + 1, i] -= siemens

    def missing_a(volts: np.ndarray) -> np.ndarray:
        out: np.ndarray = -matrix @ volts
        for i, (_, train) in enumerate(places):
            if train < 0:
                lack = 836.0 - volts[i]
                out[i] += (lack + math.hypot(lack, 2.0)) / 0.03 - 0.005 * volts[i]
            else:
                load = trains[train]
                low = min(1.0, max(0.0, (volts[i] - 500.0) / 100.0))
                high = min(1.0, max(0.0, (volts[i] - 880.0) / 20.0))
                power_w = load.wants_w * low * low * (3.0 - 2.0 * low) + load.auxiliary_w
                power_w -= load.gives_w * (1.0 - high**2)
                out[i] -= power_w / volts[i]
        return out

    at_joints_v = list(network.joint_voltages_v().values())
    volts = [
        fed[train].voltage_v if train >= 0 else at_joints_v[AT_M.index(at_m)]
        for at_m, train in places
    ]
    assert np.max(np.abs(missing_a(np.array(volts)))) < 0.01


def test_one_train_under_one_substation_is_the_root_of_a_quadratic() -> None:
    network = Network([Section("A", "B", 0.0, 3000.0, 0.03)], [Substation("A", 836.0, 0.02)])
    power_w, ohm = 1.5e6, 0.02 + 0.03 * 2.0

    fed, _ = network.solve([Load(2000.0, power_w, 0.0, 0.0)])

    voltage_v = (836.0 + math.sqrt(836.0**2 - 4.0 * ohm * power_w)) / 2.0
    # The substation's own load and the knee of its rectifier explain the rest.
    assert fed[0].voltage_v == pytest.approx(voltage_v, abs=0.15)


def test_two_ends_feed_a_train_by_their_distance() -> None:
    """Equal sources are 4 km apart. A quarter of the way along, three quarters of the power come
    from the nearer one."""
    sections = [Section("A", "B", 0.0, 4000.0, 0.03)]
    network = Network(sections, [Substation("A", 836.0, 0.02), Substation("B", 836.0, 0.02)])

    fed, _ = network.solve([Load(1000.0, 1.0e6, 0.0, 0.0)])

    ohm = 1.0 / (1.0 / (0.03 * 1.0 + 0.02) + 1.0 / (0.03 * 3.0 + 0.02))
    assert 836.0 - fed[0].voltage_v == pytest.approx(ohm * fed[0].current_a, rel=0.02)


def test_a_branch_of_the_tree_is_connected_at_its_joint() -> None:
    sections = [
        Section("A", "M", 0.0, 1000.0, 0.03),
        Section("M", "B", 1000.0, 2000.0, 0.03),
        Section("depot", "M", 9000.0, 9500.0, 0.06),
    ]
    network = Network(sections, [Substation("A", 836.0, 0.02)])

    fed, balance = network.solve([Load(9000.0, 5.0e5, 0.0, 0.0), Load(1999.0, 0.0, 0.0, 1.0e5)])

    ohm_to_joint = 0.02 + 0.03
    both_a = fed[0].current_a + fed[1].current_a
    at_joint_v = 836.0 - ohm_to_joint * both_a
    assert fed[0].voltage_v == pytest.approx(at_joint_v - 0.03 * fed[0].current_a, abs=0.1)
    assert abs(balance.error_w) < 1.0


@settings(max_examples=40, deadline=None)
@given(gives_w=st.floats(1e5, 2.5e6), takes_w=st.floats(0.0, 2.0e6), more_w=st.floats(1e3, 1.0e6))
def test_more_demand_nearby_never_increases_the_resistor_power(
    gives_w: float, takes_w: float, more_w: float
) -> None:
    def burnt_w(wants_w: float) -> float:
        fed, _ = line().solve([Load(2000.0, 0.0, gives_w, 0.0), Load(2600.0, wants_w, 0.0, 0.0)])
        return fed[0].resistor_w

    assert burnt_w(takes_w + more_w) <= burnt_w(takes_w) + 1.0


def test_a_train_takes_less_power_at_low_voltage() -> None:
    network = Network([Section("A", "B", 0.0, 6000.0, 0.03)], [Substation("A", 750.0, 0.03)])

    fed, _ = network.solve([Load(6000.0, 3.0e6, 0.0, 1.0e5)])

    assert network.unconverged == 0
    assert VOLTAGES.no_effort_v < fed[0].voltage_v < VOLTAGES.full_effort_v
    assert 0.0 < fed[0].traction_w < 3.0e6


def test_without_a_consumer_all_regenerated_power_goes_into_the_resistor() -> None:
    fed, balance = line().solve([Load(3000.0, 0.0, 2.0e6, 0.0)])

    assert fed[0].resistor_w == pytest.approx(2.0e6, rel=0.01)
    assert fed[0].voltage_v > VOLTAGES.chops_from_v
    # The remaining current is the leakage of the smooth rectifier knee.
    assert balance.sources_w < 2.0e5


INVERTER = Inverter(from_v=850.0, source_ohm=0.02, power_max_w=1.0e6)
STORAGE = Storage("B", 800.0, 845.0, 0.02, power_max_w=1.0e6, capacity_kwh=1.0)


def with_storage(storage: Storage = STORAGE, inverter: Inverter | None = None) -> Network:
    sections = [Section("A", "B", 0.0, 4000.0, 0.02)]
    return Network(sections, [Substation("A", 836.0, 0.015, inverter)], storages=[storage])


def test_an_inverter_returns_what_resistors_would_take_up_to_its_power() -> None:
    sections = [Section("A", "B", 0.0, 1000.0, 0.02)]
    train = [Load(500.0, 0.0, 5.0e5, 0.0)]
    without, _ = Network(sections, [Substation("A", 836.0, 0.015)]).solve(train)
    reversible = Network(sections, [Substation("A", 836.0, 0.015, INVERTER)])

    fed, balance = reversible.solve(train)

    assert without[0].resistor_w > 4.5e5
    assert fed[0].resistor_w < 1.0
    assert 4.0e5 < balance.returned_w < 5.0e5
    assert reversible.delivered_w()[0] == pytest.approx(balance.sources_w)
    _, most = reversible.solve([Load(500.0, 0.0, 4.0e6, 0.0)])
    assert 8.0e5 < most.returned_w <= 1.0e6


@settings(max_examples=40, deadline=None)
@given(trains=st.lists(loads, max_size=5), charge_ratio=st.floats(0.0, 1.0))
def test_power_is_conserved_with_inverter_and_storage(
    trains: list[Load], charge_ratio: float
) -> None:
    storage = dataclasses.replace(STORAGE, charge_ratio=charge_ratio)
    network = with_storage(storage, INVERTER)

    _, balance = network.solve([load._replace(at_m=load.at_m / 2.0) for load in trains])

    assert network.unconverged == 0
    assert abs(balance.error_w) <= 1.0
    assert abs(balance.storages_w) <= storage.power_max_w + 1.0
    assert 0.0 <= balance.returned_w <= INVERTER.power_max_w


@pytest.mark.parametrize(
    ("load", "end_kwh"), [(Load(3900.0, 2e6, 0.0, 0.0), 0.0), (Load(3900.0, 0.0, 2e6, 0.0), 1.0)]
)
def test_a_storage_gives_all_it_holds_or_fills_up_and_then_rests(
    load: Load, end_kwh: float
) -> None:
    network = with_storage()
    given_j = 0.0
    for _ in range(40):
        _, balance = network.solve([load])
        given_j += balance.storages_w * 0.5
        network.advance(0.5)
        assert 0.0 <= network.charges_j[0] <= 3.6e6

    assert network.charges_j[0] == pytest.approx(end_kwh * 3.6e6, abs=2e4)
    # Half of the capacity went in or out, with the loss of one direction.
    lost_ratio = 0.95 if end_kwh == 0.0 else -1.0 / 0.95
    assert given_j == pytest.approx(1.8e6 * lost_ratio, rel=0.02)
    assert abs(balance.storages_w) < 2e4


@pytest.mark.parametrize(
    ("inverter", "storages", "complaint"),
    [
        (Inverter(830.0, 0.02, 1e6), [], r"substation A: inverter\.from_v 830\.0 is not above"),
        (None, [dataclasses.replace(STORAGE, joint="C")], "storage C: no section"),
        (None, [dataclasses.replace(STORAGE, joint="A")], "storage A: is defined twice"),
        (None, [dataclasses.replace(STORAGE, gives_below_v=90.0)], r"gives_below_v 90\.0 is not"),
    ],
)
def test_a_wrong_inverter_or_storage_is_refused_by_name(
    inverter: Inverter | None, storages: list[Storage], complaint: str
) -> None:
    with pytest.raises(NetworkError, match=complaint):
        Network(
            [Section("A", "B", 0.0, 1.0, 0.02)],
            [Substation("A", 836.0, 0.02, inverter)],
            storages=storages,
        )


@pytest.mark.parametrize(
    ("sections", "substations", "complaint"),
    [
        ([], [], "no section"),
        ([Section("A", "A", 0.0, 1.0, 0.02)], [], "section A-A: has no length"),
        ([Section("A", "B", 0.0, 1.0, 0.0)], [], r"section A-B: ohm_per_km 0\.0"),
        (
            [Section("A", "B", 0.0, 1.0, 0.02), Section("B", "A", 1.0, 2.0, 0.02)],
            [],
            "section B-A: closes a ring",
        ),
        ([Section("A", "B", 0.0, 1.0, 0.02)], [Substation("C", 800.0, 0.02)], "substation C: no"),
        ([Section("A", "B", 0.0, 1.0, 0.02)], [Substation("A", 100.0, 0.02)], "no_load_v 100"),
    ],
)
def test_an_invalid_network_is_refused_by_name(
    sections: list[Section], substations: list[Substation], complaint: str
) -> None:
    with pytest.raises(NetworkError, match=complaint):
        Network(sections, substations)


def test_without_the_compiler_the_figures_are_the_same() -> None:
    code = (
        "import sys; sys.modules['numba'] = None\n"
        "from metro_hil.energy.compiled import COMPILED\n"
        "from plant_emulator.power.network import *\n"
        "assert not COMPILED\n"
        "n = Network([Section('A', 'B', 0.0, 3000.0, 0.03)], [Substation('A', 836.0, 0.02)])\n"
        "print(repr([float(f.voltage_v) for f in n.solve([Load(2000.0, 1.5e6, 0.0, 1e5),"
        " Load(900.0, 0.0, 2e6, 1e5)])[0]]))\n"
    )
    plain = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout
    network = Network([Section("A", "B", 0.0, 3000.0, 0.03)], [Substation("A", 836.0, 0.02)])

    fed, _ = network.solve([Load(2000.0, 1.5e6, 0.0, 1e5), Load(900.0, 0.0, 2e6, 1e5)])

    for told, train in zip(plain.strip("[]\n").split(", "), fed, strict=True):
        assert float(told) == pytest.approx(train.voltage_v, abs=1e-6)
