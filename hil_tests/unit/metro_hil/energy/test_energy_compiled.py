"""What numba compiled is kept until a source changes from which it may come."""

from pathlib import Path

import pytest

from metro_hil.energy import compiled

folder_of = compiled._kept.__wrapped__


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "kernels").mkdir()
    (tmp_path / "kernels" / "__init__.py").write_text("A = 1\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "kernels"


def test_a_changed_source_gets_a_folder_of_its_own(package: Path) -> None:
    before = folder_of("kernels")
    assert folder_of("kernels") == before
    assert Path(before).is_dir()

    (package / "__init__.py").write_text("A = 2\n")
    changed = folder_of("kernels")
    (package / "more.py").write_text("")
    assert len({before, changed, folder_of("kernels")}) == 3


def test_without_a_safe_cache_nothing_is_kept(package: Path) -> None:
    cache = package.parent / "cache" / "metro-bench"
    cache.mkdir(parents=True)
    cache.chmod(0o777)

    assert folder_of("kernels") == ""


def test_what_is_compiled_is_kept_there() -> None:
    if not compiled.COMPILED:
        pytest.fail("numba is not there, though the setup for development brings it")
    assert compiled.kernel(_twice)(1.25) == 2.5

    folder = Path(compiled._kept(__name__.partition(".")[0]))
    assert list(folder.rglob("*twice*.nbi"))


def _twice(value: float) -> float:
    return value + value
