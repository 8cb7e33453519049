"""Lists of mutants: valid entries, the selection of mutants, and the change of a source."""

from pathlib import Path
from typing import Any

import pytest

from firmware_py.settings import SettingsError
from metro_hil.sensitivity.mutants import (
    ControllerMutant,
    chosen,
    mutated_source,
    read_mutants,
    sampled,
)

SOURCE = "LIMIT = 1\n\n\ndef brakes(speed):\n    return speed >= LIMIT\n"


def a_mutant(**changes: Any) -> ControllerMutant:
    table = {
        "name": "late",
        "rule": "brakes at the limit",
        "file": "vobc/brakes.py",
        "old": "speed >= LIMIT",
        "new": "speed > LIMIT",
        "source": "some.toml",
        **changes,
    }
    return ControllerMutant(**table)


@pytest.fixture
def root(tmp_path: Path) -> Path:
    (tmp_path / "vobc").mkdir()
    (tmp_path / "vobc" / "brakes.py").write_text(SOURCE, encoding="utf-8")
    return tmp_path


def test_a_mutant_changes_the_one_place(root: Path) -> None:
    assert mutated_source(a_mutant(), root) == SOURCE.replace(">=", ">")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"old": "speed >= MOST"}, "old: does not occur in vobc/brakes.py; copy the present text"),
        ({"old": "LIMIT"}, "old: occurs 2 times in vobc/brakes.py; copy the present text"),
        ({"new": "speed >"}, "new: no Python at vobc/brakes.py:5"),
        ({"new": "(speed >= LIMIT)"}, "new: changes nothing but layout"),
        ({"file": "vobc/gone.py"}, "file: vobc/gone.py: cannot be read"),
    ],
)
def test_a_mutant_that_does_not_apply_names_list_mutant_file_and_remedy(
    root: Path, changes: dict[str, str], words: str
) -> None:
    with pytest.raises(SettingsError) as caught:
        mutated_source(a_mutant(**changes), root)

    text = str(caught.value)
    assert text.startswith("some.toml: late: ")
    assert words in text
    assert "\n" not in text


def table(**changes: object) -> dict[str, object]:
    return {"name": "a", "rule": "r", "file": "f.py", "old": "1", "new": "2", **changes}


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        ({"mutants": []}, "some.toml: mutants: unknown key; a list holds [[mutant]] only"),
        ({"mutant": [table(olds="1")]}, "some.toml: a: olds: unknown key"),
        ({"mutant": [table(source="x")]}, "some.toml: a: source: unknown key"),
        ({"mutant": [table(new="1")]}, "new is the same text as old"),
        ({"mutant": [table(old=" ")]}, "old is empty"),
        ({"mutant": [{"name": "a"}]}, "some.toml: a: rule: missing key"),
        ({"mutant": [{}]}, "some.toml: number 1: name: missing key"),
        ({"mutant": [table(tries=["x", 1])]}, "some.toml: a: tries"),
    ],
)
def test_an_error_in_a_list_is_one_line_with_list_mutant_and_key(
    tables: dict[str, object], words: str
) -> None:
    with pytest.raises(SettingsError) as caught:
        read_mutants(tables, "some.toml")

    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_mutants_are_chosen_by_name_or_pattern_in_the_order_of_the_list() -> None:
    mutants = [a_mutant(name=name) for name in ("door-a", "brake", "door-b")]

    assert [each.name for each in chosen(mutants, [])] == ["door-a", "brake", "door-b"]
    assert [each.name for each in chosen(mutants, ["brake", "door-*"])] == [
        *("door-a", "brake", "door-b")
    ]
    assert [each.name for each in chosen(mutants, ["door-b"])] == ["door-b"]


def test_an_unknown_mutant_is_refused_with_the_nearest_name() -> None:
    with pytest.raises(SettingsError, match=r"--only brak: .*brake"):
        chosen([a_mutant(name="brake")], ["brak"])


def test_a_sample_is_the_same_for_the_same_seed_and_another_for_another() -> None:
    mutants = [a_mutant(name=f"m{number}") for number in range(100)]

    first = sampled(mutants, 0.1, "3ee8faf")

    assert first == sampled(list(reversed(mutants)), 0.1, "3ee8faf")[::-1]
    assert len(first) == 10
    assert first != sampled(mutants, 0.1, "9a50b18")
    assert sampled(mutants, 1.0, "x") == tuple(mutants)


def test_a_sample_of_few_is_at_least_one() -> None:
    assert len(sampled([a_mutant()], 0.001, "x")) == 1


def test_many_seeds_sample_every_mutant() -> None:
    mutants = [a_mutant(name=f"m{number}") for number in range(20)]

    drawn = {each.name for seed in range(200) for each in sampled(mutants, 0.1, str(seed))}

    assert len(drawn) == 20


def test_the_module_of_a_file() -> None:
    assert a_mutant(file="vobc/atp/doors.py").module == "vobc.atp.doors"
    assert a_mutant(file="vobc/atp/__init__.py").module == "vobc.atp"
    assert a_mutant(file="vobc/atp/doors.py").package == "vobc"
