"""Command-line arguments as text, and messages about files."""

import errno
import sys
from collections.abc import Sequence
from typing import Final

DISK_FAULTS: Final = frozenset(
    {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS, errno.EPIPE}
)
"""Errors of a disk or a pipe. Every other error of a file is about the given name."""


def words_of(program: str, argv: Sequence[str] | None) -> list[str]:
    """Return `argv`, or the arguments of this process.

    Raises:
        SystemExit: with exit code 2 and a sentence on standard error, for an argument that is not
            text. File names may be such; no report, log or configuration could name that file.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    for word in words:
        try:
            word.encode()
        except UnicodeEncodeError:
            print(f"{program}: {word!a}: not UTF-8; give that file another name", file=sys.stderr)
            raise SystemExit(2) from None
    return words


def of_file(error: OSError) -> str:
    """Describe an error by its file, if it names one, and its cause."""
    what = error.strerror or str(error)
    return what if error.filename is None else f"{error.filename}: {what}"
