"""The supply of trains that turn round: places on it, its energy, and supplies that do not fit."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Final, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.settings import SettingsError
from firmware_py.trackdb.circuit import load_network
from firmware_py.trackdb.network import Running, TrackZone
from firmware_py.trackdb.paths import TrackPlace
from metro_hil.line.energy import energy_of, keys_of_network
from metro_hil.line.turning.supply import FleetSupply
from metro_hil.model.network_places import NetworkAxis
from metro_hil.model.network_supply import supply_of
from metro_hil.model.service import load_service
from plant_emulator.power import HighVoltageBox, flow
from plant_emulator.power.box import Due, Wish
from plant_emulator.power.network import Section, Substation
from plant_emulator.power.supplies import Supply
from plant_emulator.traffic.coupling import INTERVAL_NS, INTERVAL_S, TrainFeed
from plant_emulator.train_config import load_train
from plant_emulator.world import STEP_S

EXAMPLES: Final = Path(__file__).resolve().parents[4] / "docs/examples/line"
TERMINUS: Final = load_network(str(EXAMPLES / "terminus.toml"))
NO_LOAD_V, SOURCE_OHM, OHM_PER_M = 836.0, 0.015, 20e-6
ONE_END: Final = Supply(
    "one end",
    (Substation("a", NO_LOAD_V, SOURCE_OHM),),
    (Section("a", "b", 0.0, 1455.0, OHM_PER_M * 1000.0),),
)
TRAIN: Final = load_train("typeB4")


class CompiledBox(HighVoltageBox):
    """Gives its powers as the compiled one does: a record that is no tuple."""

    def take_load(self, interval_s: float) -> tuple[Wish, Due]:
        wish, due = super().take_load(interval_s)
        return cast(Wish, SimpleNamespace(**wish._asdict())), due


class StandIn:
    """A train whose motors do what a test says."""

    def __init__(self, number: int, middle: TrackPlace, front: TrackPlace | None = None) -> None:
        self.number, self.middle, self.on_network = number, middle, True
        self.front = front or middle
        self.power: HighVoltageBox | None = CompiledBox(
            TRAIN.supply,
            step_s=STEP_S,
            traction_efficiency_ratio=0.8,
            electric_efficiency_ratio=0.8,
        )
        self.power.join()

    @property
    def box(self) -> HighVoltageBox:
        assert self.power is not None
        return self.power

    def work(self, drive_w: float) -> None:
        """Pull for an interval, or brake with a negative power."""
        for _ in range(round(INTERVAL_S / STEP_S)):
            self.box.step(max(0.0, drive_w) * STEP_S, max(0.0, -drive_w) * STEP_S)

    def feed(self, feed: TrainFeed, due: Due) -> None:
        self.box.fed(feed.voltage_v, feed.chopped_ratio, feed.effort_ratio, due, INTERVAL_S)


def place(track: str, at_m: float, running: Running = Running.UP) -> TrackPlace:
    return TrackPlace(track, at_m, running)


def test_places_on_all_tracks_lie_on_one_axis() -> None:
    axis = NetworkAxis(TERMINUS)

    # The siding behind North has its own chainage; both running tracks lie beside each other.
    assert axis.place_m(place("south", 60.0)) == 60.0
    assert axis.place_m(place("east", 700.0)) == axis.place_m(place("west", 700.0)) == 700.0
    assert axis.place_m(place("north", 100.0, Running.DOWN)) == pytest.approx(1375.0)
    assert axis.stretch_m("north") == pytest.approx((1275.0, 1455.0))


@given(
    powers_w=st.lists(
        st.tuples(st.floats(-1.5e6, 1.5e6), st.floats(-1.5e6, 1.5e6)), min_size=1, max_size=6
    )
)
def test_no_energy_is_lost_between_the_grid_and_two_trains(
    powers_w: list[tuple[float, float]],
) -> None:
    """The test adds up currents and voltages at the trains, and the losses by Ohm's law."""
    trains = [StandIn(1, place("east", 400.0)), StandIn(2, place("north", 100.0))]
    near, far = (train.box for train in trains)
    supply = FleetSupply(ONE_END, TERMINUS, headway_s=0.0)
    grid_j = lost_j = 0.0
    for count, pair in enumerate(powers_w, start=1):
        for train, power_w in zip(trains, pair, strict=True):
            train.work(power_w)
        supply.step(count * INTERVAL_NS, trains)
        both_a = near.current_a + far.current_a
        fall_v, rest_v = both_a * OHM_PER_M * 400.0, far.current_a * OHM_PER_M * 975.0
        assert far.voltage_v == pytest.approx(near.voltage_v - rest_v, abs=1e-3)
        volts = near.voltage_v + fall_v
        source_a = both_a + flow.IDLE_S * volts
        lost_w = fall_v * both_a + rest_v * far.current_a
        lost_w += (NO_LOAD_V - volts) * source_a + flow.IDLE_S * volts**2
        grid_j += NO_LOAD_V * source_a * INTERVAL_S
        lost_j += lost_w * INTERVAL_S
    books = supply.coupling.books
    assert supply.coupling.network.unconverged == 0
    assert books.sources_j == pytest.approx(grid_j, rel=1e-5, abs=100.0)
    assert books.lost_j == pytest.approx(lost_j, rel=1e-5, abs=100.0)
    used_j = sum(box.traction_j + box.auxiliary_j - box.braking_j for box in (near, far))
    burnt_j = near.resistor_j + far.resistor_j
    assert grid_j == pytest.approx(used_j + burnt_j + lost_j, rel=1e-5, abs=100.0)
    keys = keys_of_network(supply.coupling, [energy_of(near), energy_of(far)])
    assert abs(keys["metered_ratio"]) < 1e-9


