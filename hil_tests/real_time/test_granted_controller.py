"""External controllers as processes in virtual time: identical bytes, and never a hang."""

import os
import re
import shlex
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import pytest

from can_dbc.brake import BrakeCommand
from can_dbc.codec import Decoder
from firmware_py.settings import SettingsError
from metro_hil.external_controller import (
    ControllerDiedError,
    ControllerStartError,
    GrantedController,
    program_of,
)
from metro_hil.model.case import Case, ControllerSpec, Setup
from metro_hil.model.case_setup import parts_of
from metro_hil.model.end_condition import ARRIVED
from metro_hil.model.frame_hash import FrameHash
from metro_hil.replay import replay_run
from metro_hil.run.lockstep import Lockstep, Taps

ROOT: Final = Path(__file__).parents[2]
DOCUMENT: Final = ROOT / "docs" / "reference" / "lockstep_interface.md"
EXAMPLE: Final = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)

MISBEHAVED: Final = """\
import json, os, socket, sys, time
how, at_s = sys.argv[1], float(sys.argv[2])
if len(sys.argv) > 3:
    link = socket.socket(socket.AF_UNIX)
    link.connect(sys.argv[3])
    lines = link.makefile("rw")
else:
    lines = None
def say(text):
    (lines or sys.stdout).write(text + "\\n")
    (lines or sys.stdout).flush()
for line in lines or sys.stdin:
    heard = json.loads(line)
    if heard["type"] == "hello":
        if how == "wrong version":
            say('{"type": "ready", "version": 7, "next_wakeup_ns": 0}')
        elif how == "refuse":
            say('{"type": "refuse", "reason": "not on a Sunday"}')
        elif how == "no start":
            sys.exit("cannot load")
        else:
            say('{"type": "ready", "version": 1, "next_wakeup_ns": 0, "later": [1]}')
        continue
    answer = {
        "type": "yield", "now_ns": heard["now_ns"], "next_wakeup_ns": heard["now_ns"] + 50000000
    }
    if heard["now_ns"] >= at_s * 1e9:
        if how == "die":
            sys.exit("division by zero in the brake curve")
        if how == "kill":
            os.kill(os.getpid(), 9)
        if how == "hang":
            time.sleep(3600)
        if how == "garbage":
            say("brake!")
            continue
        if how == "long frame":
            answer["frames"] = [[257, "00" * 9]]
        if how == "identifier":
            answer["frames"] = [[4096, "00"]]
        if how == "hex":
            answer["serial"] = ["xy"]
        if how == "standing":
            answer["next_wakeup_ns"] = heard["now_ns"]
        if how == "late":
            answer["now_ns"] -= 50000000
        if how == "talkative":
            say(json.dumps(answer))
    say(json.dumps(answer))
"""


class Heard:
    """Records all frames of a bus."""

    def __init__(self) -> None:
        self.chain = FrameHash()
        self.frames: list[tuple[int, int, bytes]] = []

    def frame(self, stamp_ns: int, can_id: int, data: bytes) -> None:
        self.chain.frame(stamp_ns, can_id, data)
        self.frames.append((stamp_ns, can_id, data))


def bench_of(
    controller: ControllerSpec, heard: Heard, setup: Setup | None = None, seed: int = 4
) -> Lockstep:
    setup = setup or Setup(start="II", end="III")
    parts = parts_of(Case(id="x", index=0, scenario="x", seed=seed, setup=setup))
    taps = Taps(frame=heard.frame)
    return Lockstep(parts.config, parts.scenario, parts.journey, taps=taps, controller=controller)


def command(words: Sequence[str], lease_s: float = 20.0) -> ControllerSpec:
    return ControllerSpec(kind="command", command=shlex.join(words), lease_s=lease_s)


