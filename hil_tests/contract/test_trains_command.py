"""The commands `vobc run --lockstep --trains` and `plant run --trains` as a user runs them."""

import json
from pathlib import Path

import pytest

from metro_hil.cli.vobc import main as vobc
from plant_emulator.cli import main as plant


def test_a_line_of_trains_writes_its_page_and_prints_the_energy(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "line"
    words = ["run", "--lockstep", "--trains", "2", "--supply", "weak", "--ato", "timing"]

    assert vobc([*words, "--duration", "12", "--json", "--out", str(out)]) == 0

    told = json.loads(capsys.readouterr().out)
    assert told == json.loads((out / "results.json").read_text(encoding="utf-8"))
    assert (told["line"], told["trains"], told["law"]) == ("changping", 2, "timing")
    assert told["supply"] == "weak"
    assert (told["solved"], told["unconverged"], told["emergencies"]) == (60, 0, 0)
    assert abs(told["closure_ratio"]) < 1e-6
    assert told["actual_kwh"] > 2 * 0.12e6 * 10.0 / 3.6e6
    assert (out / "line.png").read_bytes().startswith(b"\x89PNG")
    for train in ("train1", "train2"):
        assert (out / train / "cycles.csv").exists()


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--trains", "2"], "--trains: with --lockstep only"),
        (["--lockstep", "--trains", "2", "--from", "Shahe"], "--from: not with --trains"),
        (["--lockstep", "--trains", "0"], "0 is not within 1..99"),
        (["--lockstep", "--supply", "weak"], "--supply: only with --trains"),
        (["--lockstep", "--no-logs"], "--no-logs: only with --trains"),
        (["--lockstep", "--trains", "2", "--masters"], "--masters: only with --service"),
        (["--lockstep", "--kill-master-at", "3"], "--kill-master-at: only with --masters"),
        (
            ["--masters", "--kill-master-at", "3", "--cut-master-at", "4"],
            "one of them for each run",
        ),
        (["--masters", "--cut-master-at", "0"], "a second of the run, from 0.05 on"),
    ],
)
def test_impossible_options_of_a_line_are_refused_at_once(
    words: list[str], complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        vobc(["run", *words])

    assert ended.value.code == 2
    assert complaint in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--trains", "8"], "--trains 8: on changping there are 1 to 7"),
        (["--trains", "2", "--line", "florence"], "florence has no traffic file"),
    ],
)
def test_a_line_that_cannot_supply_the_trains_is_named(
    words: list[str], complaint: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = str(tmp_path / "none")
    assert vobc(["run", "--lockstep", *words, "--out", out]) == 2
    assert complaint in capsys.readouterr().err
    assert plant(["run", *words]) == 2
    assert complaint in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--trains", "2", "--from", "Shahe"], "--from: is for one train"),
        (["--trains", "2", "--faults", "x.toml"], "--faults: is for one train"),
        (["--trains", "2", "--desk", "manual"], "--desk: is for one train"),
        (["--trains", "2", "--tags", "/dev/ttyUSB0"], "--tags, --radio: each of several trains"),
        (["--trains", "2", "--bus", "socketcan:vcan0"], "each train has a bus of its own; write #"),
        (["--supply", "weak"], "--supply: only with --trains"),
    ],
)
def test_a_plant_of_several_trains_refuses_options_for_one_train(
    words: list[str], complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert plant(["run", *words]) == 2

    assert complaint in capsys.readouterr().err
