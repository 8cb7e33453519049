"""Tables of motors from CSV files, in a consist of one's own and beside a foreign train."""

from pathlib import Path

import pytest

from firmware_py import settings
from metro_hil.exchange import import_command
from plant_emulator.train_config import load_train

CONSIST = settings.find("nanakuma4", "plant_emulator.consists").read_text(encoding="utf-8")
FILES = {
    "pull.csv": "speed_kmh,effort_kn\n0,103\n36,100\n72,40\n",
    "brake.csv": "brake_n, speed_mps\n120e3,0\n60e3,20\n\n",
    "map.csv": "speed_kmh,traction_0.1,traction_1.0\n0,0.5,0.6\n36,0.7,0.8\n",
    "back.csv": "speed_mps,brake_0.5\n0,0.4\n",
}


def imported(folder: Path, **files: str) -> int:
    """Import the consist beside these CSV files, whose names end with `_csv`."""
    (folder / "mine.toml").write_text(CONSIST, encoding="utf-8")
    names = ["mine.toml", *(name.replace("_csv", ".csv") for name in files)]
    for name, text in zip(names[1:], files.values(), strict=True):
        (folder / name).write_text(text, encoding="utf-8")
    paths = [str(folder / name) for name in names]
    return import_command.main([*paths, "--out", str(folder / "out")])


def test_each_table_goes_to_its_key_of_the_consist(tmp_path: Path) -> None:
    files = {name.replace(".csv", "_csv"): text for name, text in FILES.items()}
    assert imported(tmp_path, **files) == 0

    train = load_train(str(tmp_path / "out" / "mine.toml"))
    electric, traction = train.brake.service.electric, train.traction
    points = [(each.speed_mps, each.force_n) for each in traction.effort]
    assert points == [(0.0, 103e3), (pytest.approx(10.0), 100e3), (pytest.approx(20.0), 40e3)]
    assert [(each.speed_mps, each.force_n) for each in electric.effort] == [
        (0.0, 12e4),
        (20.0, 6e4),
    ]
    assert traction.efficiency is not None
    assert traction.efficiency.load_ratio == (0.1, 1.0)
    assert traction.efficiency.efficiency_ratio == ((0.5, 0.6), (0.7, 0.8))
    assert electric.efficiency is not None
    assert electric.efficiency.at(9.0, 0.9) == 0.4


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "bad.csv: line 1: '' is no head of a table; write speed_kmh"),
        ("speed_kmh,traction_0.1,brake_1\n0,0.5,0.5\n", "is no head of a table"),
        ("speed_kmh,traction_x\n0,0.5\n", "is no head of a table"),
        ("speed_kmh,speed_mps,effort_n\n0,0,1\n", "is no head of a table"),
        ("speed_kmh,effort_n\n", "bad.csv: has no row of numbers below its head"),
        ("speed_kmh,effort_n\n0,1,2\n", "bad.csv: line 2: '0,1,2' is not 2 numbers"),
        ("speed_kmh,effort_n\n0,inf\n", "bad.csv: line 2: '0,inf' is not 2 numbers"),
        ("speed_kmh,brake_n\n36,1\n", "electric: effort: begins at 10.0 m/s, not at 0"),
        ("speed_kmh,brake_1\n0,60\n", "bad.csv: mine.toml: brake.service.electric.efficiency"),
        (FILES["map.csv"], "bad.csv: a second table for traction.efficiency; give one"),
    ],
)
def test_a_bad_table_is_refused_with_file_and_key_and_nothing_is_written(
    text: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert imported(tmp_path, map_csv=FILES["map.csv"], bad_csv=text) == 2

    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_consist_without_tables_is_no_import(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert imported(tmp_path) == 2

    assert "mine.toml: is a file of this project already" in capsys.readouterr().err
