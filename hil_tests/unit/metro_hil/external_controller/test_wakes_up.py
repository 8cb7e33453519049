"""What a controller that wakes up in a run starts from."""

from firmware_py.trackdb import load_line
from metro_hil.external_controller.choice import memory_of
from metro_hil.model.mission import Journey
from vobc.config import load_config, plan_mission
from vobc.process import remembered_start
from vobc.vocabulary import PlaceProof

LINE = load_line("florence")
MISSION = plan_mission(LINE, "II", "III")


def test_a_controller_that_wakes_up_remembers_its_stop_but_has_no_proof_of_it() -> None:
    start = remembered_start(load_config("florence4"), memory_of(Journey(LINE, MISSION, True)))

    assert start is not None
    assert start.front_m == MISSION.start.stop_m
    assert start.proof is PlaceProof.REMEMBERED


def test_a_train_that_was_set_up_has_a_memory_without_a_place() -> None:
    assert remembered_start(load_config("florence4"), memory_of(Journey(LINE, MISSION))) is None
