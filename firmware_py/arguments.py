"""The words that a program was called with, and what it says of files that they name."""

import sys
from collections.abc import Sequence


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
    """What to say of a file that the user named, or that is below a folder that they named.

    Raises `error` again when it is of no file: that is nothing that the user did.
    """
    if error.filename is None:
        raise error
    return f"{error.filename}: {error.strerror}"
