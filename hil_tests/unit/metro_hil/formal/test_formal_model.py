"""The TLA+ model of the protocol: its guards are those of the code, and TLC finds a removed one."""

import dataclasses
from pathlib import Path

import pytest

from metro_hil.formal import model_runs
from metro_hil.formal.conformance import JUDGED, UNSEEN
from metro_hil.formal.model_runs import (
    GUARDS,
    INVARIANTS,
    MODEL,
    RUNS,
    Searched,
    UnableError,
    guards_of,
    outcome,
)
from plant_emulator.wayside.arbiter import ArbiterGuards
from plant_emulator.wayside.line_object import ObjectGuards
from vobc.train_to_train.guards import LeaseGuards, MasterGuards, MemberGuards

TEXT = MODEL.read_text(encoding="utf-8")
OTHER_RULES = {"ends_at_border", "ends_behind_rear", "left_area", "memory", "arbiter.memory"}
"""Rules of the model that the code has as formulas or states and not as guards."""


def test_every_guard_of_the_model_is_removed_in_a_run() -> None:
    assert guards_of(TEXT) == set(GUARDS)
    assert {guard.run for guard in GUARDS.values()} <= set(RUNS)
    assert {guard.invariant for guard in GUARDS.values()} == set(INVARIANTS) - {"Apart"}


def test_guards_of_the_model_have_the_names_of_the_code() -> None:
    kinds = (ArbiterGuards, ObjectGuards, LeaseGuards, MasterGuards, MemberGuards)
    names = {field.name for kind in kinds for field in dataclasses.fields(kind)}

    assert {guard.split(".")[-1] for guard in GUARDS if guard not in OTHER_RULES} <= names


def test_the_check_of_messages_knows_every_guard_and_every_action() -> None:
    judged = {guard for guards in JUDGED.values() for guard in guards}

    assert (judged | set(UNSEEN)) - {"OneOwner", "OrderKept"} == set(GUARDS)
    assert not judged & set(UNSEEN)
    assert all(f"\n{action}(" in TEXT for action in JUDGED)


def test_the_model_is_short() -> None:
    assert len(TEXT.splitlines()) <= 300


def test_the_result_of_tlc_is_read_and_no_result_is_no_success() -> None:
    done = "9 states generated, 7 distinct states found, 0 states left on queue.\n"
    depth = "The depth of the complete state graph search is 5.\n"
    assert outcome(done + depth) == Searched("", 5, 7)
    assert outcome("Error: Invariant Apart is violated.\nState 1: <x>\nState 2: <y>\n") == Searched(
        "Apart", 1, 0
    )
    with pytest.raises(UnableError, match="TLC did not finish: Java ran out of memory"):
        outcome("Error: Java ran out of memory.  Run it again\n")
    with pytest.raises(UnableError, match="no result"):
        outcome(done.replace("0 states left", "3 states left") + depth)


@pytest.mark.parametrize(
    ("words", "said"),
    [(["borders"], "borders is no run and no guard"), (["--jar", "x.jar"], "x.jar: no such file")],
)
def test_wrong_words_name_what_to_do(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert model_runs.main(words) == 3
    assert said in capsys.readouterr().err


@pytest.mark.usefixtures("tlc")
def test_tlc_finds_a_removed_guard() -> None:
    jar = model_runs.find_jar(None)
    found = model_runs.search(RUNS["border"], ("ends_at_border",), jar, 1)

    assert found == Searched("OverBorder", 2, 0)


def test_the_jar_may_be_named(tmp_path: Path) -> None:
    jar = tmp_path / "tla2tools.jar"
    jar.touch()
    assert model_runs.find_jar(jar) == jar
