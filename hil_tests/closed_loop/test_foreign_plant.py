"""A train in another program, in virtual time: same physics, same bytes, and never a hang."""

import json
import shlex
import sys
from contextlib import closing
from pathlib import Path
from typing import Final

import pytest

from firmware_py.ports import CanFrame, LinkCounters
from metro_hil.external_controller import ControllerProgram
from metro_hil.foreign_plant.plant import ForeignPlant
from metro_hil.model.case import Case, CaseResult, PlantSpec, Setup, Verdict
from metro_hil.run.case import run_alone

ROOT: Final = Path(__file__).parents[2]
EXAMPLE: Final = ROOT / "docs" / "examples" / "plant" / "point_mass.py"
NOMINAL: Final = {"low": 0.0, "high": 0.0}
BODY: Final = {"model": "point_mass", "resistance.error_ratio": NOMINAL}
"""A train as one body with the running resistance of its file."""
SAME: Final = """\
import json, sys
from firmware_py.settings import build
from firmware_py.trackdb import LineMap
from plant_emulator.consist import Consist
from plant_emulator.train_config import TrainConfig
def answer(kind, **members):
    print(json.dumps({"type": kind, **members}), flush=True)
for line in sys.stdin:
    message = json.loads(line)
    if message["type"] == "hello":
        told = message["told"]
        train = build(TrainConfig, told["consist"], "hello", "consist")
        track = build(LineMap, told["line"], "hello", "line")
        body = Consist(train, track, front_m=told["front_m"], step_s=told["step_ns"] / 1e9)
        answer("ready", version=1, provides=["motion"])
        continue
    truth = {}
    if message["type"] == "grant":
        forces = message["inputs"]
        body.load(forces["drive_n"], forces["motor_brake_n"], forces["trailer_brake_n"])
        body.step()
        truth = dict(front_m=body.front_m, speed_mps=body.speed_mps, accel_mps2=body.accel_mps2)
    answer("yield", now_ns=message["now_ns"], truth=truth)
"""
"""The bench's own motion as a program of its own."""
MISBEHAVED: Final = """\
import json, sys, time
how = sys.argv[1]
for line in sys.stdin:
    message = json.loads(line)
    if message["type"] == "hello":
        front_m = message["told"]["front_m"]
        if how == "controller":
            answer = {"type": "ready", "version": 1, "next_wakeup_ns": 0}
        elif how == "refuse":
            answer = {"type": "refuse", "reason": "no licence"}
        else:
            answer = {"type": "ready", "version": 1, "provides": ["motion"]}
    else:
        truth = {"front_m": front_m, "speed_mps": 0.0, "accel_mps2": 0.0}
        answer = {"type": "yield", "now_ns": message["now_ns"], "truth": truth}
        if message["now_ns"] >= 100_000_000:
            if how == "die":
                sys.exit("out of tyres")
            if how == "hang":
                time.sleep(3600)
            if how == "jump":
                truth["front_m"] += 1.0
            if how == "late":
                answer["now_ns"] -= 10_000_000
    print(json.dumps(answer), flush=True)
"""

STILL: Final = """\
import json, sys
with open(sys.argv[1], "w") as heard:
    for line in sys.stdin:
        heard.write(line)
        message = json.loads(line)
        answer = {"type": "ready", "version": 1, "provides": ["motion"]}
        if message["type"] != "hello":
            truth = {"front_m": 3000.0, "speed_mps": 0.0, "accel_mps2": 0.0}
            answer = {"type": "yield", "now_ns": message["now_ns"], "truth": truth}
        print(json.dumps(answer), flush=True)
"""
"""A train that stands, and writes down what it receives."""


class Given:
    """Hands over frames that ended at given instants."""

    def __init__(self, stamps_ns: list[int]) -> None:
        self._stamps_ns = stamps_ns
        self.counters = LinkCounters()

    def send(self, now_ns: int, can_id: int, data: bytes) -> None:
        raise AssertionError("a foreign plant only receives here")

    def close(self) -> None: ...

    def receive(self, now_ns: int) -> list[CanFrame]:
        taken, self._stamps_ns = self._stamps_ns, []
        return [CanFrame(stamp_ns, 0x101, b"\x01") for stamp_ns in taken]


