"""A process that opens a bus starts without python-can's MF4 module and loads it on demand."""

import json
import subprocess
import sys
from pathlib import Path

ASK = """\
import json, sys
from firmware_py.buses.lean_can import put_off_mf4
put_off_mf4()
import can
from can.interfaces.socketcan import SocketcanBus
before = sorted({"asammdf", "pandas"}.intersection(sys.modules))
path = sys.argv[1]
with can.MF4Writer(path) as writer:
    writer(can.Message(arbitration_id=0x123, data=b"metro", timestamp=1.0, is_extended_id=False))
with can.LogReader(path) as reader:
    found = [[message.arbitration_id, bytes(message.data).decode()] for message in reader]
import can.io.mf4
put_off_mf4()
whole = can.io.mf4.MF4Reader.__module__ == "can.io.mf4" and hasattr(can.io.mf4, "MDF4")
print(json.dumps([before, found, whole]))
"""


def test_mf4_is_loaded_only_when_used_and_then_works(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", ASK, str(tmp_path / "log.mf4")],
        capture_output=True,
        text=True,
        check=False,
    )

    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == [[], [[0x123, "metro"]], True]


def test_an_already_loaded_python_can_stays_unchanged() -> None:
    text = (
        "import can, sys, firmware_py.buses.lean_can as lean\n"
        "one = sys.modules['can.io.mf4']; lean.put_off_mf4()\n"
        "sys.exit(sys.modules['can.io.mf4'] is not one)"
    )

    assert subprocess.run([sys.executable, "-c", text], check=False).returncode == 0
