"""The changes of a case reach its processes through files with the same content."""

from pathlib import Path

from firmware_py.settings import parse
from firmware_py.trackdb import load_line
from metro_hil.model.case import Case, Setup
from metro_hil.model.case_setup import NO_FILES, parts_of
from metro_hil.realtime.documents import Documents, write_documents
from plant_emulator.faults.plan import read_faults
from plant_emulator.train_config import load_train
from vobc.config import load_config


def written(folder: Path, setup: Setup, faults: tuple[dict[str, object], ...] = ()) -> Documents:
    case = Case(id="c", index=0, scenario="s", seed=1, setup=setup, faults=faults)
    return write_documents(case, parts_of(case), NO_FILES, folder)


def test_unchanged_files_keep_their_shipped_names(tmp_path: Path) -> None:
    """This lets an older controller read its own files."""
    papers = written(tmp_path, Setup())

    assert (papers.line, papers.consist, papers.params) == ("florence", "florence4", "florence4")


def test_dwell_times_real_and_assumed_train_are_read_back_unchanged(
    tmp_path: Path,
) -> None:
    setup = Setup(
        dwell_s={"II": 12.5},
        real={"brake.service.gain_ratio.low": 0.7},
        believed={"ato.braking.decel_mps2": 0.6},
    )
    case = Case(id="c", index=0, scenario="s", seed=1, setup=setup)
    made = parts_of(case)

    papers = write_documents(case, made, NO_FILES, tmp_path)

    assert load_line(papers.line) == made.journey.line
    assert load_line(papers.line).station("II").dwell_s == 12.5
    assert load_train(papers.consist) == made.scenario.train
    assert load_train(papers.consist) != load_train("florence4")
    assert load_config(papers.params, cycle_ms=50.0) == made.config


def test_faults_are_passed_on_unchanged(tmp_path: Path) -> None:
    faults = (
        {"kind": "frame_drop", "frames": "BRAKE_CMD*", "start_s": 4.0, "duration_s": 0.5},
        {"kind": "tacho_drift", "when": "speed_mps > 3", "axle": "b", "ratio_per_s": 0.01},
        {"kind": "masquerade", "frame": "BRAKE_CMD", "values": {"decel_mps2": 0.0}, "seed": 3},
    )

    papers = written(tmp_path, Setup(), faults)

    assert read_faults(parse(papers.faults)["fault"], "x") == read_faults(faults, "x")
