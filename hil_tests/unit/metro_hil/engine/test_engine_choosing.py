"""Which cases `hil run` runs, and which one `hil rerun` repeats."""

import pytest

from metro_hil.engine.choosing import choose, pick_case, read_controller
from metro_hil.engine.errors import UsageError
from metro_hil.engine.trial_runner import trial_cases
from metro_hil.model.case import BenchKind, ControllerSpec

CASES = (*trial_cases(12),)


def test_chosen_cases_keep_their_ids_and_get_new_numbers() -> None:
    chosen = choose(CASES, pattern="*-s1?", limit=2)

    assert [(case.index, case.id) for case in chosen] == [
        (0, "trial/0009-s10"),
        (1, "trial/0010-s11"),
    ]


def test_bench_and_controller_are_the_requested_ones() -> None:
    (case,) = choose(CASES, limit=1, bench="processes", controller="checkout:../old")

    assert case.bench is BenchKind.PROCESSES
    assert case.controller == ControllerSpec(kind="checkout", path="../old")


def test_a_filter_that_matches_nothing_is_refused_with_an_example() -> None:
    with pytest.raises(UsageError, match=r"--filter nope: matches none of the 12.*trial/0000-s1"):
        choose(CASES, pattern="nope")


@pytest.mark.parametrize("words", ["", "checkout", "checkout:", "command:", "shiped"])
def test_an_invalid_controller_is_refused(words: str) -> None:
    with pytest.raises(UsageError, match="--controller"):
        read_controller(words)


def test_a_command_may_contain_colons() -> None:
    assert read_controller("command:run --bus tcp:1") == ControllerSpec(
        kind="command", command="run --bus tcp:1"
    )


@pytest.mark.parametrize("words", ["trial/0003-s4", "trial/0003", "3"])
def test_a_case_is_selected_by_id_prefix_or_number(words: str) -> None:
    assert pick_case(CASES, words) is CASES[3]


@pytest.mark.parametrize("words", ["trial/00", "12", "x", ""])
def test_an_unknown_or_ambiguous_case_is_refused(words: str) -> None:
    with pytest.raises(UsageError, match=r"trial/0000-s1|cases begin like this"):
        pick_case(CASES, words)
