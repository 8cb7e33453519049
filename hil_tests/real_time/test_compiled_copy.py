"""The compiled copy in the cache runs the same train with identical bytes.

`make compiled` compares the copy of the line simulator (`hil_tests.simulator_copy`).
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest

from metro_hil.campaign.builder import Scenario
from metro_hil.model.case import CaseResult, Host
from metro_hil.model.native_copy import Part, ready_copy, worker_environment
from metro_hil.run.dispatch import run_case
from metro_tools.compiled import MODULES, build, hot_modules

pytestmark = pytest.mark.slow

HOP = ["run", "--lockstep", "--from", "II", "--to", "III", "--json"]
LEAST = 40
SHORT = {"start": "II", "end": "III", "duration_s": 30.0}
FAULTS: list[dict[str, object]] = [
    {"kind": "frame_delay", "delay_s": 0.03, "jitter_s": 0.02, "when": "front_m > 3060"},
    {"kind": "controller_paused", "when": "front_m > 3080", "duration_s": 0.06},
    {"kind": "wheel_slip", "when": "front_m > 3055", "duration_s": 1.0},
    {"kind": "telegram_torn", "share_ratio": 0.2},
    {"kind": "radio_delay", "delay_s": 0.1, "jitter_s": 0.1},
    {"kind": "brake_weak", "gain_ratio": 0.9},
    {"kind": "line_voltage", "when": "front_m > 3070", "duration_s": 1.0},
    {"kind": "door_lock_lost", "when": "front_m > 3090", "duration_s": 0.5},
    {"kind": "passenger_alarm", "when": "front_m > 3100"},
]
"""One fault for each place where faults act."""
BY_TYPES = (
    *("test_t2t_envelope.py", "test_zenoh_config_codec.py"),
    *("test_vobc_config.py", "test_firmware_trackdb.py", "test_trackdb_circuit.py"),
)
"""Tests of radio messages and settings, which are decoded by the types of their fields."""
GROUP = """\
import sys
import msgspec
from metro_hil.model.case import Case
from metro_hil.run import case as case_run
from metro_hil.run.dispatch import run_group
assert case_run.__file__.endswith(".so"), case_run.__file__
cases = msgspec.json.decode(sys.stdin.buffer.read(), type=list[Case])
sys.stdout.buffer.write(msgspec.json.encode(list(run_group(cases))))
"""


def results(library: Path | None, *command: str | Path) -> dict[str, object]:
    done = subprocess.run(
        [sys.executable, "-m", *(str(word) for word in command)],
        env=worker_environment(os.environ, library),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found: dict[str, object] = json.loads(done.stdout)
    return found


@pytest.fixture(scope="module")
def copy(c_compiler: str) -> Path:
    """The copy that users get, from the cache or built now."""
    assert c_compiler
    assert build(Part.TRAIN, wait=True) == 0
    library = ready_copy()
    assert library is not None
    return library


def test_every_module_of_the_copy_can_be_imported(copy: Path) -> None:
    folders = {path.name: path for path in copy.iterdir()}
    found = hot_modules(folders, MODULES[Part.TRAIN])
    names = [name.removesuffix(".py").replace("/", ".") for name in found]
    done = subprocess.run(
        [sys.executable, "-c", "".join(f"import {name}\n" for name in names)],
        env=worker_environment(os.environ, copy),
        capture_output=True,
        text=True,
        check=False,
    )

    assert done.returncode == 0, done.stderr


def test_the_copy_decodes_messages_and_settings_by_field_types(copy: Path, checkout: Path) -> None:
    tests = [next((checkout / "hil_tests/unit").rglob(name)) for name in BY_TYPES]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-n", "0", "-p", "no:cacheprovider", *tests],
        env=worker_environment(os.environ, copy),
        cwd=checkout,
        capture_output=True,
        text=True,
        check=False,
    )

    assert done.returncode == 0, done.stdout


def test_the_compiled_copy_gives_the_same_bytes(copy: Path, tmp_path: Path) -> None:
    compiled = results(copy, "metro_hil.cli.vobc", *HOP, "--out", tmp_path / "compiled")
    plain = results(None, "metro_hil.cli.vobc", *HOP, "--out", tmp_path / "plain")

    made = [*copy.rglob("*.so")]
    assert len(made) > LEAST
    assert compiled["frame_log_sha256"] == plain["frame_log_sha256"]
    for name in ("bus.log", "cycles.csv", "truth.csv", "serial.log"):
        one, other = tmp_path / "compiled" / name, tmp_path / "plain" / name
        assert one.read_bytes() == other.read_bytes(), name


def test_grouped_cases_with_faults_give_the_same_results_compiled(copy: Path) -> None:
    """The cases run alone in plain Python, and in copies of one process with compiled modules."""
    branch = {"seed": 9, "when": "front_m > 3050"}
    cases = Scenario(
        train=SHORT, seeds=3, branch=branch, fault=FAULTS, stop_at_violation=False
    ).cases()

    done = subprocess.run(
        [sys.executable, "-c", GROUP],
        input=msgspec.json.encode(cases),
        capture_output=True,
        env=worker_environment(os.environ, copy),
        check=False,
    )

    assert done.returncode == 0, done.stderr.decode()
    grouped = msgspec.json.decode(done.stdout, type=list[CaseResult])
    alone = [run_case(case) for case in cases]
    assert [msgspec.structs.replace(one, host=Host()) for one in grouped] == [
        msgspec.structs.replace(one, host=Host()) for one in alone
    ]
