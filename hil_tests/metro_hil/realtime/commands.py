"""The command lines of the processes of a case. Pure functions: nothing is looked up or started."""

import os
import shlex
import string
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Final

from metro_hil.model.case import Case, ControllerSpec
from metro_hil.model.subprocesses import plant_module, with_own_python
from metro_hil.realtime.wires import Blocked, RealtimeWires

HOST: Final = "metro_hil.external_controller.realtime"
"""Program that runs a controller of the lockstep interface in real time."""
CHECKOUT_ROOTS: Final = (".", "hil_tests", "tools")
"""Folders of a checkout that hold its packages."""


@dataclass(frozen=True, slots=True)
class CommandPlaceholders:
    """Values of the {placeholders} in the command of a controller."""

    bus: str
    tags: str
    radio: str
    line: str
    """Name of a shipped line, or a file."""
    params: str
    start: str
    end: str
    out: str
    """Folder for the controller's logs."""
    stops: str = ""
    """Names of the stops, separated by commas; empty for all stations on the way."""


@dataclass(frozen=True, slots=True)
class ControllerStart:
    """How a controller is started, the first time and again."""

    first: tuple[str, ...]
    again: tuple[str, ...]
    """Command after the controller was killed; it does not say where the train stands."""
    environment: Mapping[str, str]
    out: str = ""
    """Log folder of the project's own programs; empty for others, whose command may name one."""

    def words(self, number: int) -> tuple[str, ...]:
        """Return the command of start `number`, from 0; each start logs in its own folder."""
        words = self.again if number else self.first
        if not self.out:
            return words
        return (*words, "--out", str(again(Path(self.out), number)))


def again(out: Path, number: int) -> Path:
    """Return the log folder of start `number`, from 0."""
    return out / f"again{number}" if number else out


def controller_start(
    controller: ControllerSpec,
    places: CommandPlaceholders,
    *,
    cycle_ms: float,
    priority: int,
    nvram: Path,
    environment: Mapping[str, str],
    wakes_up: bool = False,
) -> ControllerStart:
    """Return how the controller is started.

    Raises Blocked for an unknown kind or a missing checkout.

    Args:
        wakes_up: the controller knows its position only from `nvram`.
    """
    if controller.kind == "command":
        if wakes_up:
            raise Blocked("wakes_up: a program of another kind has no memory that could be filled")
        if "{bus}" not in controller.command:
            base = _device_words(places, cycle_ms, priority)
            words = fill_in(controller.command, places)
            host = (sys.executable, "-m", HOST, *base, "--nvram", str(nvram))
            first = (*host, "--from", places.start, "--", *words)
            return ControllerStart(first, (*host, "--", *words), with_own_python(environment))
        if places.stops and "{stops}" not in controller.command:
            raise Blocked(
                "stops: the controller's command does not contain {stops}; put {stops}, here "
                f"{places.stops}, into it or leave `stops` out"
            )
        words = fill_in(controller.command, places)
        return ControllerStart(words, words, with_own_python(environment))
    if controller.kind == "checkout":
        environment = {**environment, "PYTHONPATH": _search_path(controller.path)}
    elif controller.kind != "shipped":
        raise Blocked(f"controller.kind: {controller.kind!r} is unknown to this bench")
    base = [sys.executable, "-m", "vobc", *_device_words(places, cycle_ms, priority)]
    base += ["--nvram", str(nvram)]
    first = tuple(base) if wakes_up else (*base, "--from", places.start)
    return ControllerStart(first, tuple(base), environment, out=places.out)


def _device_words(places: CommandPlaceholders, cycle_ms: float, priority: int) -> list[str]:
    """Return the options that `vobc device` and `vobc host` share."""
    words = ["--bus", places.bus, "--tags", places.tags, "--radio", places.radio]
    words += ["--line", places.line, "--consist", places.params, "--to", places.end]
    words += ["--cycle-ms", f"{cycle_ms:g}", "--priority", str(priority)]
    return [*words, "--stops", places.stops] if places.stops else words


def fill_in(command: str, places: CommandPlaceholders) -> tuple[str, ...]:
    """Split a command as a shell would, and fill in its {placeholders}.

    Placeholders are filled in after splitting, so that a path with blanks stays one word. Raises
    Blocked.
    """
    values = {field.name: str(getattr(places, field.name)) for field in fields(places)}
    try:
        words = shlex.split(command)
    except ValueError as error:
        raise Blocked(f"controller.command: {command!r}: {error}") from error
    if not words:
        raise Blocked("controller.command: empty; it names the program under test")
    return tuple(_filled(word, values) for word in words)


def _filled(word: str, values: Mapping[str, str]) -> str:
    try:
        names = [name for _, name, _, _ in string.Formatter().parse(word) if name is not None]
    except ValueError as error:
        raise Blocked(f"controller.command: {word!r}: {error}") from error
    for name in names:
        if name not in values:
            known = ", ".join(f"{{{known}}}" for known in values)
            raise Blocked(f"controller.command: {{{name}}}: unknown placeholder; known are {known}")
    return word.format(**values)


def _search_path(checkout: str) -> str:
    root = Path(checkout)
    if not (root / "vobc").is_dir():
        raise Blocked(f"controller.path: {checkout}: is not a checkout: it has no folder vobc")
    return os.pathsep.join(str((root / part).resolve()) for part in CHECKOUT_ROOTS)


def plant_words(
    case: Case,
    *,
    bus: str,
    wires: RealtimeWires,
    radio: str,
    line: str,
    consist: str,
    faults: Path,
    feed: Path,
    out: Path,
    stations: tuple[str, str],
    parent: int,
    recording: str | None = None,
) -> list[str]:
    """Return the command that starts the emulated train."""
    setup = case.setup
    words = [sys.executable, "-m", *plant_module(case.plant), "run", "--bus", bus, "--line", line]
    words += ["--consist", consist, "--seed", str(case.seed), "--desk", setup.desk_mode]
    if setup.driver is not None:
        words += ["--driver", setup.driver]
    if recording is not None:
        words += ["--desk-recording", recording]
    words += ["--from", stations[0], "--to", stations[1], "--tags", wires.tags, "--radio", radio]
    words += ["--faults", str(faults), "--truth-feed", str(feed), "--out", str(out)]
    words += ["--priority", str(wires.plant_priority), "--parent", str(parent)]
    if setup.load_ratio is not None:
        words += ["--load-ratio", str(setup.load_ratio)]
    if setup.odometer_error is not None:
        words += ["--odometer-error", str(setup.odometer_error)]
    return words


def gateway_words(
    *,
    segments: Sequence[str],
    faults: Path,
    seed: int,
    control: Path,
    out: Path,
    priority: int,
    parent: int,
) -> list[str]:
    """Return the command of the gateway between the controller's and the train's segment."""
    a, b = segments
    words = [sys.executable, "-m", "metro_hil.realtime.gateway", "--a", a, "--b", b]
    words += ["--faults", str(faults), "--seed", str(seed), "--feed", str(control)]
    words += ["--out", str(out), "--priority", str(priority), "--parent", str(parent)]
    return words
