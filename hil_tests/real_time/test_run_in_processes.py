"""`vobc run` as its user meets it: processes on the embedded bus, Ctrl-C, kill -9, user errors."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import cantools
import pytest

from can_dbc.brake import BrakeCommand
from can_dbc.codec import Decoder, Rejected
from firmware_py.candump import read_candump
from hil_tests.disk_rig import small_disk
from metro_hil.cli.vobc import main

PATIENCE_S = 60.0
RUN = [sys.executable, "-m", "metro_hil.cli.vobc", "run"]
VCAN = [sys.executable, "-c", "from metro_tools.entry import vcan; vcan()"]
HOP = ["--from", "II", "--to", "III"]
DBC_FOLDER = Path(__file__).parents[2] / "can_dbc"


class Ended(NamedTuple):
    """A run that has ended, and what it left."""

    out: Path
    code: int
    stdout: str
    stderr: str


@contextmanager
def own_buses(folder: Path) -> Iterator[dict[str, str]]:
    """An environment with its own buses; buses that are still up are taken down at the end."""
    runtime = folder / "rt"
    runtime.mkdir(mode=0o700)
    environment = {**os.environ, "XDG_RUNTIME_DIR": str(runtime)}
    yield environment
    subprocess.run([*VCAN, "down"], env=environment, capture_output=True, check=False)


@pytest.fixture
def place(tmp_path: Path) -> Iterator[dict[str, str]]:
    with own_buses(tmp_path) as environment:
        yield environment


def run(
    place: dict[str, str], *arguments: str, timeout_s: float = PATIENCE_S
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*RUN, *arguments],
        env=place,
        capture_output=True,
        text=True,
        timeout=timeout_s,
        check=False,
    )


def start(place: dict[str, str], *arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [*RUN, *arguments],
        env=place,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def wait_for_cycles(folder: Path, rows: int) -> None:
    """Wait until the controller has logged this many cycles."""
    end = time.monotonic() + PATIENCE_S
    log = folder / "cycles.csv"
    while time.monotonic() < end:
        if log.exists() and log.read_bytes().count(b"\n") > rows:
            return
        time.sleep(0.1)
    raise AssertionError(f"no {rows} cycles within {PATIENCE_S:.0f} s")


def wait_for_motion(folder: Path) -> None:
    """Wait until the train is a metre away from its starting place."""
    end = time.monotonic() + PATIENCE_S
    log = folder / "truth.csv"
    while time.monotonic() < end:
        rows = log.read_text().splitlines()[1:-1] if log.exists() else []
        fronts_m = [float(row.split(",")[1]) for row in (*rows[:1], *rows[-1:])]
        if fronts_m and fronts_m[-1] > fronts_m[0] + 1.0:
            return
        time.sleep(0.2)
    raise AssertionError(f"the train did not move within {PATIENCE_S:.0f} s")


def processes_naming(text: str) -> list[int]:
    """Processes of this machine whose command line contains the text."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                words = (entry / "cmdline").read_bytes().decode(errors="replace")
            except OSError:
                continue
            if text in words and int(entry.name) != os.getpid():
                found.append(int(entry.name))
    return found


def command_line(pid: int) -> bytes:
    return (Path("/proc") / str(pid) / "cmdline").read_bytes()


@pytest.fixture(scope="module")
def interrupted(tmp_path_factory: pytest.TempPathFactory) -> tuple[Ended, Ended]:
    """A run that Ctrl-C ends once the train moves, and a second run on its bus."""
    folder = tmp_path_factory.mktemp("interrupted")
    with own_buses(folder) as place:
        first, second = folder / "first", folder / "second"
        subprocess.run([*VCAN, "up"], env=place, capture_output=True, check=True)
        going = start(place, *HOP, "--json", "--plot", "--out", str(first))
        wait_for_cycles(first, 20)
        other = run(place, *HOP, "--out", str(second))
        wait_for_motion(first)
        going.send_signal(signal.SIGINT)
        said, complained = going.communicate(timeout=PATIENCE_S)
        assert processes_naming(str(first)) == []
    return (
        Ended(first, going.returncode, said, complained),
        Ended(second, other.returncode, other.stdout, other.stderr),
    )


