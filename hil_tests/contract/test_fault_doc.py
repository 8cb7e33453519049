"""The committed catalogue of faults agrees with the declarations, and its examples can be run."""

import json
import re
import tomllib
from pathlib import Path

import pytest

from metro_hil.cli import hil
from metro_hil.model.frame_names import check_bus_fault
from metro_tools import fault_doc
from plant_emulator.faults.described import all_described
from plant_emulator.faults.kinds import CATALOGUE, FaultPlace
from plant_emulator.faults.plan import WINDOW_KEYS, read_fault, read_faults

DOCUMENT = Path(__file__).parents[2] / "docs" / "reference" / "faults.md"


def test_the_committed_catalogue_is_current() -> None:
    assert fault_doc.main(["--check", str(DOCUMENT)]) == 0, (
        "run python -m metro_tools.fault_doc in the project's folder"
    )


def test_the_catalogue_holds_every_kind_parameter_and_window_key() -> None:
    text = DOCUMENT.read_text(encoding="utf-8")

    for each in all_described():
        assert f"### {each.name}\n\n{each.story}" in text
        for parameter in each.parameters:
            assert f"| `{parameter.name}` | {parameter.kind} |" in text
    for key in WINDOW_KEYS:
        assert f"| `{key}` |" in text
    assert {each.name for each in all_described()} == set(CATALOGUE)


def test_the_examples_are_valid_and_name_existing_frames() -> None:
    block = re.search(r"```toml\n(.*?)```", DOCUMENT.read_text(encoding="utf-8"), re.DOTALL)
    assert block is not None
    faults = read_faults(tomllib.loads(block[1])["fault"], "faults.md")

    assert len(faults) == 4
    for each in faults:
        check_bus_fault(each)


def test_every_default_is_accepted_and_every_range_is_enforced() -> None:
    for each in all_described():
        assert each.story.endswith("."), each.name
        read_fault({"kind": each.name}, 0, "test")
        for parameter in each.parameters:
            if not parameter.range:
                continue
            low, high = (float(end.replace("−", "-")) for end in parameter.range.split(" … "))
            whole = parameter.kind == "whole number"
            for value in (low, high):
                table = {"kind": each.name, parameter.name: int(value) if whole else value}
                read_fault(table, 0, "test")
            with pytest.raises(ValueError, match=parameter.name):
                CATALOGUE[each.name].parameters(**{parameter.name: high + 1})


def test_every_number_has_a_unit_or_counts_something() -> None:
    bare = {
        parameter.name
        for each in all_described()
        for parameter in each.parameters
        if parameter.kind == "number" and not parameter.unit
    }

    assert bare == set()


def test_the_check_fails_for_any_other_text(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "faults.md"
    assert fault_doc.main([str(path)]) == 0
    assert fault_doc.main(["--check", str(path)]) == 0
    path.write_text(path.read_text(encoding="utf-8") + "\n", encoding="utf-8")

    assert fault_doc.main(["--check", str(path)]) == 1
    assert "outdated; run python -m metro_tools.fault_doc" in capsys.readouterr().err
    assert fault_doc.main([str(tmp_path / "no" / "where.md")]) == 2


def test_the_command_lists_all_kinds_and_details_one(capsys: pytest.CaptureFixture[str]) -> None:
    assert hil.main(["faults"]) == 0
    everything = capsys.readouterr().out
    assert all(name in everything for name in CATALOGUE)

    assert hil.main(["faults", "bus_off"]) == 0
    one = capsys.readouterr().out
    assert all(word in one for word in ("recovers", "vobc", "128 times 11", "lockstep"))
    assert "frame_drop" not in one


def test_the_json_output_groups_faults_by_place(capsys: pytest.CaptureFixture[str]) -> None:
    assert hil.main(["faults", "--place", "radio", "--json"]) == 0

    found = json.loads(capsys.readouterr().out)

    wanted = [kind.name for kind in CATALOGUE.values() if kind.place is FaultPlace.RADIO]
    assert [each["name"] for each in found] == wanted
    assert found[0]["parameters"][0] == {
        "name": "loss_ratio",
        "kind": "number",
        "unit": "1",
        "default": "0.5",
        "range": "0 … 1",
        "story": "",
    }


@pytest.mark.parametrize(
    ("words", "nearest"),
    [(["frame_dorp"], "frame_drop"), (["--place", "buss"], "bus")],
)
def test_the_command_suggests_the_nearest_name(
    words: list[str], nearest: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert hil.main(["faults", *words]) == 2

    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert said.endswith(f": {nearest}\n")
