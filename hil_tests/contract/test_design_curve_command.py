"""The command `vobc design-curve`: its output, its files and its refusals."""

import json
from pathlib import Path

import pytest

from metro_hil.cli.vobc import main


def test_the_json_output_holds_the_parameters_and_keeps_the_time(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    out = tmp_path / "curve"
    words = ["--line", "nanakuma", "--from", "Chayama", "--to", "Befu", "--eta", "5", "--json"]

    assert main(["design-curve", *words, "--optimal", "--literal", "--out", str(out)]) == 0

    told = json.loads(capsys.readouterr().out)
    assert (told["from"], told["to"], told["length_m"]) == ("Chayama", "Befu", 1000.0)
    assert told["train"]["name"] == "seed002"
    assert told["curve"]["time_s"] == pytest.approx(72.5, abs=0.02)
    assert told["optimum"]["above_ratio"] > 0.0
    assert told["profile"]["speed_mps"][0] == 0.0
    assert (out / "curve.png").read_bytes().startswith(b"\x89PNG")
    assert json.loads((out / "results.json").read_text(encoding="utf-8")) == told


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--from", "Befuu"], "--from Befuu: no such station; nanakuma has Hashimoto"),
        (["--from", "Befu", "--to", "Chayama"], "--to Chayama: not beyond Befu"),
        (["--from", "Tenjin-Minami"], "--from Tenjin-Minami: is the last station"),
        (["--time", "40"], "--time 40: the fastest run of seed002 takes"),
        (["--time", "900"], "--time 900: with the least power limit"),
        (["--train", "seed003"], "seed003"),
        (["--out", "."], "--out .: not empty"),
    ],
)
def test_a_user_error_is_one_line(
    words: list[str], complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["design-curve", *words]) == 2

    told = capsys.readouterr().err
    assert complaint in told
    assert told.count("\n") == 1


@pytest.mark.parametrize("words", [["--eta", "-1"], ["--receptive", "2"], ["--time", "soon"]])
def test_a_number_out_of_range_is_a_usage_error(words: list[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["design-curve", *words])
