"""A train that is exported and imported again is the same train."""

import json
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_py.settings import build, find, parse, shipped_names
from metro_hil.exchange import export_command, import_command
from metro_hil.exchange.railml_train import read_rolling_stock
from metro_hil.exchange.survey import Element, SurveyedTrain
from metro_hil.exchange.train_export import (
    ExportedTrain,
    load_exported,
    railml_train_text,
    ttobench_train_text,
)
from metro_hil.exchange.train_rules import complete_train
from metro_hil.exchange.ttobench import read_train
from metro_hil.exchange.xml_node import XmlNode
from plant_emulator.train_config import PACKAGE, TrainConfig, load_train

SPEED_MPS: Final = 25.0
BASE: Final = parse(find("florence4", PACKAGE))


@st.composite
def consists(draw: st.DrawFn) -> dict[str, Any]:
    """The shipped train with other cars, effort, brakes and resistance."""
    cars = [
        {
            "tare_kg": draw(st.floats(1.5e4, 6e4)),
            "length_m": draw(st.floats(10.0, 30.0)),
            "passengers_kg": draw(st.floats(0.0, 2e4)),
            "motor": number == 0 or draw(st.booleans()),
        }
        for number in range(draw(st.integers(2, 8)))
    ]
    traction: dict[str, Any] = {
        "rated_force_n": draw(st.floats(0.4, 1.4)) * sum(car["tare_kg"] for car in cars),
        "max_power_w": draw(st.floats(5e5, 8e6)),
        "efficiency_ratio": draw(st.floats(0.5, 1.0)),
    }
    if draw(st.booleans()):
        traction["effort"] = [
            {"speed_mps": at_mps, "force_n": traction["rated_force_n"] * ratio}
            for at_mps, ratio in ((0.0, 1.0), (9.3, 0.9), (21.0, 0.3))
        ]
    table: dict[str, Any] = json.loads(json.dumps(BASE)) | {
        "name": "drawn",
        "cars": cars,
        "load_ratio": draw(st.floats(0.0, 1.0)),
        "rotating_mass_percent": draw(st.floats(0.0, 20.0)),
    }
    table["traction"] |= traction
    table["resistance"]["c_n_per_kn_per_mps2"] = draw(st.floats(0.0, 0.05))
    table["brake"]["service"]["max_decel_mps2"] = draw(st.floats(0.6, 1.0))
    return table


def exported(table: dict[str, Any]) -> ExportedTrain:
    return ExportedTrain(build(TrainConfig, table, "drawn"), table, SPEED_MPS)


def from_railml(text: str) -> SurveyedTrain:
    return read_rolling_stock(XmlNode("t.railml", ElementTree.fromstring(text)), None)  # noqa: S314


def from_ttobench(train: ExportedTrain) -> SurveyedTrain:
    return read_train(Element("t.json", "", json.loads(ttobench_train_text(train))))


@settings(max_examples=10, deadline=None)
@given(consists())
def test_railml_gives_the_same_consist_again(table: dict[str, Any]) -> None:
    consist, _ = complete_train(from_railml(railml_train_text(exported(table))))

    assert build(TrainConfig, consist.table, "back") == build(TrainConfig, table, "drawn")


@settings(max_examples=10, deadline=None)
@given(consists())
def test_both_formats_have_what_they_can_say(table: dict[str, Any]) -> None:
    """Without the designator the elements of railML must be as good as the values of TTOBench."""
    train = exported(table)
    root = ElementTree.fromstring(railml_train_text(train))  # noqa: S314 - our own text
    for formation in root.iter("{https://www.railml.org/schemas/3.2}formation"):
        for designator in formation.findall("{https://www.railml.org/schemas/3.2}designator"):
            formation.remove(designator)

    by_elements = read_rolling_stock(XmlNode("t.railml", root), None)
    values = from_ttobench(train)

    config = train.config
    for survey in (by_elements, values):
        assert not survey.given
        assert survey.mass_kg == pytest.approx(config.mass_kg)
        assert survey.length_m == pytest.approx(config.length_m)
        assert survey.cars == len(config.cars)
        assert survey.decel_mps2 == pytest.approx(config.brake.service.max_decel_mps2)
        assert survey.resistance_n == pytest.approx(train.resistance_n, rel=1e-6, abs=1e-3)
    if not config.traction.effort:
        assert by_elements.force_n == pytest.approx(config.traction.rated_force_n)


@settings(max_examples=10, deadline=None)
@given(consists())
def test_ttobench_gives_the_same_train_again_once_it_has_been_there(table: dict[str, Any]) -> None:
    once, _ = complete_train(from_ttobench(exported(table)))
    twice, _ = complete_train(from_ttobench(exported(once.table)))

    def numbers(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: numbers(part) for key, part in value.items() if key != "description"}
        if isinstance(value, list):
            return [numbers(part) for part in value]
        return float(f"{value:.12g}") if isinstance(value, float) else value

    assert numbers(twice.table) == numbers(once.table)


@pytest.mark.parametrize("name", shipped_names(PACKAGE))
def test_a_shipped_train_comes_back(name: str) -> None:
    survey = from_railml(railml_train_text(load_exported(name, SPEED_MPS)))

    assert build(TrainConfig, dict(survey.given), name) == load_train(name)


def test_an_element_that_another_program_changed_counts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = railml_train_text(load_exported("florence4", SPEED_MPS))
    assert text.count('tareWeight="35"') == 2
    path = tmp_path / "t.railml"
    path.write_text(text.replace('bruttoWeight="41.8"', 'bruttoWeight="44"'), encoding="utf-8")

    assert import_command.main([str(path), "--out", str(tmp_path)]) == 0

    assert "elements were changed since the export" in capsys.readouterr().out
    assert load_train(str(tmp_path / "florence4.toml")).mass_kg == pytest.approx(161_600.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "name either a line, or a train with --consist"),
        (("florence", "--consist", "florence4"), "name either a line, or a train with --consist"),
        (("--consist", "florense4"), "florense4"),
        (("--consist", "florence4", "--max-speed", "nan"), "--max-speed nan: is not in 0..500"),
    ],
)
def test_mistakes_of_an_export_of_a_train_are_named(
    arguments: tuple[str, ...], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert export_command.main([*arguments, "--as", "railml", "--out", "never.railml"]) == 2
    assert message in capsys.readouterr().err
