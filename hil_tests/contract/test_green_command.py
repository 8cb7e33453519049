"""The commands `hil run green-cbtc` and `vobc timetable` as a user runs them."""

import json
import tomllib
from pathlib import Path

import pytest

from metro_hil.cli.hil import main as hil
from metro_hil.cli.vobc import main as vobc
from metro_hil.energy.line import table_four


def test_the_campaign_prints_its_table_and_leaves_plots_and_timetables(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(table_four, "BUDGET", 2)
    out = tmp_path / "green"

    assert hil(["run", "green-cbtc", "--limit", "2", "--json", "--out", str(out)]) == 0

    heard = capsys.readouterr()
    told = json.loads(heard.out)
    assert "9.04 %" in heard.err
    assert told["seeds"] == [1, 2]
    for name in ("strong", "weak"):
        laws = {row["law"]: row for row in told[name]["rows"]}
        assert laws["traditional"]["change_ratio"] == 0.0
        assert laws["hold and coast"]["change_ratio"] < laws["green .786/.214"]["change_ratio"]
        assert (out / f"green_{name}.png").read_bytes().startswith(b"\x89PNG")
        table = tomllib.loads((out / f"timetable_{name}.toml").read_text(encoding="utf-8"))
        assert sum(table["runs_s"]) == pytest.approx(946.0)


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--filter", "*"], "--filter: green-cbtc has no cases"),
        (["--bench", "lockstep"], "--bench: green-cbtc has no cases"),
    ],
)
def test_options_without_meaning_for_the_campaign_are_refused(
    words: list[str], complaint: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert hil(["run", "green-cbtc", *words, "--out", str(tmp_path / "x")]) == 2
    assert complaint in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--line", "florence"], "--train: is missing; florence needs a train or --traffic"),
        (["--out", "there.toml"], "--out there.toml: exists already"),
        (["--out", "nowhere/x.toml"], "--out nowhere/x.toml: there is no folder nowhere"),
    ],
)
def test_a_timetable_error_is_one_line(
    words: list[str],
    complaint: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there.toml").write_text("", encoding="utf-8")

    assert vobc(["timetable", "--save-energy", *words]) == 2

    told = capsys.readouterr().err
    assert complaint in told
    assert told.count("\n") == 1


def test_a_found_timetable_is_printed_and_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "found.toml"

    words = ["--save-energy", "--supply", "weak", "--budget", "3", "--json", "--out", str(out)]
    assert vobc(["timetable", *words]) == 0

    told = json.loads(capsys.readouterr().out)
    assert told["on_time_ratio"] == 1.0
    assert told["change_ratio"] < 0.0
    assert tomllib.loads(out.read_text(encoding="utf-8"))["supply"] == "weak"
