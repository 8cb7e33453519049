"""A case in real time: its own bus, gateway, faults, deaths of processes, and missing parts."""

import itertools
import json
import sys
from pathlib import Path

import pytest

from can_dbc.binding import can_id
from can_dbc.brake import BrakeCommand
from firmware_py.candump import read_candump
from metro_hil.model.case import BenchKind, Case, CaseResult, ControllerSpec, Setup, Verdict
from metro_hil.model.log_columns import read_columns
from metro_hil.model.run_folder import RunFolder
from metro_hil.realtime import RealtimeWires, run_realtime_case

BRAKE_ID = can_id(BrakeCommand)
SHIPPED = (
    f"{sys.executable} -m vobc --bus {{bus}} --tags {{tags}} --radio {{radio}} --line {{line}} "
    "--consist {params} --from {start} --to {end} --out {out}"
)
HOST_MAY_DISTURB = (Verdict.PASS, Verdict.INVALID, Verdict.INCONCLUSIVE)
"""Possible verdicts of a correct case on a busy machine."""


def case_of(**changes: object) -> Case:
    given: dict[str, object] = {
        "id": "one",
        "index": 0,
        "scenario": "hop",
        "seed": 1,
        "bench": BenchKind.PROCESSES,
        "invariants": "none",
        "setup": Setup(start="II", end="III", duration_s=9.0),
        **changes,
    }
    return Case(**given)  # type: ignore[arg-type]


def run(case: Case, out: Path, wires: RealtimeWires | None = None) -> CaseResult:
    out.mkdir()
    result = run_realtime_case(case, folder=RunFolder(out), wires=wires)
    assert processes_naming(str(out)) == [], "nothing that was started is left"
    return result


def processes_naming(text: str) -> list[str]:
    """Command lines of living processes that contain the text."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                words = (entry / "cmdline").read_bytes().decode(errors="replace")
            except OSError:
                continue
            if text in words:
                found.append(words)
    return found


def brake_times_s(log: Path) -> list[float]:
    return [
        logged.frame.stamp_ns / 1e9
        for logged in read_candump(log)
        if logged.frame.can_id == BRAKE_ID
    ]


def longest_gap_s(times_s: list[float]) -> float:
    return max(after - before for before, after in itertools.pairwise(times_s))


def test_faults_of_bus_sensor_and_process_act_in_real_time_in_a_complete_run(
    tmp_path: Path,
) -> None:
    """Brake commands are dropped for 0.5 s: the controller's bus segment carries them, the
    train's does not."""
    faults = (
        {"kind": "frame_drop", "frames": "BRAKE_CMD*", "start_s": 4.0, "duration_s": 0.5},
        {"kind": "doppler_outage", "start_s": 2.0, "duration_s": 1.0},
        {"kind": "controller_paused", "start_s": 6.0, "duration_s": 0.5},
    )
    out = tmp_path / "run"

    result = run(case_of(faults=faults), out)

    assert result.verdict in HOST_MAY_DISTURB, result.reason
    assert result.exit_reason == "duration over"
    told = [event.what for event in result.events]
    for kind in ("frame_drop", "doppler_outage", "controller_paused"):
        assert told.index(f"fault {kind} begins") < told.index(f"fault {kind} ends")
    struck = json.loads((out / "gateway.json").read_text())["struck"]
    assert set(struck) == {"frame_drop BRAKE_CMD", "frame_drop BRAKE_CMD_INV"}
    lost = len(brake_times_s(out / "bus_controller.log")) - len(brake_times_s(out / "bus.log"))
    assert lost == struck["frame_drop BRAKE_CMD"] > 0
    emergencies = read_columns(out / "truth.csv").flags("emergency")
    assert emergencies.count(True) > 0
    # The pause shows on the controller's own segment, where no other fault acts.
    assert longest_gap_s(brake_times_s(out / "bus_controller.log")) >= 0.45
    assert result.frames > 1000
    assert result.measures["gateway_wait_p99_us"] is not None


def test_a_controller_death_fails_the_case_with_its_reason_and_the_run_continues(
    tmp_path: Path,
) -> None:
    """The controller is a foreign program that is killed while the train runs; the train then
    comes to a stand."""
    command = f"sh -c '{SHIPPED} & sleep 5; kill -9 $!; echo the axle broke; exit 7'"
    out = tmp_path / "run"

    result = run(case_of(controller=ControllerSpec(kind="command", command=command)), out)

    assert result.verdict is Verdict.FAIL
    assert result.exit_reason == "the controller died"
    assert "exit code 7" in result.reason
    assert "the axle broke" in result.reason
    assert read_columns(out / "truth.csv").numbers("speed_mps")[-1] == 0.0


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"faults": ({"kind": "clock_step", "start_s": 4.0},)}, "CLOCK_MONOTONIC"),
        ({"controller": ControllerSpec(kind="command", command="/no/such/thing")}, "No such file"),
        ({"controller": ControllerSpec(kind="checkout", path="/no/such")}, "is not a checkout"),
        ({"setup": Setup(line="florenz")}, "nearest valid"),
        (
            {
                "setup": Setup(end="III", stops=("III",)),
                "controller": ControllerSpec(kind="command", command="true {bus}"),
            },
            "stops",
        ),
    ],
)
def test_an_impossible_case_is_blocked_with_the_reason(
    tmp_path: Path, changes: dict[str, object], words: str
) -> None:
    result = run(case_of(**changes), tmp_path / "run")

    assert result.verdict is Verdict.BLOCKED
    assert words in result.reason


@pytest.mark.parametrize(
    ("wires", "words"),
    [
        (RealtimeWires(), "socketcan:can0"),
        (RealtimeWires(bus_a="socketcan:nocan7"), "nocan7"),
        (RealtimeWires(bus_a="embedded:nobody"), "nobody"),
    ],
)
def test_missing_hardware_blocks_the_case(tmp_path: Path, wires: RealtimeWires, words: str) -> None:
    result = run(case_of(bench=BenchKind.HARDWARE), tmp_path / "run", wires)

    assert result.verdict is Verdict.BLOCKED
    assert words in result.reason