def test_the_last_energy_of_a_train_that_leaves_is_booked_once() -> None:
    train = StandIn(1, place("south", 60.0))
    supply = FleetSupply(ONE_END, TERMINUS, headway_s=0.0)
    supply.step(INTERVAL_NS, [train])
    train.work(500_000.0)
    train.on_network = False

    for count in (2, 3):
        supply.step(count * INTERVAL_NS, [train])

    assert train.box.drawn_j == pytest.approx(train.box.traction_j + train.box.auxiliary_j)
    assert supply.coupling.books.trains_j == pytest.approx(train.box.drawn_j)


def test_the_energy_of_a_train_belongs_to_the_power_section_of_its_front() -> None:
    """The border lies at 700 m of both running tracks; the tracks at the ends have no section."""
    running = [
        replace(
            TERMINUS.track(name),
            power_sections=(TrackZone(180.0, 700.0, "S1"), TrackZone(700.0, 1275.0, "S2")),
        )
        if name in ("east", "west")
        else TERMINUS.track(name)
        for name in (track.name for track in TERMINUS.tracks)
    ]
    trains = [
        StandIn(1, place("east", 650.0), place("east", 700.5)),
        StandIn(2, place("west", 750.0), place("west", 699.5)),
        StandIn(3, place("south", 60.0)),
    ]
    supply = FleetSupply(ONE_END, replace(TERMINUS, tracks=tuple(running)), headway_s=0.0)
    for train, power_w in zip(trains, (-1.5e6, 0.5e6, 0.2e6), strict=True):
        train.work(power_w)

    supply.step(INTERVAL_NS, trains)

    books = supply.coupling.books
    assert books.drawn_j == {"S1": pytest.approx(trains[1].box.drawn_j), "S2": 0.0}
    assert books.fed_back_j == {"S1": 0.0, "S2": pytest.approx(trains[0].box.returned_j)}
    assert trains[0].box.returned_j > 0.0 < trains[1].box.drawn_j
    keys = keys_of_network(supply.coupling, [energy_of(train.box) for train in trains])
    assert [row["section"] for row in keys["sections"]] == ["S1", "S2"]


def test_the_full_service_is_a_whole_number_of_headways_with_all_trains() -> None:
    trains = [StandIn(1, place("east", 300.0)), StandIn(2, place("west", 900.0))]
    trains[1].on_network, trains[1].power = False, None
    supply = FleetSupply(ONE_END, TERMINUS, headway_s=2.0)
    for count in range(1, 40):
        if count == 10:
            trains[1] = StandIn(2, place("west", 900.0))
        for train in trains:
            if train.power is not None:
                train.work(0.0)
        supply.step(count * INTERVAL_NS, trains)

    full = supply.full_service

    assert full is not None
    assert (full.from_s, full.to_s) == (2.0, 6.0)
    # Auxiliaries of both trains and the load of the substation for 4 s, and losses of the network.
    rest_w = 2 * TRAIN.supply.auxiliary_w + flow.IDLE_S * NO_LOAD_V**2
    assert full.actual_j == pytest.approx(4.0 * rest_w, rel=0.01)
    assert (full.regenerated_j, full.resistor_j) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("joints", "problem"),
    [
        (
            [("a", "b", 0.0, 1300.0)],
            "no section at 1365 m, but track north lies there",
        ),
        (
            [("a", "b", 0.0, 1455.0), ("b", "far", 1500.0, 2500.0)],
            "b-far from 1500 m to 2500 m feeds no track of terminus, whose tracks lie from 0 m to "
            "1455 m",
        ),
    ],
)
def test_a_supply_that_does_not_fit_the_network_is_refused(
    joints: list[tuple[str, str, float, float]], problem: str, tmp_path: Path
) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(
        'name = "mine"\n[[substations]]\njoint = "a"\nno_load_v = 836.0\nsource_ohm = 0.015\n'
        + "".join(
            f'[[sections]]\nbegin = "{begin}"\nend = "{end}"\nbegin_m = {begin_m}\n'
            f"end_m = {end_m}\nohm_per_km = 0.02\n"
            for begin, end, begin_m, end_m in joints
        ),
        encoding="utf-8",
    )
    trips = load_service(str(EXAMPLES / "every_90_s.toml"))

    with pytest.raises(SettingsError) as refused:
        supply_of(str(file), TERMINUS, trips)

    assert f"supply {file}: sections: " in str(refused.value)
    assert problem in str(refused.value)
