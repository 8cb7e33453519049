"""Compiles small numeric functions with numba where it is installed (the extra `compiled`).

Without numba the same functions run uncompiled, about fifty times slower and with the same results.
What is compiled is kept in the user's cache until the function changes, or a function or constant
that it reaches.
"""

import hashlib
import importlib
import importlib.util
import sys
from collections.abc import Callable, Iterator, Mapping, Set
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
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
OURS: Final = frozenset({"metro_hil", "plant_emulator", "vobc"})
"""Packages whose functions and constants a compiled function may reach."""


def kernel(function: F, *, parallel: bool = False) -> F:
    """Compile a function of floats, integers and arrays that calls only such functions.

    Args:
        parallel: run the function's loops over `prange` on all processors.
    """
    if not COMPILED:
        return function
    numba = importlib.import_module("numba")
    folder = _kept(function)
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


def _kept(function: Callable[..., Any]) -> str:
    """The folder for what is compiled from a function as it is now; empty without a cache."""
    digest = hashlib.sha256()
    try:
        for line in _reached(function, set()):
            digest.update(f"{line}\0".encode())
        folder = cache_folder() / "numba" / digest.hexdigest()[:24]
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, TypeError):
        return ""
    return str(folder)


def _reached(value: Any, done: set[object]) -> Iterator[str]:
    """Describe a value and all that the code of a function reaches by name, across modules.

    Raises TypeError for a value that may change without notice here, such as an array.
    """
    value = getattr(value, "py_func", value)
    if isinstance(value, FunctionType):
        if id(value) not in done:
            done.add(id(value))
            yield from _reached_by(value, done)
    elif value is None or isinstance(value, bool | int | float | str):
        yield repr(value)
    elif isinstance(value, tuple):
        for each in value:
            yield from _reached(each, done)
    else:
        module, name = getattr(value, "__module__", ""), getattr(value, "__qualname__", "")
        if not name or module.partition(".")[0] in OURS:
            raise TypeError(value)
        yield f"{module}.{name}"


def _reached_by(function: FunctionType, done: set[object]) -> Iterator[str]:
    codes, names = [function.__code__], set[str]()
    for code in codes:
        codes += [each for each in code.co_consts if isinstance(each, CodeType)]
        names.update(code.co_names)
        yield f"{function.__qualname__} {code.co_code!r} {code.co_names} {code.co_varnames}"
        yield repr([each for each in code.co_consts if not isinstance(each, CodeType)])
    named = tuple((function.__kwdefaults__ or {}).items())
    yield from _reached((function.__defaults__, named), done)
    for cell in function.__closure__ or ():
        yield from _reached(cell.cell_contents, done)
    yield from _named(names, function.__globals__, done)


def _named(names: Set[str], place: Mapping[str, Any], done: set[object]) -> Iterator[str]:
    """Describe the values with these names, and in modules of the project theirs."""
    for name in sorted(names & place.keys()):
        value = place[name]
        if not isinstance(value, ModuleType):
            yield name
            yield from _reached(value, done)
            continue
        yield f"{name} {value.__name__}"
        visit = id(value), frozenset(names)
        if value.__name__.partition(".")[0] in OURS and visit not in done:
            done.add(visit)
            yield from _named(names, vars(value), done)


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
