"""Cases on the kernel's own CAN: a gateway between two interfaces, and a foreign train."""

import json
import sys
from pathlib import Path

import pytest

from can_dbc.binding import can_id
from can_dbc.brake import BrakeCommand
from firmware_py.candump import read_candump
from hil_tests.guest_rig import Guest

pytestmark = [pytest.mark.guest, pytest.mark.slow]

BIN = Path(sys.executable).parent
CASES = Path(__file__).with_name("realtime_on_vcan.py")
BRAKE_ID = can_id(BrakeCommand)
RUN_S = 240

SCRIPT = """
set -e
{bin}/vcan up vcan1 >&2
{bin}/python {cases} {folder} >{folder}/results.json
"""


@pytest.fixture(scope="module")
def folder(guest: Guest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of both cases with their results."""
    folder = tmp_path_factory.mktemp("vcan")
    script = SCRIPT.format(bin=BIN, cases=CASES, folder=folder)
    done = guest.run("bash", "-c", script, timeout_s=RUN_S, options=["--write", str(folder)])
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def brakes_in(log: Path) -> int:
    return sum(1 for logged in read_candump(log) if logged.frame.can_id == BRAKE_ID)


def test_a_gateway_between_two_interfaces_drops_the_frames_of_the_fault(folder: Path) -> None:
    result = json.loads((folder / "results.json").read_text())["split"]

    assert result["verdict"] not in ("blocked", "fail"), result["reason"]
    assert result["exit_reason"] == "duration over"
    gateway = json.loads((folder / "split/gateway.json").read_text())
    struck = gateway["struck"]
    assert set(struck) == {"frame_drop BRAKE_CMD", "frame_drop BRAKE_CMD_INV"}
    lost = brakes_in(folder / "split/bus_controller.log") - brakes_in(folder / "split/bus.log")
    assert lost == struck["frame_drop BRAKE_CMD"] > 0
    assert gateway["sent_to_vobc"] == gateway["came_to_vobc"] > 1000


def test_with_a_foreign_train_the_controller_drives_and_no_truth_is_claimed(
    folder: Path,
) -> None:
    """Monitors that need the truth are inconclusive, so the case is no pass."""
    result = json.loads((folder / "results.json").read_text())["real_train"]

    assert result["verdict"] == "inconclusive", result["reason"]
    said, true = result["monitors"]
    assert (said["name"], said["verdict"]) == ("said on the bus", "pass")
    assert (true["name"], true["verdict"]) == ("true of the train", "inconclusive")
    assert "truth" in true["detail"]
    assert result["exit_reason"] == "duration over"
    assert result["frames"] > 1000
    assert "stop_error_worst_m" not in result["measures"]
    assert (folder / "real_train/serial.log").exists()
    assert brakes_in(folder / "real_train/bus.log") > 50
