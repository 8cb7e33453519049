"""The command `plant`: its refusals, and a plant as its own process on the embedded bus."""

import contextlib
import csv
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from firmware_py import rendezvous
from firmware_py.buses import BusChoice
from firmware_py.buses.embedded import start_hub
from firmware_py.clock.clock import WallClock
from firmware_py.settings import shipped_names
from plant_emulator.cli import main
from plant_emulator.faults.feed import FaultChange, TruthSample, read_message
from plant_emulator.process import TRUTH_COLUMNS
from plant_emulator.train_config import PACKAGE

BUS = "planttest0"
SPEC = f"embedded:{BUS}"
WAIT_S = 60.0
"""Timeout far above every duration here; only a hang reaches it, s."""


@pytest.fixture(autouse=True)
def bench_of_its_own(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    with tempfile.TemporaryDirectory() as folder:
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        yield


@pytest.fixture
def hub() -> Iterator[None]:
    handle = start_hub(BUS, bound=True)
    yield
    handle.stop()


def start(*arguments: str | Path) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        [sys.executable, "-m", "plant_emulator", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def serving(*arguments: str | Path) -> "subprocess.Popen[str]":
    """A plant process that has reported that all its ports are open."""
    plant = start("run", "--bus", SPEC, "--radio", "auto", "--priority", "0", *arguments)
    assert plant.stdout is not None
    for line in plant.stdout:
        if "wayside:" in line:
            return plant
    raise AssertionError(f"the plant ended at its start: {plant.communicate()}")


def test_the_shipped_trains_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["consists"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == shipped_names(PACKAGE)
    lengths = {line.split()[0]: line for line in lines}
    assert "4 cars, 68.59 m" in lengths["florence4"]
    assert "6 cars" in lengths["hefei6"]


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["--consist", "florence5"], 2, "florence5: nearest valid shipped name: florence4"),
        (["--line", "nowhere.toml"], 2, "nowhere.toml: no such file"),
        (["--from", "V"], 2, "--from V: line florence has no station V"),
        (["--from", "III", "--to", "I"], 2, "--to I: lies at 1500 m, not beyond III"),
        (["--bus", "embedded:nobody0"], 3, "nobody0"),
        (["--bus", "smokesignal:a"], 3, "unknown kind"),
        (["--faults", "nowhere.toml"], 2, "nowhere.toml: no such file"),
        (["--by-hand", "faults"], 2, "--by-hand: needs --out"),
        (["--by-hand", "desk", "--out", "x", "--driver", "late"], 2, "another operates the desk"),
        (["--by-hand", "desk", "--out", "x", "--desk", "none"], 2, "another operates the desk"),
        (["--bus", SPEC, "--truth-feed", 200 * "x"], 2, "--truth-feed x"),
    ],
)
def test_an_impossible_plant_is_refused_in_one_line(
    arguments: list[str], code: int, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", *arguments]) == code
    said = capsys.readouterr().err
    assert words in said
    assert said.startswith("plant: ")
    assert said.count("\n") == 1


def test_without_any_bus_the_message_tells_how_to_create_one(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    nothing = BusChoice(None, "the kernel has no interface vcan0")
    monkeypatch.setattr("plant_emulator.cli.bus_choice.resolve_auto", lambda: nothing)
    assert main(["run"]) == 3
    said = capsys.readouterr().err
    assert said == "plant: no bus: the kernel has no interface vcan0; `vcan up` makes one\n"


@pytest.mark.parametrize(
    "arguments",
    [
        ["--load-ratio", "1.1"],
        ["--load-ratio", "nan"],
        ["--odometer-error", "half"],
        ["--seed", "-1"],
        ["--duration", "-3"],
        ["--desk", "asleep"],
        ["--priority", "100"],
        ["--by-hand", "hands"],
    ],
)
def test_wrong_usage_is_refused_before_anything_is_opened(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["run", *arguments])
    assert ended.value.code == 2
    assert arguments[0] in capsys.readouterr().err


@pytest.mark.usefixtures("hub")
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 0)])
def test_a_signal_ends_it_cleanly_with_its_logs_closed(
    tmp_path: Path, number: signal.Signals, code: int
) -> None:
    plant = serving("--out", tmp_path)
    tags = rendezvous.tags_link(BUS).readlink()
    assert tags.exists()
    assert rendezvous.read_radio(BUS)

    plant.send_signal(number)
    _, errors = plant.communicate(timeout=WAIT_S)

    assert plant.returncode == code
    assert errors == ""
    with (tmp_path / "truth.csv").open(newline="", encoding="utf-8") as lines:
        rows = list(csv.reader(lines))
    assert tuple(rows[0]) == TRUTH_COLUMNS
    assert {len(row) for row in rows} == {len(TRUTH_COLUMNS)}
    summary = json.loads((tmp_path / "plant.json").read_text(encoding="utf-8"))
    assert summary["command_losses"] == {"BCU": 0, "TCU": 0, "DCU": 0}
    assert not rendezvous.tags_link(BUS).is_symlink()
    assert rendezvous.read_radio(BUS) is None


@pytest.mark.usefixtures("hub")
def test_it_ends_after_its_duration() -> None:
    plant = serving("--duration", "0.3", "--from", "II", "--to", "III")
    said, errors = plant.communicate(timeout=WAIT_S)
    assert plant.returncode == 0
    assert errors == ""
    assert "ended" in said


