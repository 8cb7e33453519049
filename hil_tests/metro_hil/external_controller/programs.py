"""Which program a case puts under test, as command and environment."""

import os
import shlex
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import firmware_py
from metro_hil.external_controller.link import ControllerProgram, ControllerStartError
from metro_hil.model.case import ControllerSpec

CHECKOUT_ROOTS: Final = (".", "hil_tests", "tools")
"""Where the packages of a checkout lie."""


def program_of(
    controller: ControllerSpec, words: Mapping[str, str] | None = None
) -> ControllerProgram:
    """Raises ControllerStartError for what cannot be a controller in virtual time.

    Args:
        words: what other {names} in a command stand for.
    """
    if controller.kind == "shipped":
        return _ours(Path(firmware_py.__file__).resolve().parent.parent)
    if controller.kind == "checkout":
        return _ours(Path(controller.path))
    if controller.kind == "command":
        return ControllerProgram(_command(controller.command, words or {}), dict(os.environ))
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
    """Split as a shell would, without one; names are filled in after, so blanks in them are safe.

    {grant} is left for the link, which makes the socket; without it the program is spoken to by its
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
