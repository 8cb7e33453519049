"""Command and environment of the controller that a case puts under test."""

import os
import shlex
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import firmware_py
from metro_hil.external_controller.link import ControllerProgram, ControllerStartError
from metro_hil.model.case import ControllerSpec
from metro_hil.model.subprocesses import with_own_python

CHECKOUT_ROOTS: Final = (".", "hil_tests", "tools")
"""Folders of a checkout that hold packages."""


def program_of(
    controller: ControllerSpec, words: Mapping[str, str] | None = None
) -> ControllerProgram:
    """The program of a controller. Raises ControllerStartError for an impossible one.

    Args:
        words: values of further {names} in a command.
    """
    if controller.kind == "shipped":
        return _ours(Path(firmware_py.__file__).resolve().parent.parent)
    if controller.kind == "checkout":
        return _ours(Path(controller.path))
    if controller.kind == "command":
        command = _command(controller.command, words or {})
        return ControllerProgram(command, with_own_python(os.environ))
    raise ControllerStartError(
        f"controller.kind: {controller.kind!r}: shipped, checkout or command is needed"
    )


def _ours(root: Path) -> ControllerProgram:
    if not (root / "vobc").is_dir():
        raise ControllerStartError(
            f"controller.path: {root}: no checkout, there is no folder vobc in it"
        )
    path = os.pathsep.join(str((root / part).resolve()) for part in CHECKOUT_ROOTS)
    environment = {**os.environ, "PYTHONPATH": path, "PYTHONSAFEPATH": "1"}
    words = (sys.executable, "-m", "vobc", "grant", "--parent", str(os.getpid()))
    return ControllerProgram(words, environment)


def _command(command: str, known: Mapping[str, str]) -> tuple[str, ...]:
    """Split the command like a shell, then fill in the names, so that blanks in values are safe.

    {grant} stays for the link, which makes the socket. Without it, the bench uses the program's
    standard input and output.
    """
    try:
        words = shlex.split(command)
    except ValueError as error:
        raise ControllerStartError(f"controller.command: {command!r}: {error}") from error
    if not words:
        raise ControllerStartError("controller.command: empty; it names the program under test")
    filled = {f"{{{name}}}": value for name, value in known.items()}
    return tuple(_filled(word, filled) for word in words)


def _filled(word: str, filled: Mapping[str, str]) -> str:
    for name, value in filled.items():
        word = word.replace(name, value)
    return word
