"""The catalogue of requirements that scenarios and monitors name."""

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

from firmware_py.settings import SettingsError

CATALOGUE: Final = "requirements.toml"
KEYS: Final = ("id", "source", "text")
MORE_KEYS: Final = ("seed", "tests")
ID: Final = re.compile(r"[A-Z][A-Z0-9]*(-[A-Z0-9]+)+")


class CatalogueError(SettingsError):
    """A catalogue that cannot be used; the text names file, entry and key."""


@dataclass(frozen=True, slots=True)
class Requirement:
    """One requirement, stated in this project's words."""

    id: str
    """Id such as `INV-04`."""
    source: str
    """Clause of the document from which it stems."""
    text: str
    seed: str = ""
    """Number of the source paper, as in docs/references.md; empty for a requirement of all of
    them."""
    tests: tuple[str, ...] = ()
    """Tests that show it, named as for pytest: file below the project, `::`, function."""


@cache
def shipped_requirements() -> Mapping[str, Requirement]:
    """The catalogue that ships, by id, in its order."""
    text = files("metro_hil.model").joinpath(CATALOGUE).read_text(encoding="utf-8")
    return parse_requirements(text, CATALOGUE)


def read_requirements(path: Path) -> Mapping[str, Requirement]:
    """Read a catalogue. Raises CatalogueError if the file is missing or wrong."""
    try:
        return parse_requirements(path.read_text(encoding="utf-8"), str(path))
    except OSError as error:
        raise CatalogueError(f"{path}: cannot be read: {error.strerror}") from error


def parse_requirements(text: str, source: str) -> Mapping[str, Requirement]:
    """Requirements by id, in the order of the text.

    Raises:
        CatalogueError: if the text is not TOML, a key is unknown or missing, a text is empty, or an
            id is invalid or repeated.
    """
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise CatalogueError(f"{source}: not TOML: {error}") from error
    unknown = sorted(set(document) - {"requirement"})
    if unknown:
        raise CatalogueError(f"{source}: unknown key {unknown[0]}; only [[requirement]] is known")
    entries = document.get("requirement", [])
    if not isinstance(entries, list) or not entries:
        raise CatalogueError(f"{source}: no [[requirement]] in it")
    catalogue: dict[str, Requirement] = {}
    for number, entry in enumerate(entries, start=1):
        requirement = _requirement(entry, f"{source}: requirement {number}")
        if requirement.id in catalogue:
            raise CatalogueError(f"{source}: requirement {number}: id {requirement.id} comes twice")
        catalogue[requirement.id] = requirement
    return catalogue


def _requirement(entry: Any, where: str) -> Requirement:
    if not isinstance(entry, dict):
        raise CatalogueError(f"{where}: not a table")
    for key in KEYS:
        value = entry.get(key)
        if not isinstance(value, str) or not value.strip():
            raise CatalogueError(f"{where}: {key} must be a text, it is {value!r}")
    known = (*KEYS, *MORE_KEYS)
    unknown = sorted(set(entry) - set(known))
    if unknown:
        raise CatalogueError(f"{where}: unknown key {unknown[0]}; known are {', '.join(known)}")
    seed, tests = entry.get("seed", ""), entry.get("tests", [])
    if not isinstance(seed, str):
        raise CatalogueError(f"{where}: seed must be a text, it is {seed!r}")
    if not isinstance(tests, list) or not all(isinstance(test, str) for test in tests):
        raise CatalogueError(f"{where}: tests must be a list of texts, it is {tests!r}")
    if not ID.fullmatch(entry["id"]):
        raise CatalogueError(f"{where}: id {entry['id']!r} is not like INV-04")
    return Requirement(entry["id"], entry["source"], entry["text"], seed, tuple(tests))
