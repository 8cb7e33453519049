"""Becomes another program in its own network namespace.

`python -m metro_hil.line.network.isolated_process MODULE WORDS ...` creates a new one. With `--join
FILE` before the module it joins the namespace of that file.
"""

import os
import sys
from collections.abc import Sequence
from typing import Final, NoReturn

from metro_hil.line.network.namespaces import REFUSED, NamespaceError, join, own_network

JOIN: Final = "--join"
MODULE: Final = "metro_hil.line.network.isolated_process"


def words_in(namespace: str, module: str) -> tuple[str, list[str]]:
    """Return module and first arguments that run a module in a namespace."""
    return MODULE, [JOIN, namespace, module]


def become_apart(module: str, words: Sequence[str]) -> NoReturn:
    """Continue this process as `python -m module words` in a new network."""
    sys.stdout.flush()
    _become([MODULE, module, *words])


def main(argv: Sequence[str] | None = None) -> NoReturn:
    """Become the program; returns only by an exit if the system refuses."""
    words = [*(sys.argv[1:] if argv is None else argv)]
    try:
        if words[0] == JOIN:
            join(words[1])
            del words[:2]
        else:
            own_network()
    except NamespaceError as error:
        # Import only now: the module starts threads, and a process with threads is refused.
        from metro_hil.model.run_options import EXIT_ENVIRONMENT

        print(f"{REFUSED}: {error}", file=sys.stderr)
        sys.exit(EXIT_ENVIRONMENT)
    _become(words)


def _become(words: Sequence[str]) -> NoReturn:
    program = sys.executable
    os.execv(program, [program, "-m", *words])  # noqa: S606 # ourselves


if __name__ == "__main__":
    main()