def ride(plant: PlantSpec, duration_s: float = 8.0) -> CaseResult:
    setup = Setup(start="II", end="III", duration_s=duration_s, real=BODY)
    return run_alone(Case(id="x", index=0, scenario="x", seed=4, setup=setup, plant=plant))


def plant_of(path: Path, *words: str, lease_s: float = 20.0) -> PlantSpec:
    command = shlex.join([sys.executable, str(path), *words])
    return PlantSpec(kind="command", command=command, lease_s=lease_s)


def test_the_benchs_own_motion_in_another_program_gives_the_same_frames(tmp_path: Path) -> None:
    path = tmp_path / "same.py"
    path.write_text(SAME)

    own, other = ride(PlantSpec()), ride(plant_of(path))

    assert own.frames > 1500
    assert (other.chain, other.sim_s) == (own.chain, own.sim_s)
    assert {each.name: each.margin for each in other.monitors} == {
        each.name: each.margin for each in own.monitors
    }


def test_the_documented_plant_is_judged_and_gives_the_same_bytes_each_time() -> None:
    first, second = (ride(plant_of(EXAMPLE)) for _ in range(2))

    assert first.chain == second.chain
    judged = {each.name: each.verdict for each in first.monitors}
    assert judged["inv-04-civil-limit"] is Verdict.PASS
    assert (first.measures["speed_max_mps"] or 0.0) > 0.5


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ("die", ["plant died at t=0.100 s", "exit code 1", "out of tyres"]),
        ("hang", ["plant hung at t=0.100 s", "no answer within 0.2 s"]),
        ("jump", ["plant broke the protocol at t=0.100 s", "truth.front_m", "check their units"]),
        ("late", ["plant broke the protocol at t=0.100 s", "0.090 s"]),
        ("controller", ["plant: at its start it broke the protocol", "provides"]),
        ("refuse", ["plant: refuses: no licence"]),
    ],
)
def test_a_failing_plant_blocks_the_case_and_says_why(
    tmp_path: Path, how: str, words: list[str]
) -> None:
    path = tmp_path / "misbehaved.py"
    path.write_text(MISBEHAVED)

    result = ride(plant_of(path, how, lease_s=0.2 if how == "hang" else 20.0), 1.0)

    assert result.verdict is Verdict.BLOCKED
    for word in words:
        assert word in result.reason


def test_a_program_that_cannot_be_started_blocks_the_case() -> None:
    result = ride(PlantSpec(kind="command", command="/nowhere/train"), 1.0)

    assert result.verdict is Verdict.BLOCKED
    assert result.reason.startswith("plant: /nowhere/train: cannot be started")


def test_the_program_counts_its_own_steps_when_the_plant_is_late(tmp_path: Path) -> None:
    """In real time the plant's clock begins anywhere, and gives up steps after a long delay."""
    script, heard = tmp_path / "still.py", tmp_path / "heard"
    script.write_text(STILL)
    begin_ns = 7_000_000_003
    told = {"start_ns": 0, "front_m": 3000.0}
    program = ControllerProgram((sys.executable, str(script), str(heard)), {})
    port = Given([begin_ns + 4_000_000, begin_ns + 13_000_000])

    with closing(ForeignPlant(program, told, port=port, lease_s=20.0)) as plant:
        for late_ns in (0, 30_000_000, 5_000_000_000):
            plant.step(begin_ns + 10_000_000 + late_ns, {})
        plant.stop()

    messages = [json.loads(line) for line in heard.read_text().splitlines()]
    assert [each["now_ns"] // 1_000_000 for each in messages[1:]] == [10, 20, 30, 30]
    # The second frame ended after the step that received it.
    assert messages[1]["frames"] == [[4_000_000, 0x101, "01"], [10_000_000, 0x101, "01"]]
