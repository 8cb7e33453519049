"""Reads the lines that another program appends to a file."""

from collections.abc import Sequence
from pathlib import Path


class GrowingFile:
    """A text file that another program appends to, one whole line at a time."""

    def __init__(self, path: Path) -> None:
        """Open the file, which is made if it is missing. Raises OSError."""
        path.touch()
        self._file = path.open("rb")
        self._rest = b""

    def lines(self) -> Sequence[str]:
        """Return the whole lines that were appended since the last call; it never waits."""
        text = self._file.read()
        if not text:
            return ()
        *whole, self._rest = (self._rest + text).split(b"\n")
        return [line.decode(errors="replace").strip() for line in whole]

    def close(self) -> None:
        self._file.close()
