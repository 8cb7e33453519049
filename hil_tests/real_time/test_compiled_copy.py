"""The copy made by `make compiled` runs the same train with identical bytes."""

import json
import os
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest

from metro_hil.campaign.builder import Scenario
from metro_hil.model.case import CaseResult, Host
from metro_hil.model.compiled_copy import worker_environment
from metro_hil.run.dispatch import run_case
from metro_tools import compiled
from metro_tools.compiled import (
    HOT,
    SIMULATOR,
    CompileError,
    compile_into,
    copy_packages,
    hot_modules,
)

pytestmark = pytest.mark.slow

HOP = ["run", "--lockstep", "--from", "II", "--to", "III", "--json"]
MODULES = 40
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


def results(*command: str | Path) -> dict[str, object]:
    done = subprocess.run(
        [str(word) for word in command], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    found: dict[str, object] = json.loads(done.stdout)
    return found


@pytest.fixture(scope="module")
def copy(checkout: Path, c_compiler: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    assert c_compiler
    place = tmp_path_factory.mktemp("compiled") / "copy"
    # The test covers mypyc's output and not the optimiser of the C compiler.
    subprocess.run(
        [
            *(sys.executable, "-m", "metro_tools.compiled", "--optimise", "0"),
            *("--into", place, "--source", checkout),
        ],
        check=True,
        capture_output=True,
    )
    return place


def test_every_module_of_the_copy_can_be_imported(copy: Path) -> None:
    names = [name.removesuffix(".py").replace("/", ".") for name in hot_modules(copy / "lib")]
    done = subprocess.run(
        [sys.executable, "-c", "".join(f"import {name}\n" for name in names)],
        env=worker_environment(os.environ, copy / "lib"),
        capture_output=True,
        text=True,
        check=False,
    )

    assert done.returncode == 0, done.stderr


def test_the_copy_decodes_messages_and_settings_by_field_types(copy: Path, checkout: Path) -> None:
    tests = [next((checkout / "hil_tests/unit").rglob(name)) for name in BY_TYPES]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-n", "0", "-p", "no:cacheprovider", *tests],
        env=worker_environment(os.environ, copy / "lib"),
        cwd=checkout,
        capture_output=True,
        text=True,
        check=False,
    )

    assert done.returncode == 0, done.stdout


def test_the_compiled_copy_gives_the_same_bytes(copy: Path, tmp_path: Path) -> None:
    compiled = results(copy / "bin/vobc", *HOP, "--out", tmp_path / "compiled")
    plain = results(sys.executable, "-m", "metro_hil.cli.vobc", *HOP, "--out", tmp_path / "plain")

    made = [path.name for path in (copy / "lib").rglob("*.so")]
    assert len(made) > MODULES
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
        env=worker_environment(os.environ, copy / "lib"),
        check=False,
    )

    assert done.returncode == 0, done.stderr.decode()
    grouped = msgspec.json.decode(done.stdout, type=list[CaseResult])
    alone = [run_case(case) for case in cases]
    assert [msgspec.structs.replace(one, host=Host()) for one in grouped] == [
        msgspec.structs.replace(one, host=Host()) for one in alone
    ]


FEW = (compiled.HEADS, "firmware_py/trackdb/areas.py")
SETUP = """\
from setuptools import Extension, setup
# {modules} {level}
setup(name="compiled", packages=[], ext_modules=[Extension("firmware_py.spare", ["spare.c"])])
"""
SPARE = """\
#include <Python.h>
static struct PyModuleDef spare = {PyModuleDef_HEAD_INIT, "spare", 0, -1};
PyMODINIT_FUNC PyInit_spare(void) { return PyModule_Create(&spare); }
"""
"""One module in C that replaces mypyc's output, which would take a minute."""


