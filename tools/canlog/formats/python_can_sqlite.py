"""SQLite databases in the format of python-can's SqliteWriter."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from canlog.damage import Damages, LogError
from canlog.formats.python_can_csv import add_message
from canlog.frames import ERROR, EXTENDED, REMOTE, Frames
from canlog.options import ReadOptions
from canlog.rows import Rows

COLUMNS: Final = ("ts", "arbitration_id", "extended", "remote", "error", "dlc", "data")


def read(path: Path, options: ReadOptions, damages: Damages) -> Iterator[Frames]:
    """Yield the frames of the table `messages`, all on channel `can0`.

    Raises:
        LogError: for a database that cannot be read or has no such table.
    """
    import sqlite3

    rows = Rows()
    try:
        with sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True) as base:
            names = {each[1] for each in base.execute("PRAGMA table_info(messages)")}
            if not names >= set(COLUMNS):
                raise LogError(f"{path}: an SQLite database without python-can's table `messages`")
            asked = f"SELECT {', '.join(COLUMNS)} FROM messages"  # noqa: S608
            for number, row in enumerate(base.execute(asked), 1):
                if _take(row, rows) is not None:
                    damages.add("broken row", "row", number, f"{row!r:.60}")
                if len(rows) >= options.block_frames:
                    yield rows.take()
        base.close()
    except sqlite3.Error as error:
        if not len(rows):
            raise LogError(f"{path}: no usable SQLite database: {error}") from error
        damages.add("broken database", "row", None, str(error))
    if len(rows):
        yield rows.take()


def _take(row: tuple[Any, ...], rows: Rows) -> str | None:
    stamp, identifier, extended, remote, error, length, data = row
    try:
        at_ns = round(float(stamp) * 1e9)
        flags = EXTENDED * bool(extended) | REMOTE * bool(remote) | ERROR * bool(error)
        number, size = int(identifier), int(length)
        content = bytes(data or b"") if not isinstance(data, str) else data.encode("latin-1")
    except (TypeError, ValueError, OverflowError):
        return "broken"
    if number < 0:
        return "broken"
    return add_message(rows, at_ns, number, flags, size, content)
