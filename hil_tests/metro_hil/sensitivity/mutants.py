"""The list of mutants: reads it, selects from it, and changes the controller's source."""

import ast
import fnmatch
import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from firmware_py import settings
from firmware_py.settings import SettingsError, build, nearest
from firmware_py.toml_lines import key_lines

PACKAGE: Final = "metro_hil.sensitivity.shipped"
TABLE: Final = "mutant"
NO_LINES: Final[Mapping[str, int]] = {}


@dataclass(frozen=True, slots=True)
class ControllerMutant:
    """One semantic mistake of the controller."""

    name: str
    rule: str
    """The broken rule, as in docs/reference/supervision.md or docs/design/protection.md."""
    file: str
    """Source file of the controller, relative to the folder that holds the packages."""
    old: str
    """Source text that occurs exactly once in the file."""
    new: str
    """Source text that replaces `old`."""
    tries: tuple[str, ...] = ()
    """Scenarios or case ids that are likely to notice the mutant; they run first."""
    argued: str = ""
    """Why no scenario can notice the mutant; empty if a scenario must notice it."""
    source: str = ""
    """Name of the list; set by the reader."""
    line: int = 0
    """First line of the mutant in the list; set by the reader, otherwise 0."""

    def __post_init__(self) -> None:
        for key in ("name", "rule", "file", "old"):
            if not getattr(self, key).strip():
                raise ValueError(f"{key} is empty")
        if self.old == self.new:
            raise ValueError("new is the same text as old")

    @property
    def where(self) -> str:
        """List, line and name, as messages begin."""
        return (
            f"{self.source}:{self.line}: {self.name}"
            if self.line
            else f"{self.source}: {self.name}"
        )

    @property
    def module(self) -> str:
        """Dotted name of the changed module."""
        return self.file.removesuffix(".py").removesuffix("/__init__").replace("/", ".")

    @property
    def package(self) -> str:
        return self.file.partition("/")[0]


def shipped_mutants() -> tuple[ControllerMutant, ...]:
    """All mutants of all shipped lists, in the order of their files. Raises SettingsError."""
    found: list[ControllerMutant] = []
    for stem in settings.shipped_names(PACKAGE):
        path = settings.find(stem, PACKAGE)
        text = settings.text_of(path)
        tables, lines = settings.tables_of(text, str(path)), key_lines(text)
        found += read_mutants(tables, f"{PACKAGE.rpartition('.')[2]}/{path.name}", lines)
    _refuse_doubles(found)
    return tuple(found)


def read_mutants(
    tables: Mapping[str, Any], source: str, lines: Mapping[str, int] = NO_LINES
) -> list[ControllerMutant]:
    """The mutants of one parsed list. Raises SettingsError that names list, line and mutant.

    Args:
        source: what messages call the list.
        lines: of its keys, as by `key_lines`.
    """
    for key in tables:
        if key != TABLE:
            raise SettingsError(f"{source}: {key}: unknown key; a list holds [[{TABLE}]] only")
    found = []
    for number, table in enumerate(tables.get(TABLE, ()), start=1):
        name = table.get("name", f"number {number}")
        line = lines.get(f"{TABLE}[{number - 1}]", 0)
        where = f"{source}:{line}: {name}" if line else f"{source}: {name}"
        for key in ("source", "line"):
            if key in table:
                raise SettingsError(f"{where}: {key}: unknown key")
        found.append(build(ControllerMutant, {**table, "source": source, "line": line}, where))
    return found


def _refuse_doubles(mutants: Sequence[ControllerMutant]) -> None:
    first: dict[str, str] = {}
    for mutant in mutants:
        if mutant.name in first:
            raise SettingsError(
                f"{mutant.where}: name: is also a mutant of {first[mutant.name]}; rename one"
            )
        first[mutant.name] = mutant.source


def chosen(
    mutants: Sequence[ControllerMutant], patterns: Sequence[str]
) -> tuple[ControllerMutant, ...]:
    """Mutants whose name matches a pattern; all without a pattern. Raises SettingsError."""
    names = [mutant.name for mutant in mutants]
    for pattern in patterns:
        if not fnmatch.filter(names, pattern):
            raise SettingsError(f"--only {pattern}: {nearest(pattern, names, 'mutant')}")
    return tuple(
        mutant
        for mutant in mutants
        if not patterns or any(fnmatch.fnmatchcase(mutant.name, each) for each in patterns)
    )


def sampled(
    mutants: Sequence[ControllerMutant], share_ratio: float, seed: str
) -> tuple[ControllerMutant, ...]:
    """A sample of at least one mutant, which depends only on the names and the seed."""
    assert 0.0 < share_ratio <= 1.0
    count = math.ceil(share_ratio * len(mutants))

    def rank(mutant: ControllerMutant) -> bytes:
        return hashlib.sha256(f"{seed}\n{mutant.name}".encode()).digest()

    drawn = {mutant.name for mutant in sorted(mutants, key=rank)[:count]}
    return tuple(mutant for mutant in mutants if mutant.name in drawn)


def mutated_source(mutant: ControllerMutant, root: Path) -> str:
    """The changed text of the mutant's file.

    Args:
        root: folder that holds the packages.

    Raises SettingsError if the mutant no longer fits the source.
    """
    where = mutant.where
    path = root / mutant.file
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise SettingsError(
            f"{where}: file: {mutant.file}: cannot be read: {error.strerror}; "
            "write where the rule stands now, or remove the mutant with its rule"
        ) from None
    count = text.count(mutant.old)
    if count != 1:
        found = "does not occur" if count == 0 else f"occurs {count} times"
        raise SettingsError(
            f"{where}: old: {found} in {mutant.file}; copy the present text of the rule into "
            "`old` and `new`, or remove the mutant with its rule"
        )
    changed = text.replace(mutant.old, mutant.new)
    try:
        same = ast.dump(ast.parse(changed)) == ast.dump(ast.parse(text))
    except SyntaxError as error:
        line = mutant.file + f":{error.lineno}"
        raise SettingsError(f"{where}: new: no Python at {line}: {error.msg}; correct it") from None
    if same:
        raise SettingsError(f"{where}: new: changes nothing but layout; break the rule in it")
    return changed
