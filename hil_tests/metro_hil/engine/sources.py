"""A hash over the sources that decide the result of a case in virtual time.

Published figures carry it. Comments, docstrings and modules that no case runs do not count.
Rewording a comment or changing a report therefore leaves published figures valid.
"""

import ast
import hashlib
import importlib.util
from collections.abc import Iterator
from functools import cache
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Final

from metro_hil.run import case

PACKAGES: Final = ("can_dbc", "firmware_py", "plant_emulator", "vobc", "zenoh_config")
"""Packages whose data files decide results as well: frames, lines, trains, parameters."""
OURS: Final = frozenset({*PACKAGES, "metro_hil", "metro_tools"})
DATA: Final = (".dbc", ".toml", ".json5")
DIGITS: Final = 16


@cache
def sources_hash() -> str:
    """Hash that is equal for two source trees whose cases give equal results in virtual time."""
    digest = hashlib.sha256()
    for name in sorted(modules_of(case.__name__)):
        digest.update(name.encode() + b"\0" + meaning(_tree(name)).encode() + b"\0")
    for package in PACKAGES:
        for path, content in _data(package, resources.files(package)):
            digest.update(path.encode() + b"\0" + hashlib.sha256(content).digest())
    return digest.hexdigest()[:DIGITS]


def modules_of(name: str) -> frozenset[str]:
    """This module and all modules of the project that it imports, even inside functions."""
    found: set[str] = set()
    waiting = [name]
    while waiting:
        module = waiting.pop()
        if module not in found:
            found.add(module)
            waiting += _imported(_tree(module))
    return frozenset(found)


def meaning(tree: ast.Module) -> str:
    """Text of the syntax tree without docstrings, which are removed from `tree`."""
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            kept = [each for each in body if not _is_text(each)]
            node.body = kept or [ast.Pass()]  # type: ignore[attr-defined]
    return ast.dump(tree)


def _is_text(node: ast.AST) -> bool:
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )


def _imported(tree: ast.Module) -> Iterator[str]:
    for node in ast.walk(tree):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        for name in names:
            parts = name.split(".")
            if parts[0] in OURS:
                wholes = (".".join(parts[: count + 1]) for count in range(len(parts)))
                yield from (whole for whole in wholes if _path(whole) is not None)


@cache
def _tree(module: str) -> ast.Module:
    path = _path(module)
    assert path is not None, module
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def _path(module: str) -> Path | None:
    """The file of one of our modules, or None for a name inside a module."""
    package, *parts = module.split(".")
    spec = importlib.util.find_spec(package)
    assert spec is not None
    assert spec.submodule_search_locations is not None
    place = Path(spec.submodule_search_locations[0]).joinpath(*parts)
    found = (place / "__init__.py", place.with_suffix(".py"))
    return next((path for path in found if path.is_file()), None)


def _data(name: str, folder: Traversable) -> Iterator[tuple[str, bytes]]:
    for entry in sorted(folder.iterdir(), key=lambda entry: entry.name):
        path = f"{name}/{entry.name}"
        if entry.is_dir():
            yield from _data(path, entry)
        elif entry.name.endswith(DATA):
            yield path, entry.read_bytes()
