"""One hop behind each output stage in virtual time: stopping place, output, and reproducible
bytes."""

import itertools
from pathlib import Path

import pytest

from can_dbc.analogue import AnalogueCommand
from can_dbc.brake import BrakeCommand
from can_dbc.codec import Decoder
from metro_hil.cli.vobc import main
from metro_hil.metrics.results import sha256_of
from metro_hil.metrics.run import measure_ride
from metro_hil.metrics.stops import measure_stops
from metro_hil.model.end_condition import ARRIVED
from metro_hil.model.log_columns import read_columns
from metro_hil.model.mission import plan_journey
from metro_hil.model.run_folder import RunFolder
from metro_hil.model.run_options import parse
from metro_hil.run.lockstep import config_of, run_lockstep
from vobc.ato.settings.output import STAGES
from vobc.cli import EXIT_USAGE

TRAINS = {"current_loop": ("--consist", "florence4_loop")}
"""Trains for output stages that the default train does not follow."""
WINDOW_M = 0.30
JERK_MPS3 = 0.75
"""Jerk limit of the hop. With notches the stop itself may exceed it, the demand may not."""
CHANGES_MAX = 15
"""Limit for the changes of the brake notch during a stop."""
RESOLUTION_MPS2 = 1e-3
"""Resolution of a demand on the bus."""


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


def test_with_notches_the_demand_settles_on_notches_and_ramps_between_them(
    hops: dict[str, RunFolder],
) -> None:
    output = config_of(parse(["run", "--lockstep"])).ato.output
    levels = {0.0, *output.traction_levels_mps2}
    levels |= {-level_mps2 for level_mps2 in output.brake_levels_mps2}
    log = read_columns(hops["notches"].cycle_log)
    driven = [
        sent_mps2
        for sent_mps2, phase in zip(
            log.numbers("demand_mps2").tolist(), log.texts("phase"), strict=True
        )
        if phase in ("departing", "running", "approaching", "stopping")
    ]
    rests = [value for value, stay in itertools.groupby(driven) if len(list(stay)) >= 4]
    steps = [abs(after - before) for before, after in itertools.pairwise(driven)]

    assert len(rests) > 10
    for sent_mps2 in rests:
        assert min(abs(sent_mps2 - level) for level in levels) <= RESOLUTION_MPS2, sent_mps2
    assert max(steps) <= 0.6 * 0.05 + 1e-9
    brakings = [value for value in rests[rests.index(max(rests)) :] if value < 0.0]
    assert 3 < len(brakings) <= CHANGES_MAX


def test_the_units_follow_their_loops_and_not_the_bus(hops: dict[str, RunFolder]) -> None:
    """The loops carry a current beside each protected demand, and never without one."""
    decoder, shares = Decoder([AnalogueCommand, BrakeCommand]), []
    # The last brake command overtakes the currents of the cycle before, because its identifier is
    # lower.
    before_mps2, said_mps2 = 0.0, 0.0
    with hops["current_loop"].bus_log.open(encoding="ascii") as lines:
        for line in lines:
            stamp, _, frame = line.split()
            identifier, data = frame.split("#")
            stamp_ns = round(float(stamp.strip("()")) * 1e9)
            heard = decoder.decode(int(identifier, 16), bytes.fromhex(data), stamp_ns)
            if isinstance(heard, BrakeCommand):
                before_mps2, said_mps2 = said_mps2, heard.service_decel_mps2
            elif isinstance(heard, AnalogueCommand):
                share = max(0.0, (heard.brake_ma - 4.0) / 14.0)
                shares.append(min(abs(share - min(1.0, x)) for x in (before_mps2, said_mps2)))

    assert len(shares) > 1000
    assert max(shares) <= 0.1 / 14.0 + 2.0 * RESOLUTION_MPS2
    assert "0x107" not in {f"{number:#05x}" for number in _identifiers(hops["continuous"])}


def _identifiers(run: RunFolder) -> set[int]:
    with run.bus_log.open(encoding="ascii") as lines:
        return {int(line.split()[2].partition("#")[0], 16) for line in lines}


def test_a_train_with_another_kind_of_reference_is_refused_before_the_run(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    for words, told in (
        (["--output", "current_loop"], "such as --consist florence4_loop"),
        (["--consist", "florence4_loop"], "needs --output current_loop, not continuous"),
    ):
        out = tmp_path / "run"
        assert main(["run", "--lockstep", "--out", str(out), *words]) == EXIT_USAGE
        assert told in capsys.readouterr().err
        assert not out.exists()


def test_the_same_hop_with_notches_gives_the_same_frames(
    hops: dict[str, RunFolder], tmp_path: Path
) -> None:
    again = hop(tmp_path / "again", "--output", "notches")

    logs = [run.bus_log for run in (hops["notches"], again)]
    assert sha256_of(logs[0]) == sha256_of(logs[1])
