"""Parts of the train that a program outside the bench emulates."""

from collections.abc import Mapping
from typing import Any

import pytest

from can_dbc.nodes import Node
from firmware_py.buses.inproc import InprocBus
from firmware_py.clock.clock import LockstepClock
from firmware_py.clock.executive import run
from firmware_py.ports import CanFrame
from firmware_py.radio.inproc_radio import InprocRadio
from firmware_py.settings import SettingsError
from firmware_py.tag_reader.inproc_line import inproc_line
from plant_emulator.faults.fitting import check_provided, nodes_of
from plant_emulator.faults.kinds import CATALOGUE, FaultPlace
from plant_emulator.faults.plan import read_faults
from plant_emulator.process import TRUTH_COLUMNS, PlantDevice
from plant_emulator.truth import Truth
from plant_emulator.world import plan_scenario

END_NS = 1_000_000_000
ROLLING = {"front_m": 0.0, "speed_mps": 5.0, "accel_mps2": 0.0}


class Given:
    """A program that reports fixed truth, and sends one frame and one piece of serial bytes."""

    def __init__(self, moves: bool, nodes: set[Node], truth: Mapping[str, float]) -> None:
        self.moves, self.nodes = moves, frozenset(nodes)
        self.truth = truth
        self.asked: list[tuple[int, Mapping[str, float]]] = []
        self.frames: list[tuple[Node, int, bytes]] = []
        self.serial: list[bytes] = []

    def step(self, end_ns: int, inputs: Mapping[str, float]) -> Mapping[str, float]:
        self.asked.append((end_ns, inputs))
        return self.truth

    def take_frames(self) -> list[tuple[Node, int, bytes]]:
        taken, self.frames = self.frames, []
        return taken

    def take_serial(self) -> list[bytes]:
        taken, self.serial = self.serial, []
        return taken

    def stop(self) -> None:
        self.stopped = True


class Ran:
    """A second of the plant with a foreign program."""

    def __init__(self, foreign: Given) -> None:
        self.frames: list[tuple[str, int, bytes]] = []
        self.truth = Truth()
        self.rows: list[dict[str, Any]] = []
        bus = InprocBus("vcan0", 250_000, self._record)
        tags, self.line = inproc_line()
        plant = PlantDevice(
            plan_scenario(seed=1),
            open_port=lambda node, ids: bus.port(node.name, ids),
            tags=tags,
            radio=InprocRadio().port("wayside", ()),
            truth=self,
            start_ns=0,
            observer=self._observe,
            foreign=foreign,
        )
        self.plant = plant
        run([plant.executive], LockstepClock(), lambda now_ns: now_ns > END_NS)
        plant.stop(END_NS)
        bus.advance(2 * END_NS)

    def _record(self, frame: CanFrame, node: str) -> None:
        self.frames.append((node, frame.can_id, frame.data))

    def _observe(self, truth: Truth, now_ns: int) -> None:
        self.truth = truth

    def row(self, *values: object) -> None:
        self.rows.append(dict(zip(TRUTH_COLUMNS, values, strict=True)))


def test_the_program_is_asked_once_a_step_and_its_motion_is_the_trains() -> None:
    foreign = Given(True, set(), ROLLING)

    ran = Ran(foreign)

    assert [at_ns for at_ns, _ in foreign.asked] == list(range(10_000_000, END_NS + 1, 10_000_000))
    assert (ran.truth.front_m, ran.truth.speed_mps) == (0.0, 5.0)
    assert ran.plant.world.consist.car_speeds_mps == [5.0] * 4
    assert foreign.asked[-1][1]["motor_brake_n"] > 0.0  # No command: the brake is on.


def test_a_provided_node_is_silent_on_the_benchs_side_and_speaks_by_the_program() -> None:
    foreign = Given(False, {Node.HVB}, {"voltage_v": 700.0})
    foreign.frames = [(Node.HVB, 0x188, b"\x01\x02")]

    ran = Ran(foreign)

    assert [frame for frame in ran.frames if frame[0] == "HVB"] == [("HVB", 0x188, b"\x01\x02")]
    assert ran.truth.voltage_v == 700.0
    assert any(node == "TCU" for node, _, _ in ran.frames)


def test_the_forces_of_a_provided_traction_unit_move_the_benchs_train() -> None:
    forces = {"drive_n": 4.0e5, "traction_cut": 0.0}
    brakes_off = {"brake_n": 0.0, "emergency": 0.0, "emergency_mps2": 1.2, "holding": 0.0}
    foreign = Given(False, {Node.TCU, Node.BCU}, {**forces, **brakes_off})

    ran = Ran(foreign)

    assert foreign.asked[-1][1]["motor_brake_n"] == foreign.asked[-1][1]["drive_n"] == 0.0
    assert ran.truth.speed_mps > 0.5
    assert ran.truth.drive_n == 4.0e5
    last = ran.rows[-1]
    assert (last["emergency"], last["holding"], last["brake_force_n"]) == (False, False, 0.0)


def test_the_program_is_the_tag_reader_and_the_doors() -> None:
    doors = {"doors_locked": 0.0, "left_open": 1.0, "right_open": 0.0}
    cars = {"left_cars": 15.0, "right_cars": 0.0, "tags_read": 3.0}
    foreign = Given(False, {Node.BTM, Node.DCU}, {**doors, **cars})
    foreign.serial = [b"tag"]

    ran = Ran(foreign)

    assert b"".join(each.data for each in ran.line.receive(2 * END_NS)) == b"tag"
    assert (ran.truth.left_open, ran.truth.left_cars, ran.truth.tags_read) == (1.0, 15.0, 3.0)
    last = ran.rows[-1]
    assert (last["door_left"].name, last["door_right"].name) == ("OPEN", "LOCKED")
    assert (last["doors_locked"], last["tags_read"]) == (False, 3)


@pytest.mark.parametrize(
    ("table", "node"),
    [
        ({"kind": "brake_weak", "gain_ratio": 0.5}, Node.BCU),
        ({"kind": "traction_late", "delay_s": 1.0}, Node.TCU),
        ({"kind": "low_adhesion", "adhesion_ratio": 0.05}, Node.BCU),
        ({"kind": "door_lock_lost"}, Node.DCU),
        ({"kind": "tacho_stuck"}, Node.ODO),
        ({"kind": "antenna_dead"}, Node.BTM),
        ({"kind": "fire"}, Node.TCMS),
        ({"kind": "line_voltage", "voltage_v": 500.0}, Node.HVB),
    ],
)
def test_a_fault_in_a_provided_node_is_refused_and_names_it(
    table: dict[str, Any], node: Node
) -> None:
    faults = read_faults([table], "x")

    with pytest.raises(
        SettingsError, match=rf"{table['kind']} acts in the bench's own {node.name}"
    ):
        check_provided(faults, Given(True, {node}, {}))
    check_provided(faults, Given(True, set(Node) - set(nodes_of(faults[0].kind)), {}))


def test_only_faults_outside_the_train_act_in_no_node() -> None:
    outside = {FaultPlace.BUS, FaultPlace.PROCESS, FaultPlace.RADIO, FaultPlace.WAYSIDE}
    outside |= {FaultPlace.SERIAL}
    inside = {kind.name for kind in CATALOGUE.values() if kind.place not in outside}

    assert {name for name in inside if not nodes_of(CATALOGUE[name])} == {"train_longer"}
