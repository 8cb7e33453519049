"""The mapping file of an FMU, checked without the FMU."""

from pathlib import Path

import pytest

from can_dbc.nodes import Node
from firmware_py.settings import SettingsError
from metro_hil.foreign_plant.mapping import PlantMapping, read_mapping

VARIABLES = ("F", "body.s", "body.v", "a[1]", "u", "i")
START = ("front_m", "mass_kg")
GOOD = """\
fmu = "train.fmu"
provides = ["motion", "HVB"]
[parameters]
u = "mass_kg / 1000"
[inputs]
F = "drive_n - 2 * TRACTION_CMD.force_n"
[truth]
front_m = "body.s"
speed_mps = "body.v / 3.6"
accel_mps2 = "a[1]"
voltage_v = 750
[frames.LINE_SUPPLY]
line_voltage_v = "u"
line_current_a = "i"
breaker_closed = 1
[frames.ENERGY_METER]
drawn_kwh = 0
regenerated_kwh = 0.5
"""


def read(tmp_path: Path, text: str = GOOD) -> PlantMapping:
    path = tmp_path / "train.toml"
    path.write_text(text)
    return read_mapping(path, VARIABLES, START)


def test_names_expressions_and_numbers_have_their_values(tmp_path: Path) -> None:
    mapping = read(tmp_path)
    known = {"body.s": 7.0, "body.v": 36.0, "a[1]": 0.5}

    assert (mapping.moves, mapping.nodes) == (True, frozenset({Node.HVB}))
    assert mapping.fmu == tmp_path / "train.fmu"
    values = {name: term.value(known) for name, term in mapping.truth.items()}
    assert values == {"front_m": 7.0, "speed_mps": 10.0, "accel_mps2": 0.5, "voltage_v": 750.0}
    assert mapping.parameters["u"].value({"mass_kg": 5000.0}) == 5.0
    inputs = {"drive_n": 10.0, "TRACTION_CMD.force_n": 3.0}
    assert mapping.inputs["F"].value(inputs) == 4.0
    assert mapping.signals() == ("TRACTION_CMD.force_n",)
    assert mapping.frames["ENERGY_METER"]["regenerated_kwh"].value({}) == 0.5


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('fmu = "train.fmu"', "", "fmu: missing key"),
        ('"HVB"', '"HVX"', "provides: 'HVX': nearest valid value: HVB"),
        ("provides", "provide", "provide: unknown key; nearest valid key: provides"),
        ("F = ", "G = ", ":6: inputs.G: no variable of the FMU"),
        ("\nu = ", "\nv = ", ":4: parameters.v: no variable of the FMU"),
        ("mass_kg", "mas_kg", ":4: parameters.u: .*mas_kg"),
        ("TRACTION_CMD.force_n", "TRACTION_CMD.force", "nearest valid name: TRACTION_CMD.force_n"),
        (
            "TRACTION_CMD.force_n",
            "LINE_SUPPLY.line_voltage_v",
            "inputs.F: LINE_SUPPLY.line_voltage_v",
        ),
        ('"body.v / 3.6"', '"body.v /"', "truth.speed_mps: .*not an expression"),
        ('"body.v / 3.6"', '"body.x / 3.6"', "truth.speed_mps: body.x: nearest valid name"),
        ('front_m = "body.s"\n', "", "truth.front_m: missing"),
        ("accel_mps2", "acel_mps2", "truth.acel_mps2: .*nearest valid value: accel_mps2"),
        ("LINE_SUPPLY", "LINE_SUPLY", "frames.LINE_SUPLY: .*nearest valid value: LINE_SUPPLY"),
        ("line_current_a", "line_curent_a", "line_curent_a: nearest valid value: line_current_a"),
        ('line_current_a = "i"\n', "", "frames.LINE_SUPPLY.line_current_a: missing key"),
        ("750", "[750]", "truth.voltage_v: .*is not a string"),
        ("[truth]", "[truth", "not TOML"),
        ("[parameters]", "standstill_mps = 0.2\n[parameters]", "standstill_mps 0.2 is not within"),
    ],
)
def test_a_mistake_is_named_with_key_and_remedy(
    tmp_path: Path, old: str, new: str, words: str
) -> None:
    with pytest.raises(SettingsError, match=words) as complaint:
        read(tmp_path, GOOD.replace(old, new, 1))

    assert "train.toml" in str(complaint.value)
    assert "\n" not in str(complaint.value)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r"none\.toml: no such file"):
        read_mapping(tmp_path / "none.toml", (), ())
