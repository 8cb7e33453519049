"""The faults on the page of a run: the catalogue, and acts that the plant gets or that fail."""

import json
from pathlib import Path
from typing import Any, Final

import pytest

from firmware_py import settings
from firmware_py.settings import SettingsError
from metro_hil.watch.fault_acts import FaultActs, open_fault_acts
from plant_emulator.cli.by_hand import FAULT_ACTS, FAULT_RECORD
from plant_emulator.faults.described import UNITS
from plant_emulator.faults.kinds import BENCH_PLACES, CATALOGUE

JUNCTION: Final = Path(__file__).resolve().parents[4] / "docs/examples/line/junction.toml"


def acts_of(folder: Path, *, lockstep: bool, line: str = "florence") -> FaultActs:
    text = f'[options]\nconsist = "florence4"\nlockstep = {str(lockstep).lower()}\n'
    (folder / "run.toml").write_text(f'{text}line = "{line}"\n')
    return open_fault_acts(folder)


@pytest.fixture
def acts(tmp_path: Path) -> FaultActs:
    return acts_of(tmp_path, lockstep=True)


def kinds_of(acts: FaultActs) -> dict[str, Any]:
    return {each["name"]: each for place in acts.catalogue for each in place["kinds"]}


def test_the_catalogue_has_each_fault_with_a_sentence_units_and_ranges(acts: FaultActs) -> None:
    kinds = kinds_of(acts)

    assert set(kinds) == set(CATALOGUE)
    json.dumps(acts.catalogue)
    assert all(each["story"].endswith(".") for each in kinds.values())
    assert kinds["brake_late"]["parameters"] == [
        {
            "name": "delay_s",
            "kind": "number",
            "unit": "s",
            "range": "0 … 30",
            "story": "",
            "value": 1.0,
        }
    ]
    (mode,) = kinds["desk_mode"]["parameters"]
    assert (mode["kind"], mode["value"]) == ("off, auto, manual", "off")
    units = {each["unit"] for kind in kinds.values() for each in kind["parameters"]}
    assert units <= {"", *UNITS.values()} - {"1"}


@pytest.mark.parametrize("lockstep", [True, False])
def test_the_page_says_what_this_run_cannot_have(tmp_path: Path, lockstep: bool) -> None:
    missing = {
        name: each["missing"]
        for name, each in kinds_of(acts_of(tmp_path, lockstep=lockstep)).items()
    }

    refused = {name for name, why in missing.items() if "real time" in why}
    bench = {name for name, kind in CATALOGUE.items() if kind.place in BENCH_PLACES}
    assert refused == (set() if lockstep else bench)
    assert {name for name, why in missing.items() if "loops" in why} == {
        "loop_break",
        "loop_offset",
        "loop_short",
    }


def test_a_person_sets_routes_and_fails_switches_of_a_network_alone(
    acts: FaultActs, tmp_path: Path
) -> None:
    wanted = {"act": "start", "fault": "route_set", "values": {"route": "back"}}
    assert "no switch" in acts.act(wanted)
    assert "no switches" in kinds_of(acts)["switch_stray"]["missing"]

    network = acts_of(tmp_path, lockstep=True, line=f"{JUNCTION}:out")

    assert network.act(wanted) == ""
    assert kinds_of(network)["switch_stray"]["missing"] == ""
    wrong = {"act": "start", "fault": "switch_lost", "values": {"switch": "W9"}}
    assert "switch: 'W9': no such switch; valid names: W1" in network.act(wrong)


def test_power_sections_fail_only_on_a_line_that_has_them(acts: FaultActs, tmp_path: Path) -> None:
    assert "no power sections" in kinds_of(acts)["power_section_off"]["missing"]
    path = tmp_path / "fed.toml"
    text = settings.text_of(settings.find("florence", "firmware_py.trackdb"))
    section = "\n[[power_sections]]\nstart_m = -120.0\nend_m = 4700.0\nname = 'S7'\n"
    path.write_text(text + section, encoding="utf-8")

    fed = acts_of(tmp_path, lockstep=True, line=str(path))

    assert kinds_of(fed)["power_section_off"]["missing"] == ""
    wanted = {"act": "start", "fault": "power_section_off", "values": {"section": "S7"}}
    assert fed.act(wanted) == ""
    assert "valid names: S7" in fed.act({**wanted, "values": {"section": "S8"}})


def test_acts_reach_the_plant_with_the_number_of_the_record(
    acts: FaultActs, tmp_path: Path
) -> None:
    record = tmp_path / FAULT_RECORD
    assert acts.news() is None
    record.write_text('fault = [{ kind = "brake_weak", start_s = 1.0 }]')
    assert acts.news() == [{"kind": "brake_weak", "start_s": 1.0}]
    assert acts.news() is None
    for message in (
        {"act": "start", "fault": "brake_late", "values": {"delay_s": 2.0}},
        {"act": "set", "index": 0, "values": {"gain_ratio": 0.1}},
        {"act": "stop", "index": 0},
    ):
        assert acts.act(message) == ""

    assert [json.loads(line) for line in (tmp_path / FAULT_ACTS).read_text().splitlines()] == [
        {"start": {"kind": "brake_late", "delay_s": 2.0}},
        {"set": 0, "values": {"gain_ratio": 0.1}},
        {"stop": 0},
    ]


@pytest.mark.parametrize(
    ("message", "text"),
    [
        ({}, "there is no fault None"),
        ({"act": "start"}, "kind: missing key"),
        ({"act": "start", "fault": "brake_late", "values": 3}, "values"),
        ({"act": "start", "fault": "brake_late", "values": {"delay_s": 99.0}}, "0..30"),
        ({"act": "start", "fault": ["brake_late"]}, "unknown kind"),
        ({"act": "stop", "index": 0}, "there is no fault 0"),
        ({"act": "stop", "index": -1}, "there is no fault -1"),
    ],
)
def test_an_impossible_act_is_refused_with_a_reason(
    message: dict[str, Any], text: str, acts: FaultActs, tmp_path: Path
) -> None:
    assert text in acts.act(message)
    assert (tmp_path / FAULT_ACTS).read_text() == ""


def test_a_folder_without_options_is_refused(tmp_path: Path) -> None:
    (tmp_path / "run.toml").write_text("")
    with pytest.raises(SettingsError, match=r"run\.toml: options\.consist"):
        open_fault_acts(tmp_path)
