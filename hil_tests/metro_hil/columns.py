"""Reads the CSV logs of a run folder into columns."""

import csv
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt

Numbers = npt.NDArray[np.float64]


class LogError(Exception):
    """A log that cannot be used; the text names file and column."""


class Columns:
    """The columns of one log, by name. Rows that a killed run left torn are counted, not used."""

    def __init__(self, source: str, texts: Mapping[str, list[str]], torn_rows: int) -> None:
        self._source = source
        self._texts = texts
        self.torn_rows = torn_rows

    def __len__(self) -> int:
        return len(next(iter(self._texts.values()), []))

    def texts(self, name: str) -> list[str]:
        if name not in self._texts:
            raise LogError(f"{self._source}: no column {name}; it has {', '.join(self._texts)}")
        return self._texts[name]

    def numbers(self, name: str) -> Numbers:
        """Shape (n_rows,); an empty field is NaN."""
        try:
            return np.array([float(text) if text else np.nan for text in self.texts(name)])
        except ValueError as error:
            raise LogError(f"{self._source}: column {name}: {error}") from error


def read_columns(path: Path) -> Columns:
    """Raises LogError when the file is missing or has no header."""
    try:
        with path.open(newline="", encoding="utf-8") as lines:
            rows = csv.reader(lines)
            header = next(rows, None)
            if not header:
                raise LogError(f"{path}: empty, not even a header")
            body = list(rows)
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror}") from error
    whole = [row for row in body if len(row) == len(header)]
    texts = {name: [row[index] for row in whole] for index, name in enumerate(header)}
    return Columns(str(path), texts, len(body) - len(whole))
