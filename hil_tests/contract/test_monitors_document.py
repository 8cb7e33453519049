"""docs/reference/monitors.md agrees with the code: tables, examples, output of commands."""

import json
import re
import tomllib
from pathlib import Path

import pytest

from metro_hil.cli.hil import main
from metro_hil.monitors import read_monitors
from metro_hil.monitors.catalogue import INVARIANTS
from metro_hil.monitors.catalogue_text import invariant_tables, signal_tables
from metro_hil.monitors.vocabulary import NAMES

DOCUMENT = (Path(__file__).resolve().parents[2] / "docs" / "reference" / "monitors.md").read_text(
    "utf-8"
)


@pytest.mark.parametrize("table", [invariant_tables(), signal_tables()], ids=["inv", "signals"])
def test_the_document_holds_the_tables_of_the_code(table: str) -> None:
    """When this fails, put the output of these functions into the document."""
    assert table in DOCUMENT


def test_the_example_is_valid() -> None:
    (text,) = re.findall(r"^```toml\n(.*?)^```$", DOCUMENT, re.MULTILINE | re.DOTALL)
    table = tomllib.loads(text.replace(', "inv-30", …]', "]"))

    assert (
        len(read_monitors(table["monitor"], "docs/reference/monitors.md", table["invariants"]))
        >= 27
    )


def test_the_command_lists_all_monitors(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["monitors"]) == 0
    shown = capsys.readouterr().out
    for name in (*NAMES, *(each.name for each in INVARIANTS)):
        assert name in shown.replace("\n", "")

    assert main(["monitors", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert [row["name"] for row in told["signals"]] == list(NAMES)
    assert len(told["invariants"]) == len(INVARIANTS)
    assert all(row["watched"] or row["why_not"] for row in told["invariants"])


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("inv-30", ["inv-30-door-side", "INV-30", "[m]", "Margin: 3 km/h less"]),
        ("40", ["Not watched: neither truth nor frames"]),
        ("speed_mps", ["[m/s]", "exactly 0 at standstill"]),
    ],
)
def test_the_command_explains_one_monitor(
    name: str, words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["monitors", name]) == 0
    shown = capsys.readouterr().out
    for word in words:
        assert word in shown


def test_an_unknown_name_gets_the_nearest_as_suggestion(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["monitors", "sped_mps"]) == 2
    assert "nearest valid name: speed_mps" in capsys.readouterr().err
