"""The words that a program was called with."""

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
        if any("\ud800" <= letter <= "\udfff" for letter in word):
            print(f"{program}: {word!a}: not UTF-8; give that file another name", file=sys.stderr)
            raise SystemExit(2)
    return words
