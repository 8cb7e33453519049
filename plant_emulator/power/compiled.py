"""Compiles small numeric functions with numba where it is there (the extra `compiled`).

Without it the same functions run as they stand, some fifty times slower and to the same figures.
"""

import importlib
import importlib.util
from collections.abc import Callable
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, Final, TypeVar

F = TypeVar("F", bound=Callable[..., Any])


def _there() -> bool:
    try:
        return importlib.util.find_spec("numba") is not None
    except ValueError:
        # Somebody hid it on purpose: a module that is None has no specification.
        return False


COMPILED: Final = _there()


def kernel(function: F) -> F:
    """A function of floats, integers and arrays that calls only such functions.

    Nothing is kept on disk: numba would not notice a change in what a kept function calls.
    """
    if not COMPILED:
        return function
    numba = importlib.import_module("numba")
    compiled: F = numba.njit(error_model="numpy")(function)
    return compiled


def jitted(module: ModuleType) -> Any:
    """The functions of a module once more, each a `kernel`; the module itself stays as it is.

    They come from its source, wherever the module itself was compiled in another way.
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
        # They find one another in the twin, by then as kernels.
        if isinstance(value, FunctionType) and value.__module__ == twin.__name__:
            setattr(twin, name, kernel(value))
    return twin
