"""The workflow of a bench user: campaign, rerun, replay, verify, and own tests."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any, Final

import pytest

from metro_hil.campaign import plan_cases, read_campaign
from metro_hil.cli.hil import main
from metro_hil.engine.folder import find_folder
from metro_hil.engine.journal import read_journal
from metro_hil.model.case import Case, as_expected
from metro_hil.replay import replay_run
from metro_hil.run.dispatch import run_case

CAMPAIGN: Final = """\
name = "mixed"
[train]
start = "II"
end = "III"
duration_s = 30.0

[[scenario]]
name = "never-there"
monitor = [{ name = "arrives", measure = "arrived_count", min = 1.0 }]
[[scenario.fault]]
kind = "frame_drop"
loss_ratio = 0.05
[[scenario.fault]]
kind = "bus_off"
when = "t_s > 12"
duration_s = 1.0

[[scenario]]
name = "restarted"
fault = [{ kind = "controller_killed", start_s = 12.0, end_s = 12.3 }]

[[scenario]]
name = "parted"
seeds = 3
branch = { seed = 9, when = "front_m > 3050" }
fault = [{ kind = "wheel_slip" }, { kind = "frame_corrupt", share_ratio = 0.05 }]
"""

OWN_TESTS: Final = """\
from metro_hil.campaign.builder import Scenario
from metro_hil.model.case import Verdict

TRAIN = {"start": "II", "end": "III", "duration_s": 30.0}
FAULT = {"kind": "frame_delay", "delay_s": 0.03, "when": "front_m > 3050"}

def test_a_scenario_of_my_own(bench):
    result = bench.run(Scenario(name="mine", train=TRAIN, fault=[FAULT]))
    assert result.verdict is Verdict.PASS, result.reason
    with open("chain", "w") as file:
        file.write(result.chain)

def test_driven_by_hand(bench):
    run = bench.start(Scenario(train=TRAIN))
    run.run_until("speed_mps > 5", timeout_s=30.0)
    run.plan_faults({"kind": "emergency_button"})
    run.run_until("speed_mps == 0", timeout_s=30.0)
    assert run.controller.supervision.name == "EMERGENCY"
"""

OWN_CAMPAIGN: Final = """\
name = "mine"
[train]
start = "II"
end = "III"
duration_s = 30.0
[[fault]]
kind = "frame_delay"
delay_s = 0.03
when = "front_m > 3050"
"""

SAMPLE: Final = (
    "frame-reorder",
    "flip-on-wire",
    "masquerade-brake",
    "bus-off-odometer",
    "slide-both",
    "tacho-drift",
    "false-t1-20m-early",
    "serial-cut",
    "brake-stuck-off",
    "line-dead",
    "door-opens",
    "desk-lever",
    "radio-partition",
    "controller-restarted",
)
"""At least one fault of each place, including some that the product fails."""


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def said(capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    document: dict[str, Any] = json.loads(capsys.readouterr().out)
    return document


def test_kept_and_repeated_cases_are_reproduced_and_verified(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (here / "mixed.toml").write_text(CAMPAIGN)
    words = ["--workers", "2", "--json", "--no-report", "--keep", "1", "--keep-worst", "1"]
    assert main(["run", "mixed.toml", *words]) == 1
    assert said(capsys)["problems"] == []
    folder = find_folder(None)
    results = {one.case_id: one for one in read_journal(folder.journal_path).results}

    failed = folder.kept("never-there/s1").path
    assert replay_run(failed).identical
    for case_id, controllers in (("restarted/s1", 2), ("parted/s2", 1)):
        out = here / case_id.replace("/", "-")
        main(["rerun", folder.path.name, case_id, "--json", "--no-plot", "--out", str(out)])
        again = said(capsys)
        assert again["difference"] == ""
        assert again["result"]["chain"] == results[case_id].chain
        code = main(["replay", str(out), "--json"])
        table = said(capsys)
        assert (code, table["identical"], table["controllers"]) == (0, True, controllers)

    assert main(["verify", folder.path.name, "--all", "--load", "1", "--json"]) == 0
    verified = said(capsys)
    assert verified["identical"] is True
    assert verified["sampled"] == len(results) == 5


def test_a_test_file_in_any_folder_gets_the_bench_and_runs_the_same_cases(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (here / "test_mine.py").write_text(OWN_TESTS)
    (here / "mine.toml").write_text(OWN_CAMPAIGN)

    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_mine.py"],
        capture_output=True,
        text=True,
        check=False,
    )
    code = main(["run", "mine.toml", "--json", "--no-report", "--workers", "1"])

    assert done.returncode == 0, done.stdout
    assert "2 passed" in done.stdout
    assert code == 0
    (result,) = read_journal(find_folder(None).journal_path).results
    assert result.chain == (here / "chain").read_text()


@pytest.fixture(scope="module")
def faults() -> dict[str, Case]:
    """The first case of each scenario of the campaign `faults`."""
    cases = plan_cases(read_campaign("faults"))
    return {case.scenario: case for case in reversed(cases)}


@pytest.mark.parametrize("scenario", SAMPLE)
def test_a_shipped_fault_has_the_verdict_that_its_campaign_expects(
    scenario: str, faults: dict[str, Case]
) -> None:
    case = faults[scenario]

    result = run_case(case)

    assert as_expected(case, result), (result.verdict, result.reason)
    assert any(event.what.startswith("fault ") for event in result.events)
