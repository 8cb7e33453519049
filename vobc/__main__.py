"""Entry point of the bare controller, `python -m vobc`."""

import sys

from firmware_py.program import TYPE_CHECKING, Program

if TYPE_CHECKING:
    from collections.abc import Callable


def _controller() -> "Callable[[], int]":
    from vobc.cli import main

    return main


sys.exit(Program("vobc", _controller)())
