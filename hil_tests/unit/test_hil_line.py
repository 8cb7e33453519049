"""`hil run line` tells what happens, and says what does not fit instead of running."""

from pathlib import Path

import pytest

from metro_hil.hil_command import main

FLORENCE = ["--line", "florence", "--trains", "2", "--bench", "lockstep"]


def test_it_says_who_commands_and_ends_with_a_table(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [*FLORENCE, "--for", "3.5", "--out", str(tmp_path / "run")]

    assert main(["run", "line", *words]) == 0

    told = capsys.readouterr().out
    assert "area 2: train 1 commands" in told
    assert "latency ms" in told
    assert (tmp_path / "run" / "line.log").stat().st_size > 10_000


def test_a_stopped_master_goes_on_as_one_of_many(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--trains", "3", "--bench", "lockstep", "--for", "5", "--stop-master-at", "2"]

    assert main(["line", *words, "--down-for", "1.5", "--out", str(tmp_path / "run")]) == 0

    told = capsys.readouterr().out
    assert "the controller of train 2 stops" in told
    assert "area 2: train 3 commands, term" in told
    assert "the controller of train 2 goes on" in told
    assert "struck" in told


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--trains", "9"], "room for 1 to 8"),
        (["--trains", "0"], "room for 1 to 8"),
        (["--for", "0"], "--for 0: not a duration"),
        (["--line", "hefei"], "line hefei is not divided into areas"),
        (["--line", "nowhere.toml"], "nowhere.toml: no such file"),
        (["--line-radio", "here"], "here: not an endpoint"),
        (["--restart-train-at", "T7@3"], "--restart-train-at T7: there is no such train"),
        (["--bench", "lockstep", "--restart-train-at", "T1@3"], "not in lockstep"),
    ],
)
def test_what_does_not_fit_is_said_in_one_line(
    words: list[str], complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["line", *words]) == 2

    told = capsys.readouterr().err
    assert complaint in told
    assert len(told.splitlines()) == 1


@pytest.mark.parametrize("fault", ["T1", "@3", "T0@3", "T1@-1", "Tx@3"])
def test_what_is_no_train_and_second_is_refused(
    fault: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(["run", "line", "--restart-train-at", fault])

    assert "--restart-train-at" in capsys.readouterr().err
