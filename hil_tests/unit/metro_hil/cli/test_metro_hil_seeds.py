"""The seeds that are printed at the end of a campaign."""

import pytest

from metro_hil.cli.hil.verdicts import seeds_words
from metro_hil.model.case import Case, Setup


def cases(scenario: str, seeds: list[int]) -> list[Case]:
    return [
        Case(id=f"{scenario}/s{seed}", index=index, scenario=scenario, seed=seed, setup=Setup())
        for index, seed in enumerate(seeds)
    ]


@pytest.mark.parametrize(
    ("seeds", "words"),
    [
        ([1, 2], "1 to 2"),
        ([3, 1, 2, 7], "1 to 3, 7"),
        (list(range(1, 3501)), "1 to 3500"),
        (list(range(1, 17, 2)), "1, 3, 5, 7, 9, 11, 13, 15"),
        (list(range(1, 19, 2)), "9 of 1 to 17"),
    ],
)
def test_the_seeds_of_a_scenario_are_printed_with_the_command_for_one_of_them(
    seeds: list[int], words: str
) -> None:
    (told,) = seeds_words(cases("protection-florence", seeds))

    assert told == (
        f"seeds of protection-florence: {words}; "
        "any of them again: hil run protection-florence --seed N"
    )


def test_a_single_case_and_an_unshipped_scenario_print_no_seeds() -> None:
    assert seeds_words(cases("protection-florence", [4711])) == []
    assert seeds_words(cases("of my own", [1, 2])) == []
