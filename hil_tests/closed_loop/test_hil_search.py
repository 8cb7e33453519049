"""`hil search` finds the same with any number of processes, and its worst cases repeat."""

import io
import json
from contextlib import redirect_stdout
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


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("campaign") / "slow.toml"
    path.write_text(SLOW_START)
    return path


def search(campaign: Path, out: Path, *words: str) -> Any:
    said = ["search", str(campaign), "--budget", "10", "--monitor", "top speed", "--json"]
    printed = io.StringIO()
    with redirect_stdout(printed):
        assert main([*said, "--out", str(out), *words]) == 0
    return json.loads(printed.getvalue())


@pytest.fixture(scope="module")
def found(campaign: Path, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """What a search in one process finds."""
    return search(campaign, tmp_path_factory.mktemp("found") / "out", "--workers", "1")


def test_a_search_finds_the_same_with_any_number_of_processes(
    campaign: Path, tmp_path: Path, found: Any
) -> None:
    three = search(campaign, tmp_path / "three", "--workers", "3")

    assert found["points"] == 10
    assert found["worst"] == three["worst"]
    histories = [Path(each["history"]).read_bytes() for each in (found, three)]
    assert histories[0] == histories[1]
    assert len(histories[0].splitlines()) == 10
    assert found["worst"][0]["values"]["train.desk_mode"] == "auto", "with the desk off it stands"


def test_the_worst_cases_repeat_with_the_same_margins(found: Any) -> None:
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
