"""Scenarios by their name: found in any shipped campaign, alone, with one seed or all."""

from collections import Counter

import pytest

from firmware_py.settings import SettingsError, shipped_names
from metro_hil.campaign import plan_cases, read_campaign
from metro_hil.campaign.scenarios import is_scenario, read_named, shipped_scenarios


def test_names_of_shipped_scenarios_are_unique_and_differ_from_campaign_names() -> None:
    names = Counter(each.name for each in shipped_scenarios())
    campaigns = {each.campaign for each in shipped_scenarios() if each.name != each.campaign}

    assert [name for name, count in names.items() if count > 1] == []
    assert not campaigns & {each.name for each in shipped_scenarios() if each.name in campaigns}
    assert {each.campaign for each in shipped_scenarios()} == set(
        shipped_names("metro_hil.campaign.shipped")
    )


def test_a_scenario_by_name_has_the_same_cases_as_in_its_campaign() -> None:
    whole = [
        case for case in plan_cases(read_campaign("acceptance")) if case.scenario == "tag-missed"
    ]

    alone = plan_cases(read_named("tag-missed"))

    assert [case.id for case in alone] == [case.id for case in whole]
    assert [(c.seed, c.setup, c.faults, c.monitors) for c in alone] == [
        (c.seed, c.setup, c.faults, c.monitors) for c in whole
    ]


def test_a_campaign_by_name_is_still_the_whole_campaign() -> None:
    assert plan_cases(read_named("faults")) == plan_cases(read_campaign("faults"))


def test_an_unknown_name_gets_the_nearest_as_suggestion() -> None:
    with pytest.raises(SettingsError, match="overspeed-runaway"):
        read_named("overspeed-runawy")


def test_one_seed_replaces_all_seeds() -> None:
    cases = plan_cases(read_named("tag-missed", 99))

    assert {case.seed for case in cases} == {99}
    assert len(cases) == 4


def test_only_scenarios_are_scenarios() -> None:
    assert is_scenario("overspeed-runaway")
    assert not is_scenario("acceptance")
    assert not is_scenario("no-such-thing")
