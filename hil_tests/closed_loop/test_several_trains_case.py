"""A scenario with several trains of a service: faults of one of them, and one verdict over all."""

import re
import shutil
import tomllib
from pathlib import Path
from typing import Final

import msgspec
import pytest

from metro_hil.campaign.plan import plan_cases
from metro_hil.campaign.problems import CampaignError
from metro_hil.campaign.read import read_campaign
from metro_hil.line.turning.invariants import OVERLAP, Between, PairViolation
from metro_hil.model.case import Case, CaseResult, Verdict
from metro_hil.model.case_setup import Files
from metro_hil.run.dispatch import run_case

LINES: Final = Path(__file__).resolve().parents[2] / "docs/examples/line"
SERVICE: Final = 'line = "terminus.toml"\ntrains = 2\n[[trips]]\nroute = "out"\n'
SCENARIO: Final = """
[train]
service = "both.toml"
duration_s = 27.0
[[fault]]
kind = "controller_killed"
train = 1
when = "front_m > 240"
[[fault]]
kind = "tag_missed"
train = 2
[[fault]]
kind = "radio_delay"
delay_s = 0.1
"""


def planned(folder: Path, scenario: str = SCENARIO) -> tuple[Case, Files]:
    shutil.copy(LINES / "terminus.toml", folder)
    (folder / "both.toml").write_text(SERVICE, encoding="utf-8")
    (folder / "scenario.toml").write_text(scenario, encoding="utf-8")
    campaign = read_campaign(str(folder / "scenario.toml"))
    (case,) = plan_cases(campaign)
    return case, {name: folder / name for name in campaign.files}


def with_faults_of(scenario: str, case: Case) -> Case:
    """The case as another version may have planned it, whose check of faults did less."""
    return msgspec.structs.replace(case, faults=tuple(tomllib.loads(scenario)["fault"]))


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> CaseResult:
    case, files = planned(tmp_path_factory.mktemp("several"))
    return run_case(case, files=files)


def test_trains_share_one_network_and_one_verdict(driven: CaseResult) -> None:
    assert driven.exit_reason == "duration over"
    apart = next(each for each in driven.monitors if each.name == "trains-apart")
    assert apart.verdict is Verdict.PASS
    assert apart.margin is not None
    assert apart.margin == driven.measures["least_gap_m"]
    assert 10.0 < apart.margin < 90.0
    assert driven.measures["switches_moved_count"] == 1.0
    assert driven.measures["train_1_emergency_count"] == 1.0
    assert driven.measures["train_2_emergency_count"] == 0.0


def test_a_fault_acts_on_its_train_only(driven: CaseResult) -> None:
    killed, missed, late = driven.faults
    assert (killed.began, killed.touched) == (True, 1)
    # Train 2 meets no tag before the end, so the case cannot pass.
    assert (missed.began, missed.touched) == (True, 0)
    assert driven.verdict is Verdict.VACUOUS
    assert "fault tag_missed touched nothing" in driven.reason
    began = {each.what for each in driven.events if "begins" in each.what}
    assert began == {
        "train 1, trip 1: fault radio_delay begins",
        "train 1, trip 1: fault controller_killed begins",
        "train 2, trip 1: fault tag_missed begins",
        "train 2, trip 1: fault radio_delay begins",
    }
    assert late.began


MASTERS: Final = """
[train]
service = "both.toml"
duration_s = 24.2
masters = true
kill_master_at_s = 20.0
"""


def test_trains_of_a_case_command_themselves(tmp_path: Path) -> None:
    case, files = planned(tmp_path, MASTERS)

    result = run_case(case, files=files)

    assert result.exit_reason == "duration over"
    assert result.verdict is Verdict.PASS, result.reason
    found = {each.name: each for each in result.monitors}
    # Train 2 takes part from 22.4 s on, and then the master is struck.
    followed = found["master-followed"]
    assert followed.verdict is Verdict.PASS
    assert followed.at_s is not None
    assert 22.4 < followed.at_s < 24.5
    assert result.measures["takeover_worst_s"] is not None
    assert result.measures["takeover_worst_s"] < 0.5
    assert found["trains-apart"].verdict is Verdict.PASS
    # The authorities of masters reach the monitors.
    for name in ("inv-02-authority-end", "inv-11-mode-up", "inv-23-switch-locked"):
        assert found[name].verdict is Verdict.PASS
    assert result.measures["train_1_emergency_count"] == 1.0
    assert result.measures["train_2_emergency_count"] == 0.0


def test_a_case_in_which_no_master_was_struck_does_not_pass(tmp_path: Path) -> None:
    scenario = MASTERS.replace("24.2", "9.0").replace("at_s = 20.0", "at_s = 5.0")
    case, files = planned(tmp_path, scenario)

    result = run_case(case, files=files)

    assert result.verdict is Verdict.INCONCLUSIVE
    assert "not judged by: master-followed" in result.reason


