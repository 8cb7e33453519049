"""A scenario with several trains of a service: faults of one of them, and one verdict over all."""

import shutil
from pathlib import Path
from typing import Final

import pytest

from metro_hil.campaign.plan import plan_cases
from metro_hil.campaign.problems import CampaignError
from metro_hil.campaign.read import read_campaign
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
def test_a_fault_of_no_train_of_the_case_blocks_it(
    before: str, after: str, problem: str, tmp_path: Path
) -> None:
    case, files = planned(tmp_path, SCENARIO.replace(before, after, 1))

    result = run_case(case, files=files)

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


def test_trains_of_which_only_one_ran_show_nothing_about_others(tmp_path: Path) -> None:
    case, files = planned(tmp_path, "[train]\nservice = 'both.toml'\nduration_s = 9.0\n")

    result = run_case(case, files=files)

    assert result.verdict is Verdict.VACUOUS
    assert "trains-apart" in result.reason
