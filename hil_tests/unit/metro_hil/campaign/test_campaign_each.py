"""Scenarios that are generated for each of several values."""

from pathlib import Path
from typing import Any

import pytest

from metro_hil.campaign import plan_cases
from metro_hil.campaign.problems import CampaignError
from metro_hil.campaign.read import define
from metro_hil.campaign.scenarios import read_named, shipped_scenarios
from metro_hil.model.case import Case

LAW = "train.believed.ato.strategy"


def cases_of(table: dict[str, Any]) -> tuple[Case, ...]:
    return plan_cases(define(table, source="made.toml", folder=Path()).campaign)


def table_of(**more: Any) -> dict[str, Any]:
    sweep = {"new_seeds": True, "factors": {"train.load_ratio": [0.0, 0.5, 1.0]}}
    return {
        "each": {LAW: ["predictive", "pid_literal"]},
        "scenario": [{"name": "far", "sweep": sweep}, {"name": "near", **more}],
    }


def test_every_scenario_is_generated_for_every_value_and_named_after_it() -> None:
    cases = cases_of(table_of())

    assert list(dict.fromkeys(case.scenario for case in cases)) == [
        *("far-predictive", "near-predictive", "far-pid_literal", "near-pid_literal"),
    ]
    for case in cases:
        assert case.setup.believed["ato.strategy"] == case.scenario.partition("-")[2]
        assert case.factors[LAW] == case.setup.believed["ato.strategy"]


def test_all_values_get_the_same_samples() -> None:
    """Load and seed of the n-th case do not depend on the value."""
    by_law: dict[str, list[tuple[float | None, int]]] = {}
    for case in cases_of(table_of()):
        if case.scenario.startswith("far"):
            drawn = case.setup.load_ratio, case.seed
            by_law.setdefault(case.setup.believed["ato.strategy"], []).append(drawn)

    assert by_law["predictive"] == by_law["pid_literal"] == [(0.0, 1), (0.5, 2), (1.0, 3)]


def test_a_scenario_may_stand_alone_or_have_values_of_its_own() -> None:
    alone = cases_of(table_of(each={}))
    own = cases_of(table_of(each={"train.line": ["florence"]}))

    assert alone[-1].scenario == "near"
    assert alone[-1].setup.believed == {}
    assert own[-1].scenario == "near-florence"


def test_settings_for_one_value_apply_to_that_value_only() -> None:
    monitor = {"name": "near", "measure": "stop_error_worst_m", "max": 0.10}
    more = {"pid_literal": {"monitor.0.max": 0.30, "train.end": "III"}}
    table = {
        "each": {LAW: ["predictive", "pid_literal"], "with": more},
        "monitor": [monitor],
        "scenario": [{"name": "far"}],
    }

    found = {case.scenario: (case.monitors[0]["max"], case.setup.end) for case in cases_of(table)}

    assert found == {"far-predictive": (0.10, None), "far-pid_literal": (0.30, "III")}


@pytest.mark.parametrize(
    ("each", "words"),
    [
        ({LAW: ["pid"], "with": {"pit": {}}}, "each.with.pit: "),
        ({LAW: ["pid"], "with": {"pid": 3}}, "is not a table of tables"),
        ({LAW: ["pid"], "with": {"pid": {"nonsense.x": 1}}}, "cannot be swept"),
        ({LAW: ["pid"], "with": {"pid": {"monitor.7.max": 1.0}}}, "monitor.7"),
        ({"with": {}}, "is not a table of one key"),
        ({LAW: []}, f"each.{LAW}: [] is not a list of different values"),
        ({LAW: ["pid", "pid"]}, "is not a list of different values"),
        ({LAW: ["no such/name"]}, "'no such/name' cannot end the name of a scenario"),
        ({"a": [1], "b": [2]}, "is not a table of one key"),
        ({"nonsense.x": [1]}, "cannot be swept"),
        ({LAW: ["predictiv"]}, "predictive"),
    ],
)
def test_an_error_is_reported_with_its_key(each: dict[str, Any], words: str) -> None:
    with pytest.raises(CampaignError) as caught:
        cases_of({"each": each, "scenario": [{"name": "far"}]})

    assert words in str(caught.value)
    assert "made.toml: " in str(caught.value)


def test_without_scenarios_it_is_refused() -> None:
    with pytest.raises(CampaignError, match="each: needs a"):
        cases_of({"each": {LAW: ["predictive"]}})


def test_a_shipped_scenario_is_found_by_its_name_for_one_value_and_for_all() -> None:
    names = {each.name for each in shipped_scenarios()}

    assert {"table-8-predictive", "pid-literal"} <= names
    assert {case.scenario for case in plan_cases(read_named("table-8-predictive"))} == {
        "table-8-predictive"
    }
    for case in plan_cases(read_named("table-8")):
        assert case.scenario.startswith("table-8-")
