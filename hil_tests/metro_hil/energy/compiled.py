"""Compiles small numeric functions with numba where it is installed (the extra `compiled`).

Without numba the same functions run uncompiled, about fifty times slower and with the same results.
"""

import importlib
import importlib.util
from collections.abc import Callable
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, Final, TypeVar

F = TypeVar("F", bound=Callable[..., Any])


def _has_numba() -> bool:
    try:
        return importlib.util.find_spec("numba") is not None
    except ValueError:
        # A test or a user hid the module on purpose: a module set to None has no specification.
        return False


COMPILED: Final = _has_numba()


def kernel(function: F) -> F:
    """Compile a function of floats, integers and arrays that calls only such functions.

    The result is not cached on disk, because numba would not notice changes in called functions.
    """
    if not COMPILED:
        return function
    numba = importlib.import_module("numba")
    compiled: F = numba.njit(error_model="numpy")(function)
    return compiled


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
    spec.loader.exec_module(twin)
    for name, value in list(vars(twin).items()):
        # The functions call each other in the copy, where all are compiled.
        if isinstance(value, FunctionType) and value.__module__ == twin.__name__:
            setattr(twin, name, kernel(value))
    return twin
