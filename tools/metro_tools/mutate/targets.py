"""Selects the modules to mutate, the tests that must detect each mutant, and the equivalent
mutants.
"""

import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

TARGETS_FILE: Final = "hil_tests/proof/mutation_targets.toml"
EQUIVALENTS_FILE: Final = "hil_tests/proof/equivalent_mutants.toml"
EQUIVALENT_KEYS: Final = frozenset({"module", "function", "mutation", "why"})


class TargetError(Exception):
    """A file of the proof has an impossible value; the text names file, key and value."""


@dataclass(frozen=True, slots=True)
class TargetGroup:
    """Modules covered by the same tests."""

    name: str
    modules: tuple[str, ...]
    """Paths from the checkout."""
    tests: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Equivalent:
    """A mutant that no test can distinguish from the original, with the argument."""

    module: str
    function: str
    mutation: str
    why: str


def read_groups(root: Path) -> list[TargetGroup]:
    """Return all groups with patterns resolved. Raises TargetError."""
    told = _read(root, TARGETS_FILE)
    groups = []
    for name, table in told.items():
        lists = {key: table.get(key) for key in ("modules", "tests")}
        for key, value in lists.items():
            if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
                raise TargetError(f"{TARGETS_FILE}: {name}.{key}: not a list of paths: {value!r}")
        groups.append(
            TargetGroup(
                name=name,
                modules=_found(root, name, "modules", table["modules"], table.get("without", [])),
                tests=_found(root, name, "tests", table["tests"], []),
            )
        )
    return groups


def read_equivalents(root: Path) -> list[Equivalent]:
    """Read the equivalent mutants. Raises TargetError, also for an entry without an argument."""
    entries = []
    for number, table in enumerate(_read(root, EQUIVALENTS_FILE).get("mutant", []), 1):
        where = f"{EQUIVALENTS_FILE}: mutant {number}"
        if table.keys() != EQUIVALENT_KEYS:
            raise TargetError(f"{where}: needs {', '.join(sorted(EQUIVALENT_KEYS))}, no more")
        if not table["why"].strip():
            raise TargetError(
                f"{where}: why: is empty; give the argument for this equivalent mutant"
            )
        entries.append(Equivalent(**table))
    return entries


def chosen(groups: Iterable[TargetGroup], modules: Sequence[str]) -> list[TargetGroup]:
    """Return the groups with only the wanted modules; without any, all groups.

    Raises TargetError.
    """
    if not modules:
        return list(groups)
    known = {module for group in groups for module in group.modules}
    for module in modules:
        if module not in known:
            raise TargetError(f"{module}: in no group of {TARGETS_FILE}; known: {sorted(known)}")
    picked = (
        TargetGroup(group.name, tuple(m for m in group.modules if m in modules), group.tests)
        for group in groups
    )
    return [group for group in picked if group.modules]


def _read(root: Path, name: str) -> Mapping[str, Any]:
    try:
        return tomllib.loads((root / name).read_text(encoding="utf-8"))
    except OSError as error:
        raise TargetError(f"{name}: cannot be read: {error}") from None
    except tomllib.TOMLDecodeError as error:
        raise TargetError(f"{name}: {error}") from None


def _found(
    root: Path, group: str, key: str, patterns: Sequence[str], without: Sequence[str]
) -> tuple[str, ...]:
    found: dict[str, None] = {}
    for pattern in patterns:
        paths = sorted(str(path.relative_to(root)) for path in root.glob(pattern))
        if not paths and "*" not in pattern:
            raise TargetError(f"{TARGETS_FILE}: {group}.{key}: {pattern!r} matches no file")
        found.update(dict.fromkeys(paths))
    if not found:
        raise TargetError(f"{TARGETS_FILE}: {group}.{key}: no pattern matches a file: {patterns}")
    return tuple(path for path in found if path not in without)
