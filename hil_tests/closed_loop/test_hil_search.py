"""`hil search` finds the same with any number of processes, and its worst cases repeat."""

import json
from pathlib import Path
from typing import Any, Final

import pytest

from metro_hil.campaign import plan_cases, read_campaign
from metro_hil.cli.hil import main
from metro_hil.run.dispatch import run_case

SLOW_START: Final = """
title = "How far the train comes in its first seconds"
invariants = "none"
[train]
start = "II"
duration_s = 15.0
[[monitor]]
name = "top speed"
stl = "always(speed_mps <= 6.0)"
unit = "m/s"
[sweep.factors]
"train.load_ratio" = { low = 0.0, high = 1.0, count = 2 }
"train.desk_mode" = ["auto", "off"]
"""


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    path = tmp_path / "slow.toml"
    path.write_text(SLOW_START)
    return path


def search(campaign: Path, out: Path, capsys: pytest.CaptureFixture[str], *words: str) -> Any:
    said = ["search", str(campaign), "--budget", "10", "--out", str(out), "--json", *words]
    assert main(said) == 0
    return json.loads(capsys.readouterr().out)


def test_a_search_finds_the_same_with_any_number_of_processes(
    campaign: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one = search(campaign, tmp_path / "one", capsys, "--workers", "1")
    three = search(campaign, tmp_path / "three", capsys, "--workers", "3")

    assert one["points"] == 10
    assert one["worst"] == three["worst"]
    histories = [Path(found["history"]).read_bytes() for found in (one, three)]
    assert histories[0] == histories[1]
    assert len(histories[0].splitlines()) == 10
    assert one["worst"][0]["values"]["train.desk_mode"] == "auto", "with the desk off it stands"


def test_the_worst_cases_repeat_with_the_same_margins(
    campaign: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = search(campaign, tmp_path / "out", capsys, "--monitor", "top speed")

    (first, *_) = plan_cases(read_campaign(found["campaign"]))
    (monitor,) = run_case(first).monitors
    assert monitor.margin == found["worst"][0]["margins"]["top speed"]
    assert monitor.margin == found["worst"][0]["value"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--scenario", "fast"], "hil: --scenario fast: "),
        (["--factors", "train.load"], "nearest valid factor: train.load_ratio"),
        (["--monitor", "top sped", "--budget", "1"], "hil: --monitor top sped: nearest"),
    ],
)
def test_a_wrong_option_is_one_line(
    words: list[str],
    said: str,
    campaign: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    code = main(["search", str(campaign), "--out", str(tmp_path / "out"), *words])

    (line,) = capsys.readouterr().err.splitlines()
    assert code == 2
    assert said in line
    assert not (tmp_path / "out").exists(), "nothing is left of a search that was none"
