"""A message of a DBC file without a frame class fails when its module is imported."""

import importlib
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import can_dbc
from can_dbc import dbc_file
from can_dbc.binding import BindingError, complete

PACKAGE = Path(can_dbc.__file__).parent
MESSAGE = """
BO_ 1500 BRAKE_WEAR: 8 BCU
 SG_ wear_percent : 0|8@1+ (0.5,0) [0|100] "%" VOBC
"""


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A copy of the package with one more message in brake.dbc."""
    shutil.copytree(PACKAGE, tmp_path / "can_dbc", ignore=shutil.ignore_patterns("__pycache__"))
    brake = tmp_path / "can_dbc" / "brake.dbc"
    head, tail = brake.read_text(encoding="ascii").split("\nCM_ ", 1)
    brake.write_text(f"{head}{MESSAGE}\nCM_ {tail}", encoding="ascii")
    return tmp_path


@pytest.mark.parametrize("module", ["can_dbc.brake", "vobc.wire.frames"])
def test_importing_its_module_names_the_message(copy: Path, module: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", f"import sys; sys.path.insert(0, {str(copy)!r}); import {module}"],
        capture_output=True,
        text=True,
        check=False,
    )

    assert done.returncode != 0
    error = done.stderr.splitlines()[-1]
    assert "brake.dbc: BRAKE_WEAR: has no frame class; add one to can_dbc/brake.py" in error


@pytest.mark.parametrize("name", dbc_file.names())
def test_each_module_checks_its_own_file(name: str) -> None:
    source = (PACKAGE / f"{name.removesuffix('.dbc')}.py").read_text(encoding="utf-8")

    assert source.splitlines()[-1] == f'complete("{name}")'
    importlib.import_module(f"can_dbc.{name.removesuffix('.dbc')}")
    complete(name)


def test_an_unknown_file_is_refused() -> None:
    with pytest.raises(BindingError, match=r"nosuch\.dbc: no such file"):
        complete("nosuch.dbc")
