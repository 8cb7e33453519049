"""The verbs of `vobc`: each has its module, and those that print shipped files print them."""

import importlib
import json
from pathlib import Path

import pytest

from firmware_py.trackdb import load_line
from metro_hil.cli.shipped_files import PACKAGES
from metro_hil.cli.vobc import GROUPS, VERBS, main
from metro_hil.model.run_options import LINE_VERBS, OTHER_VERBS, SHIPPED_VERBS

ROOT = Path(__file__).parents[4]
FOLDERS = {
    "line": "firmware_py/trackdb", "consist": "plant_emulator/consists", "params": "vobc/params",
}  # fmt: skip


def test_each_verb_of_the_help_has_a_module_and_no_other_has() -> None:
    assert set(VERBS) == set(OTHER_VERBS)
    assert set(GROUPS) == {*SHIPPED_VERBS, *LINE_VERBS}
    for module in {*VERBS.values(), *GROUPS.values(), "metro_hil.cli.vobc_run"}:
        assert callable(importlib.import_module(module).main)


def test_the_bare_controller_is_a_verb(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["device", "--bus", "nosuch"]) == 3

    assert "nosuch" in capsys.readouterr().err


def test_lines_and_consists_have_a_row_for_each_file_that_ships(
    capsys: pytest.CaptureFixture[str],
) -> None:
    for verb, kind in (("lines", "line"), ("consists", "consist")):
        files = sorted(path.stem for path in (ROOT / FOLDERS[kind]).glob("*.toml"))
        assert main([verb]) == 0
        assert [row.split()[0] for row in capsys.readouterr().out.splitlines()] == files
        assert main([verb, "--json"]) == 0
        assert [row["name"] for row in json.loads(capsys.readouterr().out)[verb]] == files


def test_a_row_tells_of_its_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["lines", "--json"]) == 0

    rows = {row["name"]: row for row in json.loads(capsys.readouterr().out)["lines"]}
    line = load_line("florence")
    assert rows["florence"]["stations"] == len(line.stations)
    assert (rows["florence"]["from"], rows["florence"]["to"]) == ("Start", "IV")
    assert (rows["florence"]["areas"], rows["hefei"]["areas"]) == (True, False)


@pytest.mark.parametrize("kind", PACKAGES)
def test_show_prints_each_shipped_file_as_it_is(
    kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    files = sorted((ROOT / FOLDERS[kind]).glob("*.toml"))
    assert len(files) > 3

    for path in files:
        assert main(["show", kind, path.stem]) == 0
        assert capsys.readouterr().out == path.read_text(encoding="utf-8")


def test_show_names_the_nearest_shipped_file(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["show", "line", "florenze"]) == 2
    assert "nearest valid shipped name: florence" in capsys.readouterr().err
