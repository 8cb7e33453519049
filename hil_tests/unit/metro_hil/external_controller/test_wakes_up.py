"""The initial state of a controller that wakes up during a run."""

from firmware_py.trackdb import load_line
from metro_hil.external_controller.choice import memory_of
from metro_hil.model.mission import Journey
from vobc.config import load_config, plan_mission
from vobc.process import remembered_start
from vobc.vocabulary import PlaceProof

LINE = load_line("florence")
CONFIG = load_config("florence4")
MISSION = plan_mission(LINE, "II", "III")


def test_a_waking_controller_remembers_its_position_without_proof() -> None:
    start = remembered_start(CONFIG, LINE, memory_of(Journey(LINE, MISSION, True), CONFIG))

    assert start is not None
    assert start.front_m == MISSION.start.stop_m
    assert start.proof is PlaceProof.REMEMBERED


def test_a_newly_set_up_train_has_a_memory_without_a_position() -> None:
    assert remembered_start(CONFIG, LINE, memory_of(Journey(LINE, MISSION), CONFIG)) is None


def test_a_memory_of_another_line_gives_no_place() -> None:
    memory = memory_of(Journey(LINE, MISSION, True, load_line("hefei")), CONFIG)

    assert memory.front_m == MISSION.start.stop_m
    assert remembered_start(CONFIG, LINE, memory) is None