def test_impossible_faults_are_reported_with_file_and_key(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario = tmp_path / "leaves.toml"
    scenario.write_text('[[fault]]\nkind = "wheel_slid"\n', encoding="utf-8")
    assert main(["run", "--faults", str(scenario)]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"plant: {scenario}: fault[0].kind: 'wheel_slid'")
    assert "wheel_slide" in said
    assert said.count("\n") == 1


@pytest.mark.usefixtures("hub")
def test_the_feed_gets_the_truth_of_every_step_and_all_faults(tmp_path: Path) -> None:
    """The feed uses instants of the machine's clock; the plant only reports faults of the bus.

    A listener that reads too late loses samples, and the plant counts them.
    """
    scenario, path = tmp_path / "faults.toml", tmp_path / "feed"
    scenario.write_text(
        '[[fault]]\nkind = "passenger_alarm"\nstart_s = 0.2\nduration_s = 0.1\n'
        '[[fault]]\nkind = "frame_drop"\nwhen = "t_s > 0.1"\n'
        '[[fault]]\nkind = "wheel_slip"\nwhen = "speed_mps > 5"\n',
        encoding="utf-8",
    )
    out, heard = tmp_path / "out", []
    before_ns = WallClock().now_ns()
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(path))
        listener.settimeout(0.1)
        plant = serving(
            *("--faults", scenario, "--truth-feed", path, "--out", out, "--duration", "0.5")
        )
        ended = False
        while not ended:
            ended = plant.poll() is not None
            with contextlib.suppress(TimeoutError):
                while True:
                    heard.append(read_message(listener.recv(4096)))
        said, errors = plant.communicate(timeout=WAIT_S)
    samples = [each for each in heard if isinstance(each, TruthSample)]
    changes = [(each.index, each.active) for each in heard if isinstance(each, FaultChange)]
    steps_s = [round(each.truth.t_s, 6) for each in samples]
    summary = json.loads((out / "plant.json").read_text(encoding="utf-8"))

    assert errors == ""
    assert len(heard) == summary["feed_sent"]
    assert steps_s == sorted(set(steps_s))
    assert round(100 * steps_s[-1]) + 1 - len(steps_s) <= summary["feed_lost"]
    assert [each.now_ns - 10_000_000 * round(100 * each.truth.t_s) for each in samples] == [
        samples[0].now_ns
    ] * len(samples)
    assert before_ns < samples[0].now_ns < WallClock().now_ns()
    assert changes == [(1, True), (0, True), (0, False)]
    assert "fault 0, passenger_alarm, begins" in said
    assert summary["faults_never_began"] == ["2 wheel_slip"]


@pytest.mark.usefixtures("hub")
def test_the_plant_names_faults_that_it_does_not_cause(tmp_path: Path) -> None:
    scenario = tmp_path / "faults.toml"
    scenario.write_text('[[fault]]\nkind = "frame_drop"\n', encoding="utf-8")
    plant = start(
        *("run", "--bus", SPEC, "--priority", "0", "--duration", "0.1", "--faults", scenario)
    )
    said, errors = plant.communicate(timeout=WAIT_S)

    assert (plant.returncode, errors) == (0, "")
    assert "fault 0, frame_drop: not applied by the plant; no component applies it" in said


@pytest.mark.usefixtures("hub")
def test_a_second_plant_on_one_bus_is_refused() -> None:
    first = serving()
    try:
        second = start("run", "--bus", SPEC, "--priority", "0")
        _, errors = second.communicate(timeout=WAIT_S)
    finally:
        first.terminate()
        first.communicate(timeout=WAIT_S)
    assert second.returncode == 3
    assert "a train is already on this bus; received" in errors
    assert "Traceback" not in errors


@pytest.mark.usefixtures("hub")
def test_a_radio_endpoint_in_use_is_refused() -> None:
    first = serving()
    endpoint = rendezvous.read_radio(BUS)
    assert endpoint is not None
    other = start_hub("planttest1", bound=True)
    try:
        second = start("run", "--bus", "embedded:planttest1", "--radio", endpoint)
        _, errors = second.communicate(timeout=WAIT_S)
    finally:
        first.terminate()
        first.communicate(timeout=WAIT_S)
        other.stop()
    assert second.returncode == 3
    assert "in use" in errors
    assert "Traceback" not in errors


@pytest.mark.usefixtures("hub")
def test_the_plant_does_not_outlive_its_given_parent() -> None:
    """A killed parent sends nothing; the kernel signals the child."""
    command = [sys.executable, "-m", "plant_emulator", "run", "--bus", SPEC, "--priority", "0"]
    parent = subprocess.Popen(
        [
            sys.executable,
            "-c",
            "import os, subprocess, sys;"
            "subprocess.Popen([*sys.argv[1:], '--parent', str(os.getpid())]).wait()",
            *command,
        ],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert parent.stdout is not None
    for line in parent.stdout:
        if "wayside:" in line:
            break

    os.kill(parent.pid, signal.SIGKILL)
    parent.wait(WAIT_S)

    # The pipe closes when the plant has gone, too; its last lines are those of a clean end.
    assert "ended" in parent.stdout.read()
