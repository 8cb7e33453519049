"""Collects every problem of a campaign file, one line each."""

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from firmware_py.settings import SettingsError

T = TypeVar("T")


class CampaignError(SettingsError):
    """A campaign that cannot be used; its text holds all problems, one a line."""

    def __init__(self, problems: tuple[str, ...]) -> None:
        super().__init__("\n".join(problems))

    @property
    def problems(self) -> tuple[str, ...]:
        """Texts that each name file, key and value."""
        return tuple(str(self).split("\n"))


class Findings:
    """Problems found so far, with keys of the scenario including all that it inherits."""

    def __init__(self) -> None:
        self.found: list[tuple[str, str]] = []
        """Key and text of each problem, without repetition, in the order of finding."""

    def add(self, key: str, what: str) -> None:
        if (key, what) not in self.found:
            self.found.append((key, what))

    def add_text(self, text: str, key: str, names: Mapping[str, Any] | tuple[str, ...]) -> None:
        """Add a message of the form `KEY.NAME: WHAT`, or `KEY: NAME VALUE is …` as of
        dataclasses."""
        text = text.removeprefix(": ")
        rest = text.removeprefix(f"{key}: ")
        name = next((name for name in names if rest.startswith(f"{name} ")), None)
        if name is not None and (rest != text or not key):
            self.add(_join(key, name), rest[len(name) + 1 :])
            return
        where, _, what = text.partition(": ")
        self.add(where, what) if what else self.add(key, text)

    def __bool__(self) -> bool:
        return bool(self.found)


def attempt(
    make: Callable[[dict[str, Any]], T], table: Mapping[str, Any], key: str, findings: Findings
) -> T | None:
    """Make a value from a table; None if anything is wrong, all of which is reported."""
    made, rest = salvage(make, table, key, findings)
    return made if len(rest) == len(table) else None


def salvage(
    make: Callable[[dict[str, Any]], T], table: Mapping[str, Any], key: str, findings: Findings
) -> tuple[T | None, dict[str, Any]]:
    """Make a value from the valid entries of a table; return it with those entries.

    `make` raises SettingsError for the first error, without a source and below `key`. This function
    removes the entry that the error names and calls `make` again, until no error is left.
    """
    rest = dict(table)
    set_aside: list[str] = []
    while True:
        try:
            return make(rest), rest
        except SettingsError as error:
            text = str(error)
            name = offender(text, key, rest)
            if name is None and set_aside:
                # The error may come from the removed entry.
                return None, rest
            findings.add_text(text, key, rest)
            if name is None:
                # An empty table, so that the caller does not treat the table as valid.
                return None, {}
            del rest[name]
            set_aside.append(name)


def offender(text: str, key: str, table: Mapping[str, Any]) -> str | None:
    """The entry of the table that a message names, if any."""
    rest = text.removeprefix(": ")
    if not rest.startswith(key):
        return None
    rest = rest[len(key) :].lstrip(".: ")
    path = rest.partition(": ")[0]
    named = [name for name in table if rest.startswith(name) or name.startswith(f"{path}.")]
    return max(named, key=len, default=None)


def _join(key: str, name: str) -> str:
    return f"{key}.{name}" if key else name
