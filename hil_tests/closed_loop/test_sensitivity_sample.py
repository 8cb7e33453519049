"""`hil sensitivity`: a sample of the mutants, drawn by the commit, and mutants made by hand."""

import json
import subprocess
from pathlib import Path

import pytest

from metro_hil.cli.hil import main
from metro_hil.engine.program import program_version
from metro_hil.sensitivity import mutants
from metro_hil.sensitivity.mutants import ControllerMutant

ROOT = Path(__file__).resolve().parents[2]
SHARE = "0.05"
SCENARIO = """
title = "one hop"
[train]
start = "II"
end = "III"
duration_s = 12.0
[[monitor]]
name = "it sets off"
stl = "eventually(speed_mps > 1)"
[[monitor]]
name = "slowly"
stl = "always(speed_mps < 8)"
"""


def commit() -> str:
    """The commit that is checked out, or without one a hash over the sources."""
    done = subprocess.run(
        ["git", "rev-parse", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    return done.stdout.strip() or program_version()


@pytest.mark.slow
def test_a_twentieth_of_the_mutants_is_detected_or_justified(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """When this fails, run `hil sensitivity --only NAME` with the names that it shows."""
    words = ["sensitivity", "acceptance", "--quick", "--sample", SHARE, "--seed", commit()]

    code = main([*words, "--workers", "2", "--out", str(tmp_path / "out")])

    assert code == 0, capsys.readouterr().out


def hand_made(name: str, *, old: str, new: str, argued: str = "") -> ControllerMutant:
    return ControllerMutant(
        name=name,
        rule="made by hand",
        file="vobc/atp/supervision.py",
        old=old,
        new=new,
        argued=argued,
        source="own.toml",
    )


NEVER_MOVES = hand_made(
    "never-moves", old="return inputs.mode in NEEDED", new="return inputs.mode is None"
)
SAME = hand_made("same", old="return bool(inputs.latched)", new="return len(inputs.latched) > 0")
MISSPELT = hand_made("misspelt", old="return bool(inputs.latched)", new="return bool(inputs.latch)")
NO_IMPORT = hand_made(
    "no-import",
    old="Guard = Callable[[GuardInputs], bool]",
    new="Guard = Callabel[[GuardInputs], bool]",
)
ARGUED = hand_made(
    "argued",
    old="return bool(inputs.latched)",
    new="return len(inputs.latched) > 0",
    argued="a tuple is true when it is not empty",
)
WRONGLY_ARGUED = hand_made(
    "wrongly-argued",
    old="return inputs.mode in NEEDED",
    new="return inputs.mode is None",
    argued="nothing could ever notice that",
)


def test_the_result_of_each_mutant_is_printed_and_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    tried = (NEVER_MOVES, SAME, MISSPELT, NO_IMPORT, ARGUED, WRONGLY_ARGUED)
    monkeypatch.setattr(mutants, "shipped_mutants", lambda: tried)
    campaign = tmp_path / "own.toml"
    campaign.write_text(SCENARIO, encoding="utf-8")

    code = main(
        ["sensitivity", str(campaign), "--thorough", "--workers", "2", "--out", str(tmp_path / "o")]
    )

    text = capsys.readouterr().out
    report = json.loads((tmp_path / "o" / "sensitivity.json").read_text(encoding="utf-8"))
    outcomes = {each["mutant"]: each["outcome"] for each in report["findings"]}
    assert code == 1
    assert outcomes == {
        "never-moves": "noticed",
        "same": "unnoticed",
        "misspelt": "invalid",
        "no-import": "invalid",
        "argued": "argued",
        "wrongly-argued": "noticed against its argument",
    }
    assert "own/s1: it sets off" in text
    assert "NameError" in text
    assert "AttributeError" in text
    assert "add a scenario that notices it, or an `argued` to own.toml" in text
    assert (tmp_path / "o" / "junit.xml").is_file()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--only", "reset-in-motoin"], "hil: --only reset-in-motoin: "),
        (["acceptence"], "hil: acceptence: no campaign and no scenario"),
    ],
)
def test_a_wrong_name_is_one_line_and_exit_code_2(
    words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code = main(["sensitivity", *words])

    said = capsys.readouterr().err
    assert code == 2
    assert said.startswith(message)
    assert said.count("\n") == 1


def test_a_mutant_that_no_longer_applies_is_one_line_and_nothing_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    gone = hand_made("gone", old="return inputs.latched_once", new="return False")
    monkeypatch.setattr(mutants, "shipped_mutants", lambda: (gone,))
    campaign = tmp_path / "own.toml"
    campaign.write_text(SCENARIO, encoding="utf-8")

    code = main(["sensitivity", str(campaign), "--out", str(tmp_path / "o")])

    said = capsys.readouterr().err
    assert code == 2
    assert said.startswith("hil: own.toml: gone: old: does not occur in vobc/atp/supervision.py; ")
    assert said.count("\n") == 1
    assert not (tmp_path / "o").exists()
