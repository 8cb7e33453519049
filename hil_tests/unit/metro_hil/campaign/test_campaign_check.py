"""`hil check`: its report about a campaign, as text and as JSON."""

import json
from pathlib import Path

import pytest

from metro_hil.campaign import plan_cases, read_campaign
from metro_hil.cli.hil import main
from metro_hil.engine.folder import CampaignPlan, make_folder

GOOD = """
title = "Late brakes"
requirements = ["ACC-05"]
seeds = 3
[train]
end = "I"
duration_s = 300
[[fault]]
kind = "brake_late"
when = "speed_mps > 10"
duration_s = 5.0
[sweep]
design = "sobol"
count = 6
[sweep.factors]
"fault.0.delay_s" = { low = 0.5, high = 2.0 }
"train.load_ratio" = [0.0, 1.0]
"""


def hil(*words: str) -> int:
    return main(["check", *words])


@pytest.fixture
def campaign(tmp_path: Path) -> str:
    path = tmp_path / "late.toml"
    path.write_text(GOOD)
    return str(path)


def test_check_lists_what_would_run(campaign: str, capsys: pytest.CaptureFixture[str]) -> None:
    code = hil(campaign, "--list", "2")

    said = capsys.readouterr().out
    assert code == 0
    for words in (
        "late: Late brakes",
        "18 cases in 1 scenario, at most 90 min of simulated time",
        "18 cases: 6 points (sobol) × 3 seeds",
        "bench lockstep, controller shipped",
        "factor fault.0.delay_s: 0.5 to 2",
        "factor train.load_ratio: 0.0, 1.0 (2)",
        "fault brake_late",
        "when speed_mps > 10 for 5.0 s",
        "requirements ACC-05",
        "late/0000-s1\n",
        "late/0000-s2\n",
        "… and 16 more",
        "note: late: sweep.count 6 is no power of two",
    ):
        assert words in said, said


def test_check_lists_all_cases_when_asked(
    campaign: str, capsys: pytest.CaptureFixture[str]
) -> None:
    hil(campaign, "--cases")

    assert capsys.readouterr().out.count("late/00") == 18


def test_check_prints_the_same_as_json(campaign: str, capsys: pytest.CaptureFixture[str]) -> None:
    code = hil(campaign, "--json", "--cases")

    said = json.loads(capsys.readouterr().out)
    assert code == 0
    assert said["cases"] == len(said["listed"]) == 18
    assert said["simulated_s_max"] == 18 * 300.0
    assert said["scenarios"][0]["factors"] == {
        "fault.0.delay_s": "0.5 to 2",
        "train.load_ratio": "0.0, 1.0 (2)",
    }


def test_check_reports_every_error_on_its_own_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "bad.toml"
    path.write_text("seeds = 0\n[train]\nload_ratio = 2\n")

    code = hil(str(path), "--json")

    said = capsys.readouterr()
    assert code == 2
    assert said.err.splitlines() == [
        f"hil: {path}:1: seeds: 0 is not within 1..10000000",
        f"hil: {path}:3: train.load_ratio: 2.0 is not within 0..1",
    ]
    assert len(json.loads(said.out)["problems"]) == 2


def test_an_unknown_layout_is_refused_by_check_and_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "one.toml"
    path.write_text('layout = "florenz"\n')
    wanted = f"hil: {path}: layout: 'florenz': nearest valid layout: florence\n"

    assert hil(str(path)) == 2
    assert capsys.readouterr().err == wanted
    assert main(["run", str(path), "--out", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err == wanted
    assert not (tmp_path / "out").exists()


def test_an_unknown_requirement_is_noted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "one.toml"
    path.write_text('requirements = ["INV-04", "ACC-999", "OURS-X"]\n')

    assert hil(str(path), "--json") == 0

    assert json.loads(capsys.readouterr().out)["notes"] == [
        "requirements: ACC-999 is not in the catalogue; nearest valid id: ACC-29",
        "requirements: OURS-X is not in the catalogue",
        "one: ACC-999: no monitor judges it; name it in a [[monitor]]",
        "one: OURS-X: no monitor judges it; name it in a [[monitor]]",
    ]


def test_check_shows_the_fingerprint_that_run_stores(
    campaign: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    hil(campaign, "--json")
    checked = json.loads(capsys.readouterr().out)["fingerprint"]
    read = read_campaign(campaign)
    plan = CampaignPlan(name=read.name, cases=plan_cases(read), files=read.files, options={})

    written = make_folder(plan, out=str(tmp_path / "out")).manifest().fingerprint

    assert checked == written


def test_an_inherited_title_is_shown_once(
    campaign: str, capsys: pytest.CaptureFixture[str]
) -> None:
    hil(campaign)

    assert capsys.readouterr().out.count("Late brakes") == 1


def test_check_of_a_missing_campaign_is_one_line(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert hil("florenc") == 2
    assert capsys.readouterr().err == (
        "hil: florenc: no campaign and no scenario; nearest: florence, lines-florence, "
        "florence-ideal; `hil scenarios` lists all\n"
    )
