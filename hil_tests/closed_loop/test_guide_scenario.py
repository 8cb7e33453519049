"""The first scenario of the campaign guide, exactly as a reader copies it."""

import re
import tomllib
from pathlib import Path

import pytest

from metro_hil.campaign import plan_cases
from metro_hil.campaign.read import define
from metro_hil.model.case import Verdict
from metro_hil.run.dispatch import run_case

GUIDE = Path(__file__).parents[2] / "docs" / "guide" / "hil.md"
FIRST_BLOCK = re.compile(r"```toml\n(.*?)```", re.DOTALL)


def block() -> str:
    found = FIRST_BLOCK.search(GUIDE.read_text(encoding="utf-8"))
    assert found is not None
    return found[1]


@pytest.mark.parametrize("index", [0, -1], ids=["weakest runaway", "strongest runaway"])
def test_the_scenario_of_the_guide_passes_on_evidence(index: int) -> None:
    """The run shows the emergency brake, the faults and the requirement."""
    case = plan_cases(define(tomllib.loads(block()), source="guide", name="guide").campaign)[index]

    result = run_case(case)

    assert (result.verdict, result.reason) == (Verdict.PASS, "")
    assert [monitor.verdict for monitor in result.monitors if monitor.own] == [Verdict.PASS] * 2
    assert all(fault.touched for fault in result.faults)
    assert result.measures["emergency_count"] == 1.0


def test_without_the_runaway_the_same_monitors_do_not_pass() -> None:
    table = tomllib.loads(block())
    table["fault"] = []
    table["sweep"] = {}
    table["train"]["duration_s"] = 40.0
    case = plan_cases(define(table, source="guide", name="guide").campaign)[0]

    assert run_case(case).verdict is not Verdict.PASS
