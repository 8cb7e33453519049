"""Ensures that the programs run with asserts, which are the last check for programming errors."""

import sys


def require_assertions(program: str) -> None:
    """End the program if Python was started without asserts (-O, PYTHONOPTIMIZE).

    Raises:
        SystemExit: with exit code 2 and a sentence on standard error.
    """
    if not __debug__:
        print(
            f"{program}: will not run under `python -O` or PYTHONOPTIMIZE: its checks are asserts",
            file=sys.stderr,
        )
        raise SystemExit(2)
