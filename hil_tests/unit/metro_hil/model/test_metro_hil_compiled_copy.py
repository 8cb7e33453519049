"""Campaigns take the compiled copy only when it is of just these sources."""

from pathlib import Path

import pytest

from metro_hil.model.compiled_copy import PACKAGES, compiled_library, worker_environment


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """Sources and a copy of them with one compiled module."""
    library = tmp_path / ".compiled/lib"
    for name, place in PACKAGES.items():
        for folder in (tmp_path / place, library / name):
            folder.mkdir(parents=True)
            (folder / "module.py").write_text(f"NAME = {name!r}\n")
    (library / "vobc/module.so").write_bytes(b"compiled")
    return tmp_path


def test_a_copy_of_these_sources_is_taken(checkout: Path) -> None:
    assert compiled_library(checkout) == checkout / ".compiled/lib"


def test_without_a_copy_there_is_none(tmp_path: Path) -> None:
    assert compiled_library(tmp_path) is None


def test_a_copy_of_older_sources_is_left_alone(checkout: Path) -> None:
    (checkout / "vobc/module.py").write_text("NAME = 'other'\n")

    assert compiled_library(checkout) is None


def test_a_copy_that_lacks_a_new_file_is_left_alone(checkout: Path) -> None:
    (checkout / "can_dbc/new.dbc").write_text("VERSION")

    assert compiled_library(checkout) is None


def test_a_copy_whose_compiling_failed_is_left_alone(checkout: Path) -> None:
    (checkout / ".compiled/lib/vobc/module.so").unlink()

    assert compiled_library(checkout) is None


def test_a_worker_imports_from_the_copy_and_from_nowhere_beside_it(tmp_path: Path) -> None:
    assert worker_environment({"HOME": "x"}, tmp_path) == {
        "HOME": "x",
        "PYTHONPATH": str(tmp_path),
        "PYTHONSAFEPATH": "1",
    }
    assert worker_environment({"HOME": "x"}, None) == {"HOME": "x"}
