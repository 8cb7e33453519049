"""Zones in closed loop: the two quickest scenarios of the campaign that no document runs."""

from pathlib import Path

import pytest

from metro_hil.campaign import plan_cases, read_campaign
from metro_hil.model.case import Verdict, as_expected
from metro_hil.run.dispatch import run_case


@pytest.mark.parametrize(
    ("case_id", "invariant"),
    [
        ("neutral-section-driver/s1", "inv-41-neutral-section"),
        ("no-stop-zone/s1", "inv-42-no-stop-zone"),
    ],
)
def test_a_scenario_of_the_campaign_comes_out_as_expected(
    case_id: str, invariant: str, tmp_path: Path
) -> None:
    campaign = read_campaign("zones")
    files = {name: tmp_path / Path(name).name for name in campaign.files}
    for name, path in files.items():
        path.write_text(campaign.files[name], encoding="utf-8")
    (case,) = (each for each in plan_cases(campaign) if each.id == case_id)

    result = run_case(case, files=files)

    assert as_expected(case, result)
    (judged,) = (each for each in result.monitors if each.name == invariant)
    assert judged.verdict is Verdict.PASS