def test_controller_and_plant_run_as_two_processes_and_leave_a_complete_folder(
    interrupted: tuple[Ended, Ended],
) -> None:
    """After Ctrl-C the run still reports."""
    first, _ = interrupted

    assert first.code == 130, first.stderr
    assert "Traceback" not in first.stderr
    assert "starting the plant emulator" in first.stderr
    results = json.loads(first.stdout)
    assert results["exit_reason"] == "interrupted"
    assert results["real_time_factor"] is None
    assert results["rejected_frames"] == {}
    assert results["ride"]["distance_m"] > 1.0
    names = {path.name for path in first.out.iterdir()}
    assert names >= {"run.toml", "bus.log", "serial.log", "cycles.csv", "truth.csv", "run.png"}


def test_the_last_frames_of_the_controller_apply_the_brake(
    interrupted: tuple[Ended, Ended],
) -> None:
    first, _ = interrupted
    decoder, heard = Decoder([BrakeCommand]), []
    for logged in read_candump(first.out / "bus.log"):
        frame = decoder.decode(logged.frame.can_id, logged.frame.data, logged.frame.stamp_ns)
        if isinstance(frame, BrakeCommand):
            heard.append(frame)
        assert not isinstance(frame, Rejected)

    assert len(heard) > 40
    assert any(frame.holding_released for frame in heard)
    assert not heard[-1].emergency_released
    assert not heard[-1].holding_released


def test_a_second_controller_on_the_bus_is_refused(interrupted: tuple[Ended, Ended]) -> None:
    _, second = interrupted

    assert second.code == 3
    assert "another VOBC" in second.stderr
    assert not second.out.exists()


def test_a_run_ends_when_its_duration_is_over_and_cantools_reads_its_log(
    place: dict[str, str], tmp_path: Path
) -> None:
    out = tmp_path / "run"
    done = run(place, *HOP, "--duration", "4", "--json", "--out", str(out))
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["exit_reason"] == "duration over"
    database = cantools.database.Database(strict=True)
    for path in sorted(DBC_FOLDER.glob("*.dbc")):
        database.add_dbc_file(str(path))
    senders = set()

    log = read_candump(out / "bus.log")
    for logged in log:
        message = database.get_message_by_frame_id(logged.frame.can_id)
        message.decode(logged.frame.data)
        senders |= set(message.senders)

    assert log.bad_lines == 0
    assert senders >= {"VOBC", "BCU", "TCU", "DCU", "ODO", "BTM", "DESK", "HVB", "TCMS"}


def test_a_killed_run_keeps_its_log_and_ends_its_children(
    place: dict[str, str], tmp_path: Path
) -> None:
    """The log holds what was on the bus more than a second before the kill."""
    out = tmp_path / "run"
    going = start(place, *HOP, "--out", str(out))
    wait_for_cycles(out, 60)
    killed_ns = time.time_ns()

    going.kill()
    going.communicate(timeout=PATIENCE_S)

    stamps_ns = [logged.frame.stamp_ns for logged in read_candump(out / "bus.log")]
    # The log is written every second; half a second more allows for a busy machine.
    assert killed_ns - stamps_ns[-1] < 1.5e9
    end = time.monotonic() + PATIENCE_S
    while processes_naming(str(out)) and time.monotonic() < end:
        time.sleep(0.1)
    assert processes_naming(str(out)) == []


def test_a_hanging_controller_gives_a_verdict_and_the_train_brakes(
    place: dict[str, str], tmp_path: Path
) -> None:
    """The stopped controller sends nothing while its process still exists; the bench must detect
    this."""
    out = tmp_path / "run"
    going = start(place, *HOP, "--json", "--out", str(out))
    wait_for_cycles(out, 80)
    (controller,) = (
        pid for pid in processes_naming(str(out)) if b"\0vobc\0--bus" in command_line(pid)
    )

    os.kill(controller, signal.SIGSTOP)
    said, complained = going.communicate(timeout=PATIENCE_S)

    assert going.returncode == 1, complained
    assert "controller" in json.loads(said)["exit_reason"]
    assert "silent" in json.loads(said)["exit_reason"]
    head, *rows = (out / "truth.csv").read_text().splitlines()
    last = dict(zip(head.split(","), rows[-1].split(","), strict=True))
    assert last["emergency"] == "1"
    assert processes_naming(str(out)) == []


