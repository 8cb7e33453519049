"""Compiles small numeric functions with numba where it is installed (the extra `compiled`).

Without numba the same functions run uncompiled, about fifty times slower and with the same results.
What is compiled is kept in the user's cache until a source of the packages below changes.
"""

import hashlib
import importlib
import importlib.util
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, Final, TypeVar

from firmware_py.native.build import cache_folder

F = TypeVar("F", bound=Callable[..., Any])


def _has_numba() -> bool:
    try:
        return importlib.util.find_spec("numba") is not None
    except ValueError:
        # A test or a user hid the module on purpose: a module set to None has no specification.
        return False


COMPILED: Final = _has_numba()
CALLED: Final = ("plant_emulator", "vobc")
"""Packages whose functions a compiled function may call, besides those of its own package."""


def kernel(function: F, *, parallel: bool = False) -> F:
    """Compile a function of floats, integers and arrays that calls only such functions.

    Args:
        parallel: run the function's loops over `prange` on all processors.
    """
    if not COMPILED:
        return function
    numba = importlib.import_module("numba")
    folder = _kept(function.__module__.partition(".")[0])
    before = numba.config.CACHE_DIR
    # numba reads this where the function is decorated. By itself it would put what it compiles
    # beside the sources, and would not notice changes in functions of other files.
    numba.config.CACHE_DIR = folder
    try:
        compiled: F = numba.njit(error_model="numpy", parallel=parallel, cache=bool(folder))(
            function
        )
    finally:
        numba.config.CACHE_DIR = before
    return compiled


@cache
def _kept(package: str) -> str:
    """The folder for what is compiled from the present sources; empty without a cache."""
    digest = hashlib.sha256()
    for name in sorted({package, *CALLED}):
        spec = importlib.util.find_spec(name)
        for place in (spec.submodule_search_locations or ()) if spec is not None else ():
            for path in sorted(Path(place).rglob("*.py")):
                digest.update(f"{name}/{path.relative_to(place)}\0".encode())
                digest.update(hashlib.sha256(path.read_bytes()).digest())
    try:
        folder = cache_folder() / "numba" / digest.hexdigest()[:24]
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return ""
    return str(folder)


def jitted(module: ModuleType) -> Any:
    """Return a copy of a module with all functions compiled by `kernel`; the module itself stays
    unchanged.

    The copy is made from the Python source even if the module was compiled in another way.
    """
    if not COMPILED:
        return module
    short = module.__name__.rpartition(".")[2]
    assert module.__file__ is not None
    source = Path(module.__file__).with_name(f"{short}.py")
    spec = importlib.util.spec_from_file_location(f"{module.__name__}_jitted", source)
    assert spec is not None
    assert spec.loader is not None
    twin = importlib.util.module_from_spec(spec)
    # Compiled functions that were kept look for their module by its name.
    sys.modules[twin.__name__] = twin
    spec.loader.exec_module(twin)
    for name, value in list(vars(twin).items()):
        # The functions call each other in the copy, where all are compiled.
        if isinstance(value, FunctionType) and value.__module__ == twin.__name__:
            setattr(twin, name, kernel(value))
    return twin
