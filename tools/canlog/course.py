"""Courses to search for: a sketch, a signal of the log, or a column of a CSV file."""

import csv
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from canlog.damage import LogError
from canlog.formats.text import decoded
from canlog.frames import Ints
from canlog.reader import Log
from canlog.run import NS_PER_S
from canlog.views.span import zero_of
from canlog.views.traces import Floats, find_names, trace_of

POINT: Final = re.compile(r"([^\s,;:]+):([^\s,;:]+)")
SKETCH: Final = re.compile(r"[-+.:,;\s\deE]+")
EPOCH_FROM_S: Final = 1e8
"""Instants from this value on count from 1970; no log is three years long."""
STAMP_MAX_S: Final = 9e9


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceCourse:
    """A quantity over time."""

    name: str
    at_ns: Ints
    """(n,) instants, rising or equal; two equal ones are a step."""
    values: Floats
    """(n,) values at these instants; straight lines join them."""

    def at(self, instants_ns: Ints) -> Floats:
        """(m,) values at other instants."""
        start_ns = self.at_ns[0]
        # Counted from the start, float64 holds every nanosecond.
        found: Floats = np.interp(instants_ns - start_ns, self.at_ns - start_ns, self.values)
        return found


def course_of(log: Log, text: str, column: str | None = None) -> ReferenceCourse:
    """Return the course of a sketch, a CSV file, or a signal of the log, in this order.

    Args:
        text: `0:0 10:50 20:0` for value 0 at 0 s, 50 at 10 s and 0 at 20 s since the log began; the
            path of a CSV file; or a name as in `canlog plot`.
        column: column of the CSV file; the second by default.

    Raises:
        LogError: says what is wrong with the text, the file, or a course that never changes.
    """
    if not text.strip():
        raise LogError("--like: give a sketch such as '0:0 10:50', a CSV file or a signal")
    if SKETCH.fullmatch(text) and ":" in text:
        points = _sketched(text)
    elif Path(text).is_file():
        points = _of_csv(Path(text), column)
    elif "/" in text or text.lower().endswith(".csv"):
        raise LogError(f"{text}: there is no such file")
    else:
        names = find_names(log, text)
        if len(names) != 1:
            raise LogError(f"--like {text}: names {len(names)} signals; name one")
        trace = trace_of(log, names[0])
        return _checked(ReferenceCourse(names[0], trace.at_ns, trace.values))
    seconds, values = np.array(points, np.float64).T
    zero_ns = 0 if abs(seconds[0]) >= EPOCH_FROM_S else zero_of(log)
    return _checked(
        ReferenceCourse(text, zero_ns + np.rint(seconds * NS_PER_S).astype(np.int64), values)
    )


def _checked(course: ReferenceCourse) -> ReferenceCourse:
    there = np.isfinite(course.values)
    at_ns, values = course.at_ns[there], course.values[there]
    if len(values) < 2 or values.min() == values.max():
        raise LogError(f"--like {course.name}: the course never changes; nothing can follow it")
    if (np.diff(at_ns) < 0).any():
        raise LogError(f"--like {course.name}: its instants run backwards")
    return ReferenceCourse(course.name, at_ns, values)


def _sketched(text: str) -> list[tuple[float, float]]:
    words = [word for word in re.split(r"[\s,;]+", text) if word]
    points = []
    for word in words:
        match = POINT.fullmatch(word)
        point = _numbers(match.groups()) if match else None
        if point is None:
            raise LogError(f"--like {word}: a point of a sketch is SECONDS:VALUE, as in 10:50")
        points.append(point)
    return points


def _numbers(texts: Any) -> tuple[float, float] | None:
    try:
        second, value = (float(text) for text in texts)
    except ValueError:
        return None
    return (second, value) if abs(second) <= STAMP_MAX_S else None


def _of_csv(path: Path, column: str | None) -> list[tuple[float, float]]:
    """Return instant and value of each row; a head of names and rows without a value may be there.

    The columns are separated by commas, semicolons or tabs; with the latter two, a comma may be the
    decimal sign.
    """
    try:
        lines = decoded(path.read_bytes()).splitlines()
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror}") from error
    sign = next((sign for sign in ";\t" if lines and sign in lines[0]), ",")
    rows = [row for row in csv.reader(lines, delimiter=sign) if row]
    names = [name.strip() for name in rows[0]] if rows else []
    at = 1
    if column is not None:
        if column not in names:
            raise LogError(f"{path}: has no column {column}; it has {', '.join(names)}")
        at = names.index(column)
    found = []
    for row in rows:
        cells = (row[0], row[at]) if len(row) > at else ("", "")
        point = _numbers(cell if sign == "," else cell.replace(",", ".") for cell in cells)
        if point is not None:
            found.append(point)
    if len(found) < 2:
        raise LogError(f"{path}: has no two rows of seconds and a value, separated by {sign!r}")
    return found
