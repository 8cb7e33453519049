"""`hil laws` and `hil requirements`: tables for people, JSON for programs, the same content."""

import json

import pytest

from metro_hil.cli.hil import main
from metro_hil.model.requirements import shipped_requirements


@pytest.fixture(autouse=True)
def wide(monkeypatch: pytest.MonkeyPatch) -> None:
    """Makes the terminal wide enough for each row to be one line."""
    monkeypatch.setenv("COLUMNS", "400")


def test_laws_have_a_row_for_each_scenario_of_the_json(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["laws", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert main(["laws"]) == 0
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]

    assert {"predictive", "pid"} <= set(found)
    for law, scenarios in found.items():
        assert [law] in rows
        for name, each in scenarios.items():
            (row,) = [row for row in rows if row[:1] == [name] and len(row) == 9]
            assert int(row[1]) == each["figures"]["stops"]
            assert float(row[3]) == pytest.approx(100.0 * each["figures"]["mean_m"], abs=0.006)


def test_requirements_have_a_row_each(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["requirements", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["requirements"]
    assert main(["requirements"]) == 0
    table = capsys.readouterr().out

    assert [each["id"] for each in found] == list(shipped_requirements())
    rows = {line.split()[0]: line for line in table.splitlines() if line.strip()}
    for each in found:
        assert each["text"] in rows[each["id"]]


def test_one_requirement_names_its_scenarios_and_tests(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["requirements", "inv-10"]) == 0

    said = capsys.readouterr().out
    assert said.startswith("INV-10 (safety invariant 10): A jog covers at most 5 m")
    assert "  scenario undershoot-jog: passed\n" in said
    assert all(f"  test {test}\n" in said for test in shipped_requirements()["INV-10"].tests)


def test_an_unknown_requirement_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["requirements", "INV-1O"]) == 2

    error = capsys.readouterr().err
    assert error.startswith("hil: requirement 'INV-1O': unknown; nearest valid value: INV-")
    assert error.count("\n") == 1
