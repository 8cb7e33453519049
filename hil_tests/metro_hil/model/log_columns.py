"""Reads the CSV logs of a run folder into columns."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Numbers = npt.NDArray[np.float64]


class RunLogError(Exception):
    """A log that cannot be used; the text names file and column."""


class Columns:
    """The columns of one log, by name. Torn rows of a killed run are counted, not used."""

    def __init__(self, source: str, values: Mapping[str, Sequence[object]], torn_rows: int) -> None:
        self._source = source
        self._values = values
        self._numbers: dict[str, Numbers] = {}
        """Cache of converted columns, which are read-only."""
        self.torn_rows = torn_rows

    @classmethod
    def of_rows(
        cls, source: str, names: Sequence[str], rows: Sequence[Sequence[object]]
    ) -> "Columns":
        """Make columns from rows of values, as a log would hold them."""
        columns = list(zip(*rows, strict=True)) if rows else [()] * len(names)
        return cls(source, dict(zip(names, columns, strict=True)), 0)

    def __len__(self) -> int:
        return len(next(iter(self._values.values()), ()))

    def _column(self, name: str) -> Sequence[object]:
        if name not in self._values:
            raise RunLogError(f"{self._source}: no column {name}; it has {', '.join(self._values)}")
        return self._values[name]

    def texts(self, name: str) -> list[str]:
        return [str(value) for value in self._column(name)]

    def flags(self, name: str) -> list[bool]:
        return [value in (True, "1") for value in self._column(name)]

    def numbers(self, name: str) -> Numbers:
        """A column as read-only array of shape (n_rows,); an empty field is NaN."""
        known = self._numbers.get(name)
        if known is not None:
            return known
        column: Sequence[Any] = self._column(name)
        if "" in column:
            column = [np.nan if value == "" else value for value in column]
        try:
            numbers = np.array(column, np.float64)
        except (TypeError, ValueError) as error:
            raise RunLogError(f"{self._source}: column {name}: {error}") from error
        numbers.flags.writeable = False
        self._numbers[name] = numbers
        return numbers

    def has(self, name: str) -> bool:
        """Whether the column exists; logs of other versions may lack some."""
        return name in self._values

    def vectors(self, name: str) -> Numbers:
        """A column with several numbers in a field, as array of shape (n_rows, n_numbers).

        Raises RunLogError if the rows differ in their number of values.
        """
        rows = [value.split() if isinstance(value, str) else value for value in self._column(name)]
        try:
            table = np.array(rows, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise RunLogError(f"{self._source}: column {name}: {error}") from error
        return table.reshape(len(rows), -1)


def read_columns(path: Path) -> Columns:
    """Read a log. Raises RunLogError if the file is missing or has no header."""
    try:
        with path.open(newline="", encoding="utf-8") as lines:
            rows = csv.reader(lines)
            header = next(rows, None)
            if not header:
                raise RunLogError(f"{path}: empty, not even a header")
            body = list(rows)
    except OSError as error:
        raise RunLogError(f"{path}: cannot be read: {error.strerror}") from error
    whole = [row for row in body if len(row) == len(header)]
    texts = {name: [row[index] for row in whole] for index, name in enumerate(header)}
    return Columns(str(path), texts, len(body) - len(whole))
