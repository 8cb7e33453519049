"""Compiles small numeric functions with numba where it is there (the extra `compiled`).

Without it the same functions run as they stand, some fifty times slower and to the same figures.
"""

import importlib
import importlib.util
from collections.abc import Callable
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
