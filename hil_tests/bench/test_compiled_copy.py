"""What `make compiled` makes drives the same train to the same byte."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from metro_tools.compiled import HOT, hot_modules

pytestmark = pytest.mark.slow

HOP = ["run", "--lockstep", "--from", "II", "--to", "III", "--json"]
MODULES = 40


def results(*command: str | Path) -> dict[str, object]:
    done = subprocess.run(
        [str(word) for word in command], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    found: dict[str, object] = json.loads(done.stdout)
    return found


@pytest.mark.usefixtures("c_compiler")
def test_the_compiled_copy_gives_the_same_bytes(checkout: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    subprocess.run(
        [sys.executable, "-m", "metro_tools.compiled", "--into", copy, "--source", checkout],
        check=True,
        capture_output=True,
    )

    compiled = results(copy / "bin/vobc", *HOP, "--out", tmp_path / "compiled")
    plain = results(
        sys.executable, "-m", "metro_hil.vobc_command", *HOP, "--out", tmp_path / "plain"
    )

    made = [path.name for path in (copy / "lib").rglob("*.so")]
    assert len(made) > MODULES
    assert compiled["frame_log_sha256"] == plain["frame_log_sha256"]
    for name in ("bus.log", "cycles.csv", "truth.csv", "serial.log"):
        one, other = tmp_path / "compiled" / name, tmp_path / "plain" / name
        assert one.read_bytes() == other.read_bytes(), name


def test_every_pattern_of_hot_modules_finds_some(checkout: Path) -> None:
    found = hot_modules(checkout)

    for pattern in HOT:
        assert any(Path(name).match(pattern) for name in found), pattern
    assert "vobc/ato/config.py" not in found


def test_a_folder_that_is_something_else_is_left_alone(checkout: Path, tmp_path: Path) -> None:
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
