"""Runs one program many times under adverse conditions, in forks of a process that has loaded it.

python -m hil_tests.contract.ends_driver MODULE:NAME

Standard input holds a JSON list of `[condition, arguments]`. Standard output gets the list of
`[exit code, lines of standard error]`.
"""

import argparse
import contextlib
import importlib
import io
import json
import os
import signal
import sys
import tempfile
from collections.abc import Callable, Sequence
from typing import Any, Final

from firmware_py.program import Program


def _interrupted(*_: Any) -> None:
    os.kill(os.getpid(), signal.SIGINT)
    signal.pause()


def _interrupt() -> None:
    """Raise Ctrl-C as soon as the command parses its options."""
    setattr(argparse.ArgumentParser, "parse_args", _interrupted)  # noqa: B010 # a method, on purpose


def _full() -> None:
    os.dup2(os.open("/dev/full", os.O_WRONLY), 1)


def _left() -> None:
    """The reader, such as `head -1`, has closed the pipe."""
    reader, writer = os.pipe()
    os.close(reader)
    os.dup2(writer, 1)


def _closed() -> None:
    os.close(1)
    _replace(None)


def _ascii() -> None:
    """The terminal accepts only ASCII."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    stream = io.TextIOWrapper(open(1, "wb", closefd=False), encoding="ascii")  # noqa: SIM115
    _replace(stream)


def _replace(stream: io.TextIOWrapper | None) -> None:
    """Replace standard output as if Python had started with this stream."""
    for name in ("stdout", "__stdout__"):
        setattr(sys, name, stream)


def _plain() -> None:
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)


CONDITIONS: Final[dict[str, Callable[[], None]]] = {
    "plain": _plain,
    "interrupt": _interrupt,
    "full": _full,
    "left": _left,
    "closed": _closed,
    "ascii": _ascii,
}


def tried(program: Program, condition: str, words: Sequence[str]) -> tuple[int, list[str]]:
    with tempfile.TemporaryFile() as errors:
        child = os.fork()
        if child == 0:
            sys.argv = [program.name, *words]
            os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
            os.dup2(errors.fileno(), 2)
            CONDITIONS[condition]()
            try:
                os._exit(program())
            except BaseException:
                sys.excepthook(*sys.exc_info())
            os._exit(1)
        _, status = os.waitpid(child, 0)
        errors.seek(0)
        lines = errors.read().decode().splitlines()
    return os.waitstatus_to_exitcode(status), lines


def main() -> None:
    module, _, name = sys.argv[1].partition(":")
    program: Program = getattr(importlib.import_module(module), name)
    asked = json.load(sys.stdin)
    # Modules that a command imports late are loaded here once, not in each of its forks.
    for words in (words for condition, words in asked if condition == "plain"):
        sys.argv = [program.name, *words]
        with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
            program.load()()
    print(json.dumps([tried(program, condition, words) for condition, words in asked]))


if __name__ == "__main__":
    main()
