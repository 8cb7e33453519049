"""One hop behind each output stage in virtual time: where it stops, what leaves, the same bytes."""

from pathlib import Path

import pytest

from metro_hil.columns import read_columns
from metro_hil.ending import ARRIVED
from metro_hil.journey import plan_journey
from metro_hil.lockstep import config_of, run_lockstep
from metro_hil.measures import measure_ride, measure_stops
from metro_hil.options import parse
from metro_hil.results import sha256_of
from metro_hil.run_folder import RunFolder
from vobc.ato.output_config import STAGES

TRAINS = {"current_loop": ("--consist", "florence4_loop")}
"""The stages that the default train would not follow."""
WINDOW_M = 0.30
JERK_MPS3 = 0.75
"""What a hop may feel like without notches; behind them no law promises the ride."""
RESOLUTION_MPS2 = 1e-3
"""Of a demand on the bus."""


def hop(folder: Path, *arguments: str) -> RunFolder:
    folder.mkdir()
    chosen = parse(["run", "--lockstep", "--from", "II", "--to", "III", *arguments])
    kept = RunFolder(folder)
    assert run_lockstep(chosen, plan_journey(chosen), kept).exit_reason == ARRIVED
    return kept


@pytest.fixture(scope="module")
def hops(tmp_path_factory: pytest.TempPathFactory) -> dict[str, RunFolder]:
    top = tmp_path_factory.mktemp("stages")
    return {stage: hop(top / stage, "--output", stage, *TRAINS.get(stage, ())) for stage in STAGES}


@pytest.mark.parametrize("stage", STAGES)
def test_behind_every_stage_the_train_stops_in_its_window(
    stage: str, hops: dict[str, RunFolder]
) -> None:
    truth = read_columns(hops[stage].truth_log)
    stops = plan_journey(parse(["run", "--lockstep", "--from", "II", "--to", "III"])).stops

    (stop,) = measure_stops(truth, stops)

    assert stop.error_m is not None
    assert abs(stop.error_m) <= WINDOW_M
    if stage != "notches":
        assert measure_ride(truth).max_jerk_mps3 <= JERK_MPS3


def test_in_notches_nothing_but_notches_leaves(hops: dict[str, RunFolder]) -> None:
    output = config_of(parse(["run", "--lockstep"])).ato.output
    levels = {0.0, *output.traction_levels_mps2}
    levels |= {-level_mps2 for level_mps2 in output.brake_levels_mps2}
    sent = read_columns(hops["notches"].cycle_log).numbers("demand_mps2").tolist()
    driven = [sent_mps2 for sent_mps2 in sent if abs(sent_mps2) <= 0.8]

    assert len(set(driven)) > 10
    for sent_mps2 in set(driven):
        assert min(abs(sent_mps2 - level) for level in levels) <= RESOLUTION_MPS2, sent_mps2


def test_the_same_hop_in_notches_gives_the_same_frames(
    hops: dict[str, RunFolder], tmp_path: Path
) -> None:
    again = hop(tmp_path / "again", "--output", "notches")

    logs = [run.bus_log for run in (hops["notches"], again)]
    assert sha256_of(logs[0]) == sha256_of(logs[1])
