"""`hil init`: the files run as written, with the shipped controller and with the written one."""

import sys
from pathlib import Path

import pytest

from metro_hil.campaign import plan_cases
from metro_hil.campaign.read import read_campaign
from metro_hil.cli.hil import main
from metro_hil.cli.hil.init import skeleton_files
from metro_hil.model.case import Verdict
from metro_hil.run.dispatch import run_case


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("init") / "mine"
    assert main(["init", str(path)]) == 0
    return path


def test_the_scenarios_pass(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    cases = plan_cases(read_campaign("scenario.toml"))

    for case in (cases[0], cases[-1]):
        result = run_case(case)
        assert result.verdict is Verdict.PASS, result.reason
    assert {case.scenario for case in cases} == {"normal", "late-brake"}


def test_the_controller_passes(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    monkeypatch.setenv("PATH", str(Path(sys.executable).parent))

    (case,) = plan_cases(read_campaign("controller.toml"))
    result = run_case(case)

    assert result.verdict is Verdict.PASS, result.reason


def test_nothing_is_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "train.toml").write_text("mine")

    assert main(["init", str(tmp_path)]) == 2

    error = capsys.readouterr().err
    assert f"{tmp_path / 'train.toml'}: exists" in error
    assert error.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["train.toml"]


def test_a_file_is_no_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")

    assert main(["init", str(tmp_path / "file")]) == 2
    assert "is not a folder" in capsys.readouterr().err


def test_each_file_says_what_it_is_for() -> None:
    files = skeleton_files()

    assert all(text.startswith(("#", '"""')) for text in files.values())
    assert 'name = "mine"' in files["train.toml"]
    assert 'name = "mine"' in files["params.toml"]