@pytest.mark.parametrize(
    ("fault", "problem"),
    [
        ('kind = "radio_loss"', "radio_loss acts on authorities of the zone controller"),
        ('kind = "signal_stop"', "signal_stop acts on authorities of the zone controller"),
        ('kind = "clock_step"', "clock_step does not reach the radio of masters"),
        ('kind = "controller_killed"\nduration_s = 2.0', "cannot restart a train under masters"),
    ],
)
def test_a_fault_that_cannot_act_under_masters_is_refused_and_blocks_a_case(
    fault: str, problem: str, tmp_path: Path
) -> None:
    with_fault = f"{MASTERS}[[fault]]\n{fault}\n"

    with pytest.raises(CampaignError, match=rf"fault\[0\].kind: .*{problem}"):
        planned(tmp_path, with_fault)
    case, files = planned(tmp_path, MASTERS)
    result = run_case(with_faults_of(with_fault, case), files=files)
    assert result.verdict is Verdict.BLOCKED
    assert "fault[0].kind: " in result.reason
    assert problem in result.reason


@pytest.mark.parametrize(
    ("before", "after", "problem"),
    [
        ("train = 1", "train = 3", "fault[0].train: 3: the case has 2; choose 1 to 2"),
        ("train = 1", "trip = 2", "fault[0].trip: 2: the case has 1; choose 1 to 1"),
        (
            'kind = "tag_missed"\ntrain = 2',
            'kind = "switch_lost"\nswitch = "W1"',
            "fault[1].train: missing key: switch_lost acts on a switch of all trains",
        ),
    ],
)
def test_a_fault_of_no_train_is_refused_and_blocks_a_case(
    before: str, after: str, problem: str, tmp_path: Path
) -> None:
    changed = SCENARIO.replace(before, after, 1)

    with pytest.raises(CampaignError, match=re.escape(problem)):
        planned(tmp_path, changed)
    case, files = planned(tmp_path)
    result = run_case(with_faults_of(changed, case), files=files)
    assert result.verdict is Verdict.BLOCKED
    assert problem in result.reason


@pytest.mark.parametrize(
    ("before", "after", "problem"),
    [
        ("duration_s = 27.0", "trains = 21", "trains: 21 is not within 1..20"),
        (
            "duration_s = 27.0",
            'trains = 2\nline = "florence"',
            "trains 2: florence has no switches",
        ),
        ('service = "both.toml"', "trains = 2", "trains: 2 needs service"),
        ('service = "both.toml"', "masters = true", "masters: true needs service"),
        ("duration_s = 27.0", "cut_master_at_s = 5.0", "cut_master_at_s: 5 needs masters = true"),
        (
            "duration_s = 27.0",
            "masters = true\ncut_master_at_s = -1.0",
            "cut_master_at_s: -1.0 is not within 0..",
        ),
        (
            "duration_s = 27.0",
            "masters = true\ncut_master_at_s = 5.0\nkill_master_at_s = 6.0",
            "kill_master_at_s: 6 excludes cut_master_at_s",
        ),
        ('service = "both.toml"', 'supply = "weak"', "supply: 'weak' needs service"),
        (
            "duration_s = 27.0",
            'supply = "weak"',
            "train.supply: supply weak: sections: S1900-S3799 from 1900 m to 3799 m feeds no track",
        ),
        ("duration_s = 27.0", 'supply = "none"', "train.supply: none: "),
        ("train = 1", "train = 0", "train: 0 is not a whole number of 1 or more"),
    ],
)
def test_what_does_not_fit_is_refused_before_the_run(
    before: str, after: str, problem: str, tmp_path: Path
) -> None:
    scenario = SCENARIO.replace(before, after, 1)
    if "florence" in after:
        scenario = scenario.replace("both.toml", "up.toml")
        (tmp_path / "up.toml").write_text(SERVICE.replace('"out"', '"up"'), encoding="utf-8")

    with pytest.raises(CampaignError) as refused:
        planned(tmp_path, scenario)

    assert problem in str(refused.value)


def test_a_violation_between_trains_fails_the_case(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def look(between: Between, at_s: float, present: object) -> None:
        between.checked_count += 1
        between.violations.append(PairViolation(OVERLAP, at_s, ("train 1", "train 2")))

    monkeypatch.setattr(Between, "look", look)
    case, files = planned(tmp_path, "[train]\nservice = 'both.toml'\nduration_s = 9.0\n")

    result = run_case(case, files=files)

    # The case ends within a second, and no monitor of a train alone has failed.
    assert result.verdict is Verdict.FAIL
    assert result.exit_reason == "stopped at the first violation"
    assert result.sim_s < 2.0
    assert "trains-apart violated at" in result.reason


def test_trains_of_which_only_one_ran_show_nothing_about_others(tmp_path: Path) -> None:
    case, files = planned(tmp_path, "[train]\nservice = 'both.toml'\nduration_s = 9.0\n")

    result = run_case(case, files=files)

    assert result.verdict is Verdict.VACUOUS
    assert "trains-apart" in result.reason
