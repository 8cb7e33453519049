"""The shipped mutants apply to the present source and name existing cases."""

import collections
import re
from pathlib import Path

import pytest

from metro_hil.campaign import plan_cases, read_campaign
from metro_hil.sensitivity.mutants import ControllerMutant, mutated_source, shipped_mutants

ROOT = Path(__file__).resolve().parents[2]
LEAST_MUTANTS = 60
MUTANTS = shipped_mutants()
FOUND_BY_HAND = {
    *("reset-in-motion", "desk-releases-centre-order", "curve-ignores-gradient"),
    *("energy-ignores-gradient", "curve-ignores-rear-of-section"),
    *("energy-ignores-rear-of-section", "curve-ignores-end-of-restriction"),
    *("energy-ignores-end-of-restriction", "doors-without-holding-brake"),
    *("doors-without-standstill", "emergency-one-cycle-late", "service-brake-one-cycle-late"),
    *("tag-window-1-m-wider", "scale-margin-wrong-sign", "restrictions-forgotten-in-silence"),
    *("overspeed-ignored-by-first-computation", "second-computation-switched-off"),
}
"""Mutants made by hand; each once went undetected."""


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.name)
def test_a_mutant_applies_to_the_present_source(mutant: ControllerMutant) -> None:
    mutated_source(mutant, ROOT)


def test_there_are_enough_mutants_and_none_twice() -> None:
    assert len(MUTANTS) >= LEAST_MUTANTS
    changes = collections.Counter((each.file, each.old, each.new) for each in MUTANTS)
    assert [change for change, count in changes.items() if count > 1] == []
    assert {each.name for each in MUTANTS} >= FOUND_BY_HAND


def test_every_name_is_plain_and_every_mutant_changes_the_controller() -> None:
    for mutant in MUTANTS:
        assert re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*", mutant.name), mutant.name
        assert mutant.package == "vobc", mutant.name


def test_every_mutant_names_an_acceptance_case_that_tries_it_first() -> None:
    cases = plan_cases(read_campaign("acceptance"))
    known = {case.id for case in cases} | {case.scenario for case in cases}
    for mutant in MUTANTS:
        assert mutant.tries, mutant.name
        assert set(mutant.tries) <= known, f"{mutant.name}: {set(mutant.tries) - known}"


def test_every_equivalent_mutant_has_a_reason() -> None:
    for mutant in MUTANTS:
        assert not mutant.argued or len(mutant.argued.split()) >= 10, mutant.name
