"""The words that a program was called with, and what it says of files that they name."""

import errno
import sys
from collections.abc import Sequence
from typing import Final

DISK_FAULTS: Final = frozenset(
    {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS, errno.EPIPE}
)
"""What a disk or a pipe refuses. Every other error of a file is about the name that was given."""


def words_of(program: str, argv: Sequence[str] | None) -> list[str]:
    """`argv`, or those of this process.

    Raises:
        SystemExit: with exit code 2 and a sentence on standard error, for a word that is no text,
            as the name of a file may be: no report, log or configuration could name it.
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
    """The file, if the error names one, and what the system refused."""
    what = error.strerror or str(error)
    return what if error.filename is None else f"{error.filename}: {what}"
