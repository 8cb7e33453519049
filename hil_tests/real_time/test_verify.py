"""`hil verify` detects a run that depends on anything except its case."""

import json
from pathlib import Path
from typing import Final

import msgspec
import pytest

from metro_hil.cli.hil import main
from metro_hil.engine.folder import CampaignFolder, CampaignPlan, make_folder
from metro_hil.engine.journal import Journal
from metro_hil.model.case import Case, CaseResult, Setup, Verdict
from metro_hil.replay.verify import verify
from metro_hil.run.dispatch import run_case

MONITOR: Final = {"name": "slow", "measure": "top_speed_mps", "max": 30.0, "unit": "m/s"}
RUNNERS: Final = """\
import os
from metro_hil.model.case import CaseResult, Verdict

def steady(case, *, files, folder=None):
    return CaseResult(case_id=case.id, index=case.index, verdict=Verdict.PASS, chain="77", frames=7)

def by_hash(case, *, files, folder=None):
    chain = "-".join({"brake", "doors", "radio", "tacho", "desk", "tags", "supply", "imu"})
    if folder is not None:
        folder.path.joinpath("bus.log").write_text(f"(0.1) vcan0 101#00\\n(0.2) vcan0 {chain}\\n")
    return CaseResult(case_id=case.id, index=case.index, verdict=Verdict.PASS, chain=chain)

def by_process(case, *, files, folder=None):
    return CaseResult(
        case_id=case.id, index=case.index, verdict=Verdict.PASS, chain="7", sim_s=float(os.getpid())
    )

def dies(case, *, files, folder=None):
    os._exit(7)

def raises(case, *, files, folder=None):
    raise RuntimeError("out of rails")
"""


def cases(count: int, duration_s: float = 15.0) -> list[Case]:
    setup = Setup(start="II", end="III", duration_s=duration_s)
    return [
        Case(id=f"hop/{n}", index=n, scenario="hop", seed=n, setup=setup, monitors=(MONITOR,))
        for n in range(count)
    ]


def campaign(
    tmp_path: Path, made: list[Case], results: list[CaseResult], runner: str | None = None
) -> CampaignFolder:
    options = {} if runner is None else {"runner": runner}
    plan = CampaignPlan(name="hop", cases=made, files={}, options=options)
    folder = make_folder(plan, str(tmp_path / "campaign"))
    journal = Journal(folder.journal_path, folder.head())
    for result in results:
        journal.append(result)
    journal.close()
    return folder


@pytest.fixture
def runners(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A module of runners that worker processes can import."""
    (tmp_path / "odd_runners.py").write_text(RUNNERS)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    return "odd_runners"


def passed(made: list[Case], chain: str) -> list[CaseResult]:
    return [
        CaseResult(case_id=case.id, index=case.index, verdict=Verdict.PASS, chain=chain, frames=7)
        for case in made
    ]


def test_the_bench_in_lockstep_gives_the_same_elsewhere(tmp_path: Path) -> None:
    made = cases(3)
    results = [run_case(case) for case in made]
    folder = campaign(tmp_path, made, results)

    found = verify(folder, sample=2, seed=3, load=1)

    assert found.identical, found.mismatches
    assert (found.sampled, found.of) == (2, 3)
    assert found.frames in {
        one.frames + other.frames for one in results for other in results if one is not other
    }


def test_a_changed_result_is_reported_with_its_case(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made = cases(2, duration_s=5.0)
    good = [run_case(case) for case in made]
    changed = msgspec.structs.replace(good[1], chain="0" * 64)
    folder = campaign(tmp_path, made, [good[0], changed])

    code = main(["verify", str(folder.path), "--all", "--load", "0", "--json"])

    told = json.loads(capsys.readouterr().out)
    assert code == 1
    assert told["identical"] is False
    (mismatch,) = told["mismatches"]
    assert mismatch["case_id"] == "hop/1"
    assert [words.split(":")[0] for words in mismatch["differences"]] == ["chain"]
    assert "two runs now have the same frames" in mismatch["compared"]


def test_a_runner_that_depends_on_the_order_of_a_set_is_detected(
    tmp_path: Path, runners: str
) -> None:
    made = cases(3)
    folder = campaign(tmp_path, made, passed(made, "brake"), f"{runners}:by_hash")

    found = verify(folder, sample=None, load=0)

    assert not found.identical
    assert [each.case_id for each in found.mismatches] == [case.id for case in made]
    first = found.mismatches[0].first_frame
    assert first is not None
    assert first.number == 2
    assert first.one != first.other


def test_a_runner_that_depends_on_its_process_is_detected(tmp_path: Path, runners: str) -> None:
    made = cases(2)
    folder = campaign(tmp_path, made, passed(made, "7"), f"{runners}:by_process")

    found = verify(folder, load=0)

    assert len(found.mismatches) == 2
    assert any("sim_s" in words for words in found.mismatches[0].differences)


@pytest.mark.parametrize(("runner", "words"), [("dies", "status 7"), ("raises", "out of rails")])
def test_a_run_without_a_result_is_no_match(
    tmp_path: Path, runners: str, runner: str, words: str
) -> None:
    made = cases(1)
    folder = campaign(tmp_path, made, passed(made, "7"), f"{runners}:{runner}")

    (mismatch,) = verify(folder, load=0).mismatches

    assert words in mismatch.differences[0]


def test_a_reproducible_runner_passes(tmp_path: Path, runners: str) -> None:
    made = cases(4)
    folder = campaign(tmp_path, made, passed(made, "77"), f"{runners}:steady")

    found = verify(folder, sample=None, workers=3, load=0)

    assert found.identical
    assert found.frames == 28


def test_a_campaign_without_results_does_not_pass(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = campaign(tmp_path, cases(1), [])

    code = main(["verify", str(folder.path)])

    assert code == 2
    assert "no case in virtual time" in capsys.readouterr().err
