"""A scenario whose train makes the trips of a service: one verdict over all trips."""

from pathlib import Path
from typing import Final

import msgspec
import pytest

from metro_hil.campaign.plan import plan_cases
from metro_hil.campaign.problems import CampaignError
from metro_hil.campaign.read import read_campaign
from metro_hil.model.case import Case, CaseResult, Verdict
from metro_hil.model.case_setup import Files
from metro_hil.run.dispatch import run_case

LINE: Final = """
name = "stub"
start_m = -90.0
end_m = 200.0
stations = [
    { name = "A", stop_m = 0.0, platform_start_m = -75.0, platform_end_m = 5.0, dwell_s = 1.0 },
    { name = "B", stop_m = 60.0, platform_start_m = -15.0, platform_end_m = 65.0, dwell_s = 1.0 },
]
speed_sections = [{ start_m = -90.0, end_m = 200.0, limit_mps = 9.0 }]
tags = [
    { tag_id = 4, position_m = -2.0, kind = "stop", station = "A" },
    { tag_id = 11, position_m = 8.0, kind = "t1", station = "B" },
    { tag_id = 12, position_m = 48.0, kind = "t2", station = "B" },
    { tag_id = 13, position_m = 56.5, kind = "t3", station = "B" },
    { tag_id = 14, position_m = 58.0, kind = "stop", station = "B" },
]
"""
SERVICE: Final = """
line = "stub.toml"
[[trips]]
route = "up"
[[trips]]
route = "down"
layover_s = 3.0
"""
SCENARIO: Final = """
[train]
service = "there.toml"
duration_s = 200.0
[[monitor]]
name = "arrives"
measure = "arrived_count"
min = 1
[[fault]]
kind = "ats_hold"
when = "t_s > 1"
duration_s = 2.0
"""


def write(folder: Path, scenario: str = SCENARIO) -> Path:
    for name, text in (("stub", LINE), ("there", SERVICE), ("scenario", scenario)):
        (folder / f"{name}.toml").write_text(text, encoding="utf-8")
    return folder / "scenario.toml"


def planned(folder: Path, scenario: str = SCENARIO) -> tuple[Case, Files]:
    campaign = read_campaign(str(write(folder, scenario)))
    (case,) = plan_cases(campaign)
    return case, {name: folder / name for name in campaign.files}


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> CaseResult:
    case, files = planned(tmp_path_factory.mktemp("service"))
    return run_case(case, files=files)


def test_every_trip_counts_in_one_verdict(driven: CaseResult) -> None:
    assert (driven.verdict, driven.exit_reason) == (Verdict.PASS, "arrived")
    assert driven.measures["arrived_count"] == 2.0
    assert driven.measures["ends_changed_count"] == 1.0
    # 60 m up; then cab B of the train of 68.59 m leaves from -8.59 m and stops at -70 m.
    assert driven.measures["distance_m"] == pytest.approx(60.0 + 61.41, abs=0.5)
    assert driven.measures["stop_error_worst_m"] == pytest.approx(0.0, abs=0.1)
    (fault,) = driven.faults
    # In each trip the order is in force for 2 s, in which the centre sends it 10 times.
    assert fault.touched == pytest.approx(20, abs=2)


def test_events_and_margins_have_the_time_of_the_service(driven: CaseResult) -> None:
    orders = [each.at_s for each in driven.events if each.what == "fault ats_hold begins"]
    assert orders[0] == pytest.approx(1.0, abs=0.02)
    assert 30.0 < orders[1] < driven.sim_s


def test_a_trip_that_does_not_arrive_ends_the_service(tmp_path: Path) -> None:
    case, files = planned(tmp_path)
    short = msgspec.structs.replace(case.setup, duration_s=4.0)

    result = run_case(msgspec.structs.replace(case, setup=short), files=files)

    assert (result.verdict, result.exit_reason) == (Verdict.FAIL, "duration over")
    assert result.sim_s == pytest.approx(4.0)
    assert result.measures["arrived_count"] == 0.0


@pytest.mark.parametrize(
    ("before", "after", "problem"),
    [
        ('"there.toml"', '"here.toml"', "train.service: "),
        ('"there.toml"', '"there.toml"\nstart = "A"', "train.start: is decided by service"),
        ("[[fault]]", "[timetable]\nstops = []\n[[fault]]", "timetable: "),
        ('"there.toml"', '"there.toml"\nline = "florence:up"', "names a route"),
    ],
)
def test_a_scenario_says_nothing_that_its_service_says(
    before: str, after: str, problem: str, tmp_path: Path
) -> None:
    with pytest.raises(CampaignError) as refused:
        read_campaign(str(write(tmp_path, SCENARIO.replace(before, after))))

    assert problem in str(refused.value)


def test_a_service_needs_the_train_of_the_bench(tmp_path: Path) -> None:
    more = '[controller]\nkind = "command"\ncommand = "true"\n'
    case, files = planned(tmp_path, SCENARIO + more)

    result = run_case(case, files=files)

    assert result.verdict is Verdict.BLOCKED
    assert "train.service: needs the lockstep bench" in result.reason
