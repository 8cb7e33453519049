"""The committed document of the tables agrees with the tables and shows all of them."""

import re
from pathlib import Path

import pytest

from can_dbc.vobc import AtoPhase, Cause, OperatingMode, Supervision
from metro_tools import table_doc
from vobc.ato import mode as ato_phases
from vobc.atp import jog, modes, supervision
from vobc.atp.jog import JogState

DOCUMENT = Path(__file__).parents[2] / "docs" / "reference" / "supervision.md"


def test_the_committed_document_is_current() -> None:
    assert table_doc.main(["--check", str(DOCUMENT)]) == 0, (
        "run python -m metro_tools.table_doc in the project's folder"
    )


def test_every_row_of_every_table_is_drawn_as_an_arrow_and_as_a_line() -> None:
    text = table_doc.document()

    for table in (
        modes.TRANSITIONS,
        supervision.TRANSITIONS,
        jog.TRANSITIONS,
        ato_phases.TRANSITIONS,
    ):
        for state, rows in table.items():
            for guard, to in rows:
                name = guard.__name__.replace("_", " ")
                assert f"    {state.name} --> {to.name}: {name}\n" in text
                assert f"| {state.name} | {name} | {to.name} |\n" in text


def test_the_document_names_every_state_and_every_cause() -> None:
    text = table_doc.document()

    for kind in (OperatingMode, Supervision, AtoPhase, JogState):
        for state in kind:
            assert re.search(rf"--> {state.name}\b", text), state
    for cause in Cause:
        if cause:
            assert f"| {cause.name} | " in text


def test_every_machine_has_one_diagram_with_one_initial_state() -> None:
    text = table_doc.document()

    assert text.count("```mermaid\nstateDiagram-v2\n") == 4
    assert text.count("[*] -->") == 4


def test_the_check_fails_for_any_other_text(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "supervision.md"
    assert table_doc.main([str(path)]) == 0
    assert table_doc.main(["--check", str(path)]) == 0
    path.write_text(path.read_text(encoding="utf-8") + "\n", encoding="utf-8")

    assert table_doc.main(["--check", str(path)]) == 1
    assert "outdated; run python -m metro_tools.table_doc" in capsys.readouterr().err
    assert table_doc.main([str(tmp_path / "no" / "where.md")]) == 2
