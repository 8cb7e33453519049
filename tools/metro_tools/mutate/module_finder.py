"""Inserts a mutation into a module: on import, or into the functions of a loaded one."""

import ast
import functools
import gc
import importlib.machinery
import importlib.util
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from importlib.abc import MetaPathFinder
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any, Final

_CACHED: Final = type(functools.cache(lambda: None))


class NotSwappableError(Exception):
    """The mutation cannot be put into existing functions."""


class MutantFinder(MetaPathFinder):
    """Loads one module with a mutation; all other modules are imported as usual."""

    def __init__(self, name: str, path: Path, tree: ast.Module) -> None:
        self._name = name
        self._loader = _MutantLoader(name, path, tree)

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        if fullname != self._name:
            return None
        return importlib.util.spec_from_file_location(
            fullname, self._loader.path, loader=self._loader
        )


class _MutantLoader(importlib.machinery.SourceFileLoader):
    def __init__(self, name: str, path: Path, tree: ast.Module) -> None:
        super().__init__(name, str(path))
        self._tree = tree

    def get_code(self, fullname: str) -> CodeType:
        return compile(self._tree, self.path, "exec", dont_inherit=True)


def install(name: str, path: Path, tree: ast.Module) -> None:
    """Import the module with the mutation from now on. It must not be imported yet."""
    assert name not in sys.modules
    sys.meta_path.insert(0, MutantFinder(name, path, tree))


def _file_of(function: object) -> str | None:
    """Return the source file of a function; None for one of a compiled library."""
    return function.__code__.co_filename if isinstance(function, FunctionType) else None


class Living:
    """All loaded functions and caches of some files, collected once because the search takes a
    while.
    """

    def __init__(self, paths: set[str]) -> None:
        self._functions: dict[str, list[FunctionType]] = {path: [] for path in paths}
        self._caches: list[Any] = []
        for item in gc.get_objects():
            if isinstance(item, FunctionType):
                found = self._functions.get(item.__code__.co_filename)
                if found is not None:
                    found.append(item)
            elif isinstance(item, _CACHED) and _file_of(item.__wrapped__) in paths:
                self._caches.append(item)

    def swap(self, path: Path, tree: ast.Module) -> None:
        """Replace the code of all functions of an imported module by the mutated code.

        Every holder of such a function runs the mutation from now on. Raises NotSwappableError for
        code with other closure variables, for code that cannot be distinguished from its neighbour,
        and for modules that are not imported.
        """
        codes = list(_codes(compile(tree, str(path), "exec", dont_inherit=True)))
        counted = Counter(_place(code) for code in codes)
        by_place = {_place(code): code for code in codes}
        functions = self._functions[str(path)]
        if codes and not functions:
            raise NotSwappableError(f"{path} is not imported")
        for function in functions:
            old = function.__code__
            new = by_place.get(_place(old))
            if new is None or counted[_place(old)] > 1:
                raise NotSwappableError(f"{old.co_qualname} in line {old.co_firstlineno}")
            if new == old:
                continue
            if new.co_freevars != old.co_freevars:
                raise NotSwappableError(f"{old.co_qualname} holds other variables")
            function.__code__ = new
        self.forget()

    def forget(self) -> None:
        """Empty all caches, because their contents were computed without the mutation."""
        for item in self._caches:
            item.cache_clear()


def _codes(code: CodeType) -> Iterator[CodeType]:
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield constant
            yield from _codes(constant)


def _place(code: CodeType) -> tuple[str, int]:
    return code.co_qualname, code.co_firstlineno
