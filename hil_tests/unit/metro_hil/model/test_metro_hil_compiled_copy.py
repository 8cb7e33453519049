"""Campaigns use the compiled copy only if it belongs to exactly these sources."""

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


def test_a_copy_of_these_sources_is_used(checkout: Path) -> None:
    assert compiled_library(checkout) == checkout / ".compiled/lib"


def test_without_a_copy_there_is_none(tmp_path: Path) -> None:
    assert compiled_library(tmp_path) is None


def test_a_copy_of_older_sources_is_not_used(checkout: Path) -> None:
    (checkout / "vobc/module.py").write_text("NAME = 'other'\n")

    assert compiled_library(checkout) is None


def test_a_copy_that_lacks_a_new_file_is_not_used(checkout: Path) -> None:
    (checkout / "can_dbc/new.dbc").write_text("VERSION")

    assert compiled_library(checkout) is None


def test_a_copy_whose_compilation_failed_is_not_used(checkout: Path) -> None:
    (checkout / ".compiled/lib/vobc/module.so").unlink()

    assert compiled_library(checkout) is None


def test_a_worker_imports_from_the_copy_only(tmp_path: Path) -> None:
    assert worker_environment({"HOME": "x"}, tmp_path) == {
        "HOME": "x",
        "PYTHONPATH": str(tmp_path),
        "PYTHONSAFEPATH": "1",
    }
    assert worker_environment({"HOME": "x"}, None) == {"HOME": "x"}
