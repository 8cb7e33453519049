"""A recorded run is replayed to a controller: the same controller sends the same frames, another
one deviates."""

import json
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from firmware_py.handed_ports import HandedPorts
from firmware_py.settings import override
from firmware_py.storage.port_log import PORTS_LOG
from metro_hil.cli.hil import main
from metro_hil.model.case import Case, Setup
from metro_hil.model.case_setup import parts_of
from metro_hil.model.run_folder import RunFolder
from metro_hil.replay import read_recording, replay_run
from metro_hil.replay.recording import Output, RecordedStep
from metro_hil.run.lockstep import Lockstep

DURATION_S = 25.0
KILLED = {"kind": "controller_killed", "start_s": 8.0, "end_s": 9.0}
PAUSED = {"kind": "controller_paused", "start_s": 12.0, "end_s": 12.13}


def record(folder: Path, faults: Iterable[dict[str, object]] = ()) -> Path:
    setup = Setup(start="II", end="III")
    case = Case(id="x", index=0, scenario="x", seed=5, setup=setup, faults=tuple(faults))
    parts = parts_of(case)
    bench = Lockstep(
        parts.config, parts.scenario, parts.journey, RunFolder(folder), faults=parts.faults
    )
    bench.run(DURATION_S)
    bench.close()
    return folder


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("recorded"))


def test_a_lockstep_run_is_reproduced_exactly(recorded: Path) -> None:
    result = replay_run(recorded)

    said = (recorded / PORTS_LOG).read_text().count("\ntx ")
    assert result.identical
    assert result.compared == said > 3000
    assert result.cycles == DURATION_S * 20
    assert not result.notes


def test_a_killed_paused_and_restarted_controller_is_reproduced(
    tmp_path: Path,
) -> None:
    result = replay_run(record(tmp_path, [KILLED, PAUSED]))

    assert result.identical
    assert result.controllers == 2


def test_another_parameter_deviates_in_the_cycle_in_which_it_first_matters(recorded: Path) -> None:
    """The oracle runs both controllers and compares files to find the first differing cycle."""
    change = {"ato.limits.accel_mps2": 0.77}
    first_ns = None
    outputs = [
        [(step.begin_ns, output) for step in read_steps(recorded) for output in step.outputs],
        list(run_again(recorded, change)),
    ]
    for mine, theirs in zip(*outputs, strict=False):
        if mine != theirs:
            first_ns = min(mine[0], theirs[0])
            break
    assert first_ns is not None

    result = replay_run(recorded, believed=change, context=2)

    assert not result.identical
    assert result.first is not None
    assert result.first.cycle == first_ns // 50_000_000
    assert result.first.at_s == pytest.approx(first_ns / 1e9, abs=1e-9)
    assert result.first.name == "TRACTION_CMD"
    assert "force_n" in [signal.name for signal in result.first.signals]
    assert [each.cycle for each in result.first.inputs] == [
        result.first.cycle - 1,
        result.first.cycle,
    ]
    last = result.first.inputs[-1]
    assert any("TACHO" in heard.name for heard in last.heard)
    assert all(last.at_s - 0.05 < heard.at_s <= last.at_s for heard in last.heard)


def read_steps(folder: Path) -> list[RecordedStep]:
    (segment,) = read_recording(folder).segments
    return segment.steps


def run_again(folder: Path, change: dict[str, float]) -> Iterator[tuple[int, Output]]:
    """The outputs of the changed controller, step by step."""
    (segment,) = read_recording(folder).segments
    config = override(segment.commission.config, change, "here")
    ports = HandedPorts()
    device = replace(segment.commission, config=config).device(
        can=ports.can, tags=ports.tags, radio=ports.radio
    )
    for step in segment.steps:
        ports.hand(step.frames, step.chunks, step.messages)
        if step.task == "stop":
            device.stop(step.begin_ns)
        else:
            device.executive.run_due(step.begin_ns)
        said = ports.take()
        for can_id, data in said.frames:
            yield step.begin_ns, Output("can", f"{can_id:03X}", data)
        for key, payload in said.radio:
            yield step.begin_ns, Output("radio", key, payload)


def test_a_forged_frame_in_the_recording_is_detected(recorded: Path, tmp_path: Path) -> None:
    """The test replaces the brake command of one cycle; everything else is unchanged."""
    lines = (recorded / PORTS_LOG).read_text().splitlines(keepends=True)
    starts = [number for number, line in enumerate(lines) if line.startswith("run control ")]
    at = next(n for n in range(starts[300], len(lines)) if lines[n].startswith("tx can 101 "))
    lines[at] = "tx can 101 0000000000\n"
    (tmp_path / PORTS_LOG).write_text("".join(lines))

    result = replay_run(tmp_path)

    assert result.first is not None
    assert (result.first.cycle, result.first.key, result.first.kind) == (300, "101", "changed")
    assert result.first.recorded == "0000000000"
    assert sum(each.changed + each.missing + each.extra for each in result.counts) == 1


def test_the_command_prints_text_and_json(
    recorded: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    same = main(["replay", str(recorded)])
    told = capsys.readouterr().out
    other = main(["replay", str(recorded), "--believed", "ato.limits.jerk_mps3=0.5", "--json"])
    table = json.loads(capsys.readouterr().out)

    assert (same, other) == (0, 1)
    assert "identical" in told
    assert table["first"]["signals"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--believed", "ato.limits.axel_mps2=1"], "accel_mps2"),
        (["--believed", "nothing"], "KEY=VALUE"),
        (["--controller", "checkout:/nowhere"], "/nowhere"),
        (["--controller", "shiped"], "checkout:PATH"),
        (["--controller", "command:/no/such/program"], "/no/such/program"),
    ],
)
def test_a_user_error_gets_one_clear_message(
    recorded: Path, capsys: pytest.CaptureFixture[str], words: list[str], said: str
) -> None:
    code = main(["replay", str(recorded), *words])

    complaint = capsys.readouterr().err
    assert code == 2
    assert said in complaint
    assert len(complaint.splitlines()) == 1
