"""The console script `canlog`."""

from firmware_py.program import TYPE_CHECKING, Program

if TYPE_CHECKING:
    from collections.abc import Callable


def _canlog() -> "Callable[[], int]":
    from canlog.command import main

    return main


canlog = Program("canlog", _canlog)