@pytest.fixture(scope="module")
def misbehaved(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    path = tmp_path_factory.mktemp("controller") / "misbehaved.py"
    path.write_text(MISBEHAVED)
    return [sys.executable, str(path)]


@pytest.mark.parametrize("cycle_ms", [50.0, 31.25, 110.0])
def test_the_shipped_controller_as_a_process_sends_identical_frames(cycle_ms: float) -> None:
    ours = ControllerSpec(kind="checkout", path=str(ROOT))
    setup = Setup(start="II", end="III", cycle_ms=cycle_ms)
    outcomes = []
    for controller in (ControllerSpec(), ours):
        heard = Heard()
        bench = bench_of(controller, heard, setup)
        reason = bench.run(100.0 if cycle_ms == 50.0 else 20.0)
        bench.close()
        outcomes.append((reason, bench.clock.now_ns(), heard.chain.links))

    assert outcomes[0] == outcomes[1]
    if cycle_ms == 50.0:
        assert outcomes[0][0] == ARRIVED


def test_the_documented_example_holds_the_train_and_its_messages_are_valid(tmp_path: Path) -> None:
    (example,) = EXAMPLE.findall(DOCUMENT.read_text(encoding="utf-8"))
    path = tmp_path / "example.py"
    path.write_text(example)
    heard = Heard()

    bench = bench_of(command([sys.executable, str(path)]), heard)
    bench.run(20.0)
    bench.close()

    decoder = Decoder([BrakeCommand])
    said = [decoder.decode(can_id, data, at_ns) for at_ns, can_id, data in heard.frames]
    brakes = [frame for frame in said if isinstance(frame, BrakeCommand)]
    assert len(brakes) == 20 * 20 + 1
    assert not any(brake.emergency_released or brake.holding_released for brake in brakes)
    assert not decoder.rejections
    assert bench.plant.world.front_m == pytest.approx(3000.0, abs=0.1)


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ("die", ["died at t=2.000 s", "exit code 1", "division by zero in the brake curve"]),
        ("kill", ["died at t=2.000 s", "SIGKILL"]),
        ("hang", ["hung at t=2.000 s", "no answer within 0.5 s"]),
        ("garbage", ["broke the protocol at t=2.000 s", "brake!"]),
        ("long frame", ["broke the protocol at t=2.000 s", "9 bytes"]),
        ("identifier", ["broke the protocol at t=2.000 s", "4096"]),
        ("hex", ["broke the protocol at t=2.000 s", "'xy'"]),
        ("standing", ["hung at t=2.000 s", "one instant"]),
        ("late", ["broke the protocol at t=2.000 s", "1.950 s"]),
        ("talkative", ["broke the protocol at t=2.0"]),
    ],
)
@pytest.mark.parametrize("socket", [False, True])
def test_a_failing_controller_is_named_and_the_train_goes_on_without_it(
    misbehaved: list[str], how: str, words: list[str], socket: bool
) -> None:
    heard = Heard()
    words_of = [*misbehaved, how, "2.0", *(["{grant}"] if socket else [])]
    bench = bench_of(command(words_of, lease_s=0.5 if how == "hang" else 20.0), heard)

    with pytest.raises(ControllerDiedError) as complaint:
        bench.run(10.0)
    bench.without_controller()
    bench.run_until(lambda now_ns: now_ns >= 5_000_000_000)
    bench.close()

    for word in words:
        assert word in str(complaint.value)
    assert heard.frames[-1][0] > 5_000_000_000
    assert isinstance(bench.vobc, GrantedController)
    with pytest.raises(ProcessLookupError):
        os.kill(bench.vobc.pid, 0)


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ("wrong version", ["version 7", "version 1"]),
        ("refuse", ["refuses", "not on a Sunday"]),
        ("no start", ["exit code 1", "cannot load"]),
    ],
)
def test_a_controller_that_does_not_start_blocks_the_case(
    misbehaved: list[str], how: str, words: list[str]
) -> None:
    with pytest.raises(ControllerStartError) as complaint:
        bench_of(command([*misbehaved, how, "0"]), Heard())

    assert isinstance(complaint.value, SettingsError)
    for word in words:
        assert word in str(complaint.value)


@pytest.mark.parametrize(
    ("controller", "words"),
    [
        (ControllerSpec(kind="checkout", path="/nowhere"), "/nowhere"),
        (ControllerSpec(kind="command", command=""), "empty"),
        (ControllerSpec(kind="command", command="'"), "quotation"),
        (ControllerSpec(kind="relay"), "relay"),
    ],
)
def test_a_program_that_is_no_controller_is_reported(
    controller: ControllerSpec, words: str
) -> None:
    with pytest.raises(ControllerStartError, match=words):
        program_of(controller)


def test_a_stopped_process_is_ended_with_its_bench(misbehaved: list[str]) -> None:
    bench = bench_of(command([*misbehaved, "well", "0"], lease_s=0.3), Heard())
    assert isinstance(bench.vobc, GrantedController)
    bench.run(1.0)
    os.kill(bench.vobc.pid, signal.SIGSTOP)

    with pytest.raises(ControllerDiedError, match="hung"):
        bench.run(1.0)

    with pytest.raises(ProcessLookupError):
        os.kill(bench.vobc.pid, 0)


def test_a_foreign_bench_of_another_version_is_refused() -> None:
    """The test sends the greeting of a future bench version."""
    done = subprocess.run(
        [sys.executable, "-m", "vobc", "grant"],
        input='{"type": "hello", "version": 2, "told": {}}\n',
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )

    assert '"refuse"' in done.stdout
    assert "version 2" in done.stdout
    assert "Traceback" not in done.stderr


def test_a_real_time_recording_is_reproduced(tmp_path: Path) -> None:
    """Controller and plant run as processes on the embedded bus, and then once more in virtual
    time."""
    out, runtime = tmp_path / "run", tmp_path / "rt"
    runtime.mkdir(mode=0o700)
    words = ["-m", "metro_hil.cli.vobc", "run", "--from", "II", "--to", "III"]
    done = subprocess.run(
        [sys.executable, *words, "--duration", "8", "--out", str(out)],
        env={**os.environ, "XDG_RUNTIME_DIR": str(runtime)},
        capture_output=True,
        text=True,
        timeout=90,
        check=False,
    )
    assert done.returncode == 0, done.stderr

    here = replay_run(out)
    there = replay_run(out, controller=ControllerSpec(kind="checkout", path=str(ROOT)))

    assert here.identical, here.first
    assert there.identical, there.first
    assert here.compared > 300
    assert sum(each.masked for each in here.counts) == 0
    assert here.heard_messages > 5
    assert not here.notes
