"""A user's own line for trains that command themselves: the track file and its division file."""

import argparse
import shutil
from importlib import resources
from pathlib import Path

import pytest

from firmware_py.settings import SettingsError
from firmware_py.trackdb import load_line
from firmware_py.trackdb.areas import load_areas
from metro_hil.cli import vobc_run as vobc
from metro_hil.supervision.demo_ca import main as demo_ca
from plant_emulator import cli as plant
from plant_emulator.cli import command as plant_command
from plant_emulator.cli.options import parser as plant_parser
from vobc.cli import parser, plan

EPOCH_NS = 1_700_000_000_000_000_000
DIVISION = """\
name = "mine"
borders_m = [-120.0, 2800.0, 7700.0]
section_m = 100.0
apply_m = 800.0
"""


@pytest.fixture
def track(tmp_path: Path) -> Path:
    """The shipped loop under another name, without a division file."""
    text = Path(str(resources.files("firmware_py.trackdb") / "loop.toml")).read_text()
    path = tmp_path / "mine.toml"
    path.write_text(text.replace('name = "loop"', 'name = "mine"', 1))
    return path


@pytest.fixture
def divided(track: Path) -> Path:
    track.with_name("mine.areas.toml").write_text(DIVISION)
    return track


@pytest.fixture
def nothing_started(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def started(*_: object) -> None:
        pytest.fail("something was started")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(vobc, "RealtimeRun", started)
    monkeypatch.setattr(vobc, "make_run_folder", started)


def test_a_track_is_divided_by_the_file_beside_it(divided: Path) -> None:
    areas = load_areas(str(divided))

    assert areas.name == load_line(str(divided)).name == "mine"
    assert [area.end_m for area in areas.areas] == [2800.0, 7700.0]
    assert load_areas(str(divided.with_name("mine.areas.toml"))) == areas


def test_controller_plant_and_wayside_take_the_same_track(
    divided: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ["--line", str(divided), "--bus", "embedded:nowhere"]
    planned = plan(
        parser().parse_args([*words, "--train", "T1", "--line-radio", "tcp/127.0.0.1:7448"]),
        EPOCH_NS,
    )
    assert planned.areas == load_areas(str(divided))

    served: list[str] = []

    def serve_line(options: argparse.Namespace) -> int:
        served.append(options.line)
        return 0

    monkeypatch.setattr(plant_command, "serve_line", serve_line)
    assert plant.main(["run", "--wayside", "--line", str(divided)]) == 0
    assert served == [str(divided)]
    assert plant_parser().parse_args(["run", "--line", str(divided)]).line == str(divided)


def test_a_missing_division_names_the_expected_file(track: Path) -> None:
    with pytest.raises(SettingsError) as found:
        load_areas(str(track))

    beside = track.parent / "mine.areas.toml"
    words = f"{track}: line mine is not divided into areas; {beside} would say how"
    assert str(found.value) == words


def test_a_shipped_line_without_a_division_is_reported_as_such() -> None:
    with pytest.raises(SettingsError) as found:
        load_areas("changping")

    assert str(found.value) == (
        "line changping is not divided into areas; divided ones that ship: florence, loop; to "
        "divide your own line, write a file TRACK.toml with TRACK.areas.toml beside it"
    )


def test_an_unknown_line_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r"^lop: .*loop"):
        load_areas("lop")
    with pytest.raises(SettingsError, match="no such file"):
        load_areas(str(tmp_path / "lop.toml"))


def test_a_division_of_another_line_is_refused(track: Path) -> None:
    beside = track.with_name("mine.areas.toml")
    beside.write_text(DIVISION.replace("mine", "yours"))

    with pytest.raises(SettingsError, match=r"mine\.areas\.toml: name: 'yours' is not that of"):
        load_areas(str(track))


def test_an_unknown_key_of_a_division_beside_a_track_is_refused(divided: Path) -> None:
    divided.with_name("mine.areas.toml").write_text(DIVISION + "speed = 5.0\n")

    with pytest.raises(SettingsError, match=r"mine\.areas\.toml:5: speed: unknown key"):
        load_areas(str(divided))


def test_a_copy_of_a_divided_line_uses_the_shipped_division(tmp_path: Path) -> None:
    path = tmp_path / "copy.toml"
    shutil.copy(str(resources.files("firmware_py.trackdb") / "loop.toml"), path)

    assert load_areas(str(path)) == load_areas("loop")


@pytest.mark.usefixtures("nothing_started")
@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--line", "changping"], "line changping is not divided into areas"),
        (["--line", "mine.toml"], "mine.toml: line mine is not divided into areas; mine.areas"),
        (["--line", "loop", "--secure", "nowhere"], "--secure nowhere: nowhere/ca.pem: cannot be"),
    ],
)
def test_a_run_is_refused_before_anything_is_started(
    words: list[str], said: str, track: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert track.exists()
    assert vobc.main(["run", "--train", "T1", *words]) == 2

    error = capsys.readouterr().err
    assert error.startswith(f"vobc: {said}")
    assert error.count("\n") == 1


@pytest.mark.usefixtures("nothing_started")
def test_a_certificate_of_another_train_is_refused_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert demo_ca([str(tmp_path / "ca"), "--line", "loop", "--trains", "1"]) == 0
    words = ["run", "--train", "T2", "--line", "loop", "--secure", "ca"]
    capsys.readouterr()

    assert vobc.main(words) == 2
    assert "vobc: --secure ca: ca/T2.pem: cannot be read" in capsys.readouterr().err
