"""What numba compiled is kept until the function changes, or what it reaches."""

import importlib
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from metro_hil.energy import compiled

SOURCES = {
    "limits": "TOP = 2.0\nLOW = 0.5\nOTHER = 1\ndef half(v): return v / 2\n",
    "kernels": """
import math
import limits
from limits import half
STEPS = (1, 2)
def inner(v, n=3, *, m=7): return max(half(v), limits.LOW) + STEPS[0] * n + m
def outer(v):
    def least(u): return min(u, limits.TOP)
    return least(math.sqrt(inner(v)))
""",
}


@pytest.fixture
def folder_of(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., str]:
    """Give the folder of `outer` when a source has these words instead of those."""
    monkeypatch.setattr(compiled, "OURS", compiled.OURS | set(SOURCES))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)

    def folder(old: str = "", new: str = "") -> str:
        for name, text in SOURCES.items():
            (tmp_path / f"{name}.py").write_text(text.replace(old, new) if old else text)
            monkeypatch.delitem(sys.modules, name, raising=False)
        importlib.invalidate_caches()
        return compiled._kept(importlib.import_module("kernels").outer)

    return folder


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("math.sqrt", "math.floor"),
        ("import math", "import cmath as math"),
        ("min(u,", "max(u,"),
        ("TOP = 2.0", "TOP = 2.5"),
        ("LOW = 0.5", "LOW = 0.6"),
        ("v / 2", "v / 3"),
        ("v / 2", "v * 2"),
        ("(1, 2)", "(2, 2)"),
        ("n=3", "n=4"),
        ("m=7", "m=8"),
        ("* n", "- n"),
    ],
)
def test_a_change_of_what_a_function_reaches_asks_for_another_folder(
    folder_of: Callable[..., str], old: str, new: str
) -> None:
    before = folder_of()

    assert Path(before).is_dir()
    assert folder_of(old, new) not in ("", before)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("OTHER = 1", "OTHER = 2"),
        ("STEPS =", "MORE = 1\nSTEPS ="),
        ("import math", "\nimport math"),
    ],
)
def test_any_other_change_keeps_the_folder(
    folder_of: Callable[..., str], old: str, new: str
) -> None:
    assert folder_of(old, new) == folder_of()


@pytest.mark.parametrize("changing", ["[1, 2]", "type('Own', (), {})"])
def test_a_function_that_reaches_values_that_may_change_is_not_kept(
    folder_of: Callable[..., str], changing: str
) -> None:
    assert folder_of("(1, 2)", changing) == ""


def test_without_a_safe_cache_nothing_is_kept(
    folder_of: Callable[..., str], tmp_path: Path
) -> None:
    cache = tmp_path / "cache" / "metro-bench"
    cache.mkdir(parents=True)
    cache.chmod(0o777)

    assert folder_of() == ""


def test_what_is_compiled_is_kept_there() -> None:
    if not compiled.COMPILED:
        pytest.fail("numba is not there, though the setup for development brings it")
    assert compiled.kernel(_twice)(1.25) == 2.5

    assert list(Path(compiled._kept(_twice)).rglob("*twice*.nbi"))


def _twice(value: float) -> float:
    return value + value
