"""`hil run line` reports events and refuses invalid options."""

import json
import tomllib
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from firmware_py.clock.clock import WallClock
from metro_hil.cli.hil import main, parser
from metro_hil.cli.hil.line_settings import radio_words, settings_of
from metro_hil.watch.command import main as watch
from metro_hil.watch.companion import WatchPage
from metro_hil.watch.line_folder import serve_line_folder
from metro_hil.watch.line_source import FolderSource
from zenoh_config.timers import TIMER_SETS

FLORENCE = ["--line", "florence", "--trains", "2", "--bench", "lockstep"]


def test_it_reports_the_masters_and_ends_with_a_table(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [*FLORENCE, "--for", "3.5", "--out", str(tmp_path / "run")]

    assert main(["run", "line", *words]) == 0

    told = capsys.readouterr().out
    assert "area 2: train 1 commands" in told
    assert "latency ms" in told
    assert (tmp_path / "run" / "line.log").stat().st_size > 10_000
    story = (tmp_path / "run" / "story.txt").read_text()
    assert "area 2: train 1 commands" in story
    assert told.startswith(story)


def test_its_folder_holds_options_and_results(tmp_path: Path) -> None:
    words = [*FLORENCE, "--for", "5", "--stop-master-at", "3", "--line-timers", "B", "--seed", "7"]

    assert main(["run", "line", *words, "--out", str(tmp_path / "run")]) == 0

    asked = tomllib.loads((tmp_path / "run" / "run.toml").read_text())
    assert (asked["seed"], asked["bench"], asked["options"]["duration_s"]) == (7, "lockstep", 5.0)
    assert asked["line"]["name"] == "florence"
    assert asked["line"]["timers"]["lease_ms"] == TIMER_SETS["B"].lease_ms
    assert asked["faults"] == [{"fault": "stop-master", "at_s": 3.0}]
    assert [each["train"] for each in asked["trains"]] == [1, 2]
    assert "python" in asked["versions"]
    came = json.loads((tmp_path / "run" / "results.json").read_text())
    assert (came["exit_reason"], came["verdict"]) == ("duration over", "passed")
    assert [(each["train"], each["emergencies"]) for each in came["trains"]] == [(1, []), (2, [])]
    assert came["areas"][0]["terms"][0]["term"] == 1


def test_a_secured_line_that_has_no_keys_leaves_no_folder(tmp_path: Path) -> None:
    words = ["--secure", str(tmp_path / "nothing"), "--out", str(tmp_path / "run")]

    assert main(["line", *words]) == 2

    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ["--insecure"],
            "tcp/h:1; watch it with `vobc line --watch --line-radio tcp/h:1 --insecure`",
        ),
        (
            ["--line", "florence", "--secure", "my keys"],
            "tcp/h:1; watch it with `vobc line --watch --line-radio tcp/h:1 --line florence "
            "--secure 'my keys'`",
        ),
    ],
)
def test_the_printed_command_to_watch_it_can_be_run(words: list[str], said: str) -> None:
    options = parser().parse_args(["line", "--trains", "2", "--line-radio", "tcp/h:1", *words])

    assert radio_words(settings_of(options)) == f"line radio: {said}"


def test_a_radio_in_a_separate_network_is_reported_as_unreachable() -> None:
    options = parser().parse_args(["line", "--trains", "2", "--networks"])

    said = radio_words(settings_of(options))

    assert "in a network of its own" in said
    assert "tcp/" not in said


