"""Common parts of the document generators: tables and command line."""

import argparse
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Final

from firmware_py.storage.whole_file import write_whole

EXIT_OK: Final = 0
EXIT_OUTDATED: Final = 1
EXIT_USAGE: Final = 2


def markdown_table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Format a table in Markdown."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def write_or_check(
    argv: Sequence[str] | None,
    *,
    module: str,
    description: str | None,
    default_path: str,
    document: Callable[[], str],
) -> int:
    """Write the document, or with --check only report whether it is current; returns the exit code.

    Args:
        module: the module that `python -m` runs.
        document: creates the text.
    """
    parser = argparse.ArgumentParser(prog=f"python -m {module}", description=description)
    parser.add_argument("path", nargs="?", default=default_path, help="default: %(default)s")
    parser.add_argument("--check", action="store_true", help="write nothing; exit 1 if outdated")
    options = parser.parse_args(argv)
    path, text = Path(options.path), document()
    try:
        if not options.check:
            write_whole(path, text)
        elif path.read_text(encoding="utf-8") != text:
            print(f"{path}: outdated; run python -m {module}", file=sys.stderr)
            return EXIT_OUTDATED
    except OSError as error:
        print(f"{path}: {error.strerror}", file=sys.stderr)
        return EXIT_USAGE
    return EXIT_OK