def test_without_a_plant_it_stays_braked_and_lists_missing_inputs(
    place: dict[str, str], tmp_path: Path
) -> None:
    out = tmp_path / "run"

    done = run(place, "--plant", "none", "--duration", "5", "--out", str(out))

    assert done.returncode == 0, done.stderr
    assert "waits for" in done.stdout
    for word in ("brake", "traction", "odometer", "door", "desk", "movement authority"):
        assert word in done.stdout
    decoder, brakes = Decoder([BrakeCommand]), 0
    for logged in read_candump(out / "bus.log"):
        frame = decoder.decode(logged.frame.can_id, logged.frame.data, logged.frame.stamp_ns)
        if isinstance(frame, BrakeCommand):
            brakes += 1
            assert not frame.emergency_released
            assert not frame.holding_released
    assert brakes > 20


def test_a_full_disk_does_not_stop_the_train(place: dict[str, str], tmp_path: Path) -> None:
    """No file grows beyond 60 kB, which the bus log reaches in some seconds."""
    out = tmp_path / "run"

    with small_disk(60_000):
        done = run(place, *HOP, "--duration", "9", "--json", "--out", str(out))

    results = json.loads(done.stdout)
    assert done.returncode == 3, done.stderr
    assert results["exit_reason"] == "duration over"
    assert results["lost_log_lines"] > 0
    assert results["frames"] > (out / "bus.log").read_bytes().count(b"\n") > 0
    assert json.loads((out / "results.json").read_text()) == results
    noted = json.loads((out / "vobc.json").read_text())["lost_log_lines"]
    assert 0 < noted < results["lost_log_lines"]
    assert done.stderr.splitlines()[-1] == (
        f"vobc: {out}: the disk did not take {results['lost_log_lines']} lines of the logs"
    )


def test_a_train_runs_on_when_the_reader_of_its_output_is_gone(
    place: dict[str, str], tmp_path: Path
) -> None:
    out = tmp_path / "run"
    going = start(place, *HOP, "--duration", "3", "--out", str(out))
    assert going.stdout is not None
    assert going.stderr is not None
    going.stdout.close()

    complained = going.stderr.read()

    assert going.wait(PATIENCE_S) == 3
    assert complained.splitlines()[-1] == (
        "vobc: standard output: Broken pipe; the rest of the output is lost"
    )
    assert json.loads((out / "results.json").read_text())["exit_reason"] == "duration over"


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (["--line", "florenz"], 2, ["florenz", "florence"]),
        (["--consist", "florence5"], 2, ["florence5", "florence4"]),
        (["--params", "nothing"], 2, ["nothing", "florence4"]),
        (["--from", "III", "--to", "II"], 2, ["--to II", "III"]),
        (["--from", "V"], 2, ["--from V", "IV"]),
        (["--cycle-ms", "500"], 2, ["--cycle-ms", "500"]),
        (["--cycle-ms", "nan"], 2, ["--cycle-ms", "nan"]),
        (["--load-ratio", "2"], 2, ["--load-ratio", "2"]),
        (["--bus", "sokcetcan:vcan0"], 3, ["sokcetcan", "socketcan"]),
        (["--bus", "socketcan:nocan7"], 3, ["nocan7"]),
        (["--bus", "embedded:nobody"], 3, ["nobody"]),
        (["--radio", "nonsense"], 3, ["nonsense"]),
    ],
)
def test_a_user_error_gets_one_clear_message(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    status: int,
    words: list[str],
) -> None:
    """`test_project_ends.py` holds that no error of a program ends in a traceback."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))

    with pytest.raises(SystemExit) as ending:
        sys.exit(main(["run", *arguments, "--duration", "3", "--out", str(tmp_path / "run")]))

    said = capsys.readouterr().err
    assert ending.value.code == status, said
    for word in words:
        assert word in said
    assert not (tmp_path / "run" / "cycles.csv").exists(), "no controller was started"


def test_a_folder_with_content_is_never_overwritten(place: dict[str, str], tmp_path: Path) -> None:
    (tmp_path / "precious").write_text("kept")

    done = run(place, "--lockstep", "--out", str(tmp_path))

    assert done.returncode == 2
    assert str(tmp_path) in done.stderr
    assert (tmp_path / "precious").read_text() == "kept"
