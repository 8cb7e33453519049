"""The programs keep their asserts: they are the last check on what we did wrong ourselves."""

import sys


def require_assertions(program: str) -> None:
    """End the program if Python was started so that it leaves asserts out (-O, PYTHONOPTIMIZE).

    Raises:
        SystemExit: with exit code 2 and a sentence on standard error.
    """
    if not __debug__:
        print(
            f"{program}: will not run under `python -O` or PYTHONOPTIMIZE: its checks are asserts",
            file=sys.stderr,
        )
        raise SystemExit(2)