def test_a_watched_run_has_its_page_from_its_first_message_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    run = tmp_path / "run"
    shown: list[list[dict[str, Any]]] = []

    class Page(WatchPage):
        def __init__(self, folder: Path, *may: str) -> None:
            assert (folder / "line.log").stat().st_size < 100
            assert not may
            self.line = "page: here"

        def stay(self, say: object) -> None:
            source = FolderSource(run, WallClock(), real_time=False)
            shown.append([step._asdict() for _ in range(2) for step in source.steps()])
            assert source.results.text == "The run has ended: passed, duration over"

        def __exit__(self, *_: object) -> None:
            assert shown

    monkeypatch.setattr("metro_hil.watch.companion.WatchPage", Page)
    assert main(["line", *FLORENCE, "--for", "2.5", "--out", str(run), "--watch"]) == 0

    notes = [text for step in shown[0] for _, text in step["notes"]]
    printed = capsys.readouterr().out
    assert printed.startswith("page: here\n")
    assert notes
    assert all(f"s  {text}" in printed for text in notes)
    assert sum(len(step["messages"]) for step in shown[0]) > 100
    with closing(serve_line_folder(run, host="127.0.0.1", commands=True)) as server:
        assert server.address.startswith("http://127.0.0.1:")


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("bench = 1", "run.toml: Expected `str`, got `int` - at `$.bench`; another version"),
        ("bench = ", "run.toml: Invalid value"),
        (
            'bench = "lockstep"\n[options]\nline = "hefei"\n[line]',
            "run.toml: line hefei is not divided into areas",
        ),
    ],
)
def test_a_damaged_folder_of_a_run_is_refused_in_one_line(
    tmp_path: Path, text: str, complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "line.log").touch()
    (tmp_path / "run.toml").write_text(text)

    assert watch([str(tmp_path), "--no-browser"]) == 2

    told = capsys.readouterr().err
    assert complaint in told
    assert len(told.splitlines()) == 1


def test_a_stopped_master_goes_on_as_a_member(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--trains", "3", "--bench", "lockstep", "--for", "5", "--stop-master-at", "2"]

    assert main(["line", *words, "--down-for", "1.5", "--out", str(tmp_path / "run")]) == 0

    told = capsys.readouterr().out
    assert "the controller of train 2 stops" in told
    assert "area 2: train 3 commands, term" in told
    assert "the controller of train 2 goes on" in told
    assert "struck" in told


def test_the_restart_of_a_killed_wayside_is_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [*FLORENCE, "--for", "3", "--crash-arbiter-at", "1", "--down-for", "0.5"]

    main(["line", *words, "--out", str(tmp_path / "run")])

    told = capsys.readouterr().out
    assert told.index("arbiters dies") < told.index("the wayside with its arbiters is started")


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--trains", "9"], "room for 1 to 8"),
        (["--trains", "0"], "room for 1 to 8"),
        (["--for", "0"], "--for 0: not a duration"),
        (["--for", "nan"], "--for nan: not a duration"),
        (["--for", "1.1e9"], "--for 1.1e+09: not a duration"),
        (["--for", "1e999"], "--for inf: not a duration"),
        (["--line", "hefei"], "line hefei is not divided into areas"),
        (["--line", "nowhere.toml"], "nowhere.toml: no such file"),
        (["--line-radio", "here"], "here: not an endpoint"),
        (["--restart-train-at", "T7@3"], "--restart-train-at T7: there is no such train"),
        (["--bench", "lockstep", "--restart-train-at", "T1@3"], "not in lockstep"),
        (["--topology", "mesh", "--bench", "lockstep"], "--topology mesh: --bench lockstep"),
        (["--topology", "mixed", "--secure", "secure"], "--topology mixed: not with --secure"),
        (["--topology", "mesh", "--networks"], "--topology mesh: networks of their own"),
        (["--topology", "mesh", "--cut-master-at", "3"], "--topology mesh: --cut-master-at"),
        (["--bench", "lockstep", "--secure", "x"], "--secure x: --bench lockstep has no network"),
        (
            ["--bench", "lockstep", "--line-radio", "tcp/[::1]:1"],
            "--line-radio tcp/[::1]:1: --bench",
        ),
        (["--kill-master-at", "100", "--for", "10"], "--kill-master-at 100: the run ends before"),
        (["--restart-train-at", "T1@9", "--for", "9"], "T1@9: the run ends before, by --for 9"),
        (["--watch", "--networks"], "--watch does not go with networks of their own; `vobc watch`"),
        (["--commands"], "--commands is for the page; add --watch"),
        (["--watch", "--commands", "--bench", "lockstep"], "--commands: --bench lockstep has no"),
    ],
)
def test_inconsistent_options_are_refused_in_one_line(
    words: list[str], complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["line", *words]) == 2

    told = capsys.readouterr().err
    assert complaint in told
    assert len(told.splitlines()) == 1


@pytest.mark.parametrize("fault", ["T1", "@3", "T0@3", "T1@-1", "Tx@3"])
def test_an_invalid_train_or_second_is_refused(
    fault: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(["run", "line", "--restart-train-at", fault])

    assert "--restart-train-at" in capsys.readouterr().err