@pytest.fixture
def library(
    checkout: Path, c_compiler: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Path:
    """A library with few hot modules, one of which is compiled."""
    assert c_compiler
    monkeypatch.setattr(compiled, "HOT", FEW)
    monkeypatch.setattr(compiled, "SETUP", SETUP)
    copy_packages(checkout, tmp_path / "lib")
    (tmp_path / "lib/spare.c").write_text(SPARE)
    return tmp_path / "lib"


def test_a_trained_copy_is_compiled_with_its_profile(
    checkout: Path, library: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = library.parent / "seen"
    trains = (
        "from pathlib import Path; from firmware_py import spare; "
        f"Path({str(seen)!r}).write_text(spare.__file__)"
    )
    flags: list[str] = []
    build = compiled._build

    def watched(setup: Path, more: str) -> None:
        flags.append(more)
        build(setup, more)

    monkeypatch.setattr(compiled, "TRAINING", (("-c", trains),))
    monkeypatch.setattr(compiled, "_build", watched)

    compile_into(library, "0", trained=True)

    assert flags == [compiled.WATCHED, compiled.TRAINED]
    # The trained module is compiled but not kept; the kept one writes no profile.
    assert Path(seen.read_text()).suffix == ".so"
    (made,) = library.rglob("*.so")
    assert str(made) == seen.read_text()
    assert b"gcda" not in made.read_bytes()
    assert not (library / "build").exists()
    for name in FEW:
        assert (library / name).read_bytes() == (checkout / name).read_bytes()


def test_a_failed_training_and_a_missing_profile_are_reported(
    library: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compiled, "_build", lambda setup, more: None)
    monkeypatch.setattr(compiled, "TRAINING", (("-c", "raise SystemExit('out of coal')"),))
    with pytest.raises(CompileError, match=r"training with -c .* failed:\nout of coal"):
        compile_into(library, "0", trained=True)

    monkeypatch.setattr(compiled, "TRAINING", (("-c", "pass"),))
    with pytest.raises(CompileError, match="no profile was written: training needs gcc"):
        compile_into(library, "0", trained=True)


@pytest.mark.parametrize("patterns", [HOT, SIMULATOR])
def test_every_pattern_of_hot_modules_matches(checkout: Path, patterns: tuple[str, ...]) -> None:
    found = hot_modules(checkout, patterns)

    for pattern in patterns:
        assert any(Path(name).match(pattern) for name in found), pattern
    assert "zenoh_config/sessions.py" not in found


def test_a_copy_for_the_simulator_compiles_no_more_than_the_whole_copy(
    checkout: Path, library: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert set(hot_modules(checkout, SIMULATOR)) < set(hot_modules(checkout, HOT))
    monkeypatch.setattr(compiled, "SIMULATOR", FEW)
    monkeypatch.setattr(compiled, "HOT", ())
    monkeypatch.setattr(compiled, "SEEDS", (("-c", "raise SystemExit('no seeds')"),))

    with pytest.raises(CompileError, match="no seeds"):
        compile_into(library, "0", trained=True, simulator=True)

    compile_into(library, "0", simulator=True)
    assert list(library.rglob("*.so"))


def test_a_foreign_folder_is_not_touched(checkout: Path, tmp_path: Path) -> None:
    (tmp_path / "precious").write_text("kept")

    done = subprocess.run(
        [sys.executable, "-m", "metro_tools.compiled", "--into", tmp_path, "--source", checkout],
        capture_output=True,
        text=True,
        check=False,
    )

    assert done.returncode == 3
    assert "Traceback" not in done.stderr
    assert (tmp_path / "precious").read_text() == "kept"


def test_line_simulator_seeds_give_the_same_results_in_compiled_workers(
    copy: Path, tmp_path: Path
) -> None:
    seeds = ["simulate", "--seeds", "7..9", "--minutes", "0.2", "--workers"]
    journal = ("--journal", tmp_path / "compiled.jsonl")
    results(copy / "bin/hil", *seeds, "2", *journal, "--json")
    journal = ("--journal", tmp_path / "plain.jsonl")
    results(sys.executable, "-m", "metro_hil.cli.hil", *seeds, "1", *journal, "--json")

    compiled, plain = (
        [json.loads(line) for line in (tmp_path / name).read_text().splitlines()]
        for name in ("compiled.jsonl", "plain.jsonl")
    )
    assert [each["seed"] for each in plain] == [7, 8, 9]
    assert [each["digest"] for each in compiled] == [each["digest"] for each in plain]
