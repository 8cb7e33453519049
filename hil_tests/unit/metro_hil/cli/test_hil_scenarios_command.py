"""`hil scenarios` as a user types it: through `main`, with and without arguments."""

import argparse
import json

import pytest

from metro_hil.campaign.scenarios import shipped_scenarios
from metro_hil.cli import hil


def listed(capsys: pytest.CaptureFixture[str], *words: str) -> list[str]:
    """Names that `hil scenarios` prints for these arguments, with exit code 0."""
    assert hil.main(["scenarios", *words, "--json"]) == 0
    return [each["name"] for each in json.loads(capsys.readouterr().out)["scenarios"]]


def test_all_shipped_scenarios_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    names = listed(capsys)

    assert names == [each.name for each in shipped_scenarios()]
    assert "overspeed-runaway" in names


def test_the_table_has_a_row_for_each_scenario(capsys: pytest.CaptureFixture[str]) -> None:
    assert hil.main(["scenarios", "reckless"]) == 0

    assert "reckless-driver" in capsys.readouterr().out


def test_words_choose_scenarios_that_have_all_of_them(capsys: pytest.CaptureFixture[str]) -> None:
    assert "table-7-predictive" in listed(capsys, "FLORENCE", "table-7")
    assert "reckless-driver" not in listed(capsys, "florence")


def test_a_word_that_no_scenario_has_is_an_error(capsys: pytest.CaptureFixture[str]) -> None:
    assert hil.main(["scenarios", "no-such-word"]) == 2

    assert capsys.readouterr().err == (
        "hil: no-such-word: no shipped scenario has it; `hil scenarios` lists all\n"
    )


def verbs() -> dict[str, argparse.ArgumentParser]:
    (action,) = (
        each for each in hil.parser()._actions if isinstance(each, argparse._SubParsersAction)
    )
    return dict(action.choices)


@pytest.mark.parametrize("verb", sorted(verbs()))
def test_no_verb_has_an_option_that_main_overwrites(verb: str) -> None:
    """`main` keeps the typed arguments in `typed`. `hil scenarios` once declared that name
    itself."""
    dests = {action.dest for action in verbs()[verb]._actions}

    assert not dests & {"typed", "run", "verb"}
