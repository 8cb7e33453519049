"""Whole cases replayed to their controller: faults, restarts, branches, and a forged input."""

import re
from pathlib import Path
from typing import Any

import pytest

from firmware_py.handed_ports import HandedPorts
from firmware_py.storage.port_log import PORTS_LOG
from metro_hil.campaign.builder import Scenario
from metro_hil.cli.hil import main
from metro_hil.model.case import CaseResult
from metro_hil.model.run_folder import RunFolder
from metro_hil.replay import read_recording, replay_run
from metro_hil.run.dispatch import run_case

HOP = {"start": "II", "end": "III", "duration_s": 30.0}

BUS = [
    {"kind": "frame_drop", "loss_ratio": 0.05, "start_s": 8.0, "end_s": 20.0},
    {"kind": "frame_corrupt", "damage": "on_wire", "share_ratio": 0.1, "start_s": 9.0},
    {"kind": "masquerade", "frame": "BRAKE_CMD", "start_s": 12.0, "end_s": 13.0},
    {"kind": "bus_off", "node": "vobc", "start_s": 15.0, "end_s": 16.0},
]
PROCESS = [
    {"kind": "controller_killed", "start_s": 8.0, "end_s": 9.0},
    {"kind": "controller_killed", "start_s": 14.0, "end_s": 15.5},
    {"kind": "controller_paused", "start_s": 11.0, "end_s": 11.13},
    {"kind": "slow_cycle", "extra_s": 0.0301, "start_s": 18.0, "end_s": 20.0},
    {"kind": "clock_step", "step_s": 0.15, "start_s": 22.0},
]


def recorded(folder: Path, **keys: Any) -> CaseResult:
    (case,) = Scenario(name="hop", train=HOP, **keys).cases()
    result = run_case(case, folder=RunFolder(folder))
    assert result.chain, result.reason
    return result


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("plain")
    recorded(folder)
    return folder


@pytest.mark.parametrize(
    ("keys", "controllers"),
    [
        ({"fault": BUS}, 1),
        ({"fault": PROCESS}, 3),
        ({"fault": [*BUS, *PROCESS], "invariants": "none"}, 3),
        ({"fault": BUS, "branch": {"seed": 9, "when": "t_s >= 6"}, "seed_base": 4}, 1),
        ({"train": {**HOP, "cycle_ms": 31.25}, "fault": PROCESS}, 3),
        ({"fault": [{"kind": "controller_killed", "start_s": 12.0}]}, 1),
    ],
    ids=("bus", "process", "both", "branch", "odd cycle", "killed for good"),
)
def test_a_case_is_reproduced_exactly(
    tmp_path: Path, keys: dict[str, Any], controllers: int
) -> None:
    (case,) = Scenario(**{"name": "hop", "train": HOP, "stop_at_violation": False, **keys}).cases()
    result = run_case(case, folder=RunFolder(tmp_path))
    assert not [event for event in result.events if "never" in event.what]

    again = replay_run(tmp_path)

    assert again.identical, again.first
    assert again.controllers == controllers
    assert again.compared == (tmp_path / PORTS_LOG).read_text().count("\ntx ") > 1000
    assert not again.notes


def forged(folder: Path, into: Path, wanted: str, first_cycle: int) -> int:
    """Change a digit of the first fitting line after a cycle; return the cycle that receives it."""
    lines = (folder / PORTS_LOG).read_text().splitlines(keepends=True)
    cycles = [number for number, line in enumerate(lines) if line.startswith("run control ")]
    after = range(cycles[first_cycle], len(lines))
    at = next(number for number in after if re.match(wanted, lines[number]))
    line = lines[at]
    # The digit belongs to the last bytes, so it is part of neither the stamp nor a start byte.
    lines[at] = f"{line[:-4]}{'1' if line[-4] == '0' else '0'}{line[-3:]}"
    (into / PORTS_LOG).write_text("".join(lines))
    return sum(number < at for number in cycles) - 1


def first_other_cycle(folder: Path) -> int | None:
    """The oracle feeds the inputs to a controller and compares each step's output with the
    recorded one."""
    (segment,) = read_recording(folder).segments
    ports = HandedPorts()
    device = segment.commission.device(can=ports.can, tags=ports.tags, radio=ports.radio)
    cycle = -1
    for step in segment.steps:
        if step.task == "stop":
            break
        cycle += step.task == "control"
        ports.hand(step.frames, step.chunks, step.messages)
        device.executive.run_next(step.begin_ns)
        said = ports.take()
        frames = [(f"{can_id:03X}", data) for can_id, data in said.frames]
        radio = [(key, payload) for key, payload in said.radio]
        if [*frames, *radio] != [(output.key, output.data) for output in step.outputs]:
            return cycle
    return None


@pytest.mark.parametrize(
    ("wanted", "first_cycle"),
    [
        (r"rx can \d+ 185 ", 300),
        (r"rx can \d+ 183 ", 400),
        (r"rx tags \d+ 7E0101", 200),
    ],
    ids=("odometer", "traction", "tag"),
)
def test_one_forged_digit_of_an_input_is_detected_in_its_cycle(
    plain: Path, tmp_path: Path, wanted: str, first_cycle: int
) -> None:
    heard = forged(plain, tmp_path, wanted, first_cycle)
    oracle = first_other_cycle(tmp_path)

    result = replay_run(tmp_path)

    assert oracle is not None
    assert result.first is not None
    assert result.first.cycle == oracle
    assert heard <= oracle <= heard + 2


def test_another_parameter_ends_with_exit_code_1(
    plain: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    same = main(["replay", str(plain)])
    other = main(["replay", str(plain), "--believed", "atp.authority_age_max_s=0.5"])

    told = capsys.readouterr().out
    assert (same, other) == (0, 1)
    assert "identical" in told
    assert "first in cycle" in told
