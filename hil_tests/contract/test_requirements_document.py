"""docs/reference/requirements.md agrees with catalogue, campaigns and results."""

import ast
from pathlib import Path

import pytest

from metro_hil.campaign.scenarios import shipped_scenarios
from metro_hil.model.requirements import Requirement, shipped_requirements
from metro_hil.report.requirement_page import RESULTS, read_outcomes, requirements_page

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "reference" / "requirements.md").read_text(encoding="utf-8")
KEPT = (ROOT / "hil_tests" / "metro_hil" / RESULTS).read_text(encoding="utf-8")


def test_the_page_agrees_with_catalogue_campaigns_and_results() -> None:
    """When this fails, run `hil requirements --out docs/reference/requirements.md`."""
    found = read_outcomes(KEPT)

    assert requirements_page(shipped_requirements(), shipped_scenarios(), found) == PAGE


def test_every_result_belongs_to_a_shipped_scenario() -> None:
    assert set(read_outcomes(KEPT)) <= {each.name for each in shipped_scenarios()}


def test_every_requirement_that_a_scenario_names_has_a_line() -> None:
    named = {name for each in shipped_scenarios() for name in each.requirements}

    assert named <= set(shipped_requirements())


@pytest.mark.parametrize(
    "requirement",
    [each for each in shipped_requirements().values() if each.tests],
    ids=lambda requirement: requirement.id,
)
def test_every_named_test_exists(requirement: Requirement) -> None:
    for test in requirement.tests:
        path, _, function = test.partition("::")
        assert (ROOT / path).is_file(), test
        body = ast.parse((ROOT / path).read_text(encoding="utf-8")).body
        assert function in [node.name for node in body if isinstance(node, ast.FunctionDef)], test
