"""The programs of a line that is brought up by hand, and the command of each. Pure."""

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import msgspec

from metro_hil.line.exercise.plan import PlannedRun

WAYSIDE: Final = "wayside"
BUS: Final = "bus"
PLANT: Final = "plant"
CONTROLLER: Final = "controller"
TRAIN: Final = "train"
"""Program with controller, train and bus of a train that makes the trips of a service."""
BEFORE: Final = 5
"""Real-time priority of the wayside above that of controllers, which all wait for it."""
BEHIND: Final = 10
"""Real-time priority of plants below that of controllers; plants may be a little late."""
PRIORITY_MAX: Final = 99
DIGEST_CHARS: Final = 6
"""Length of the part of a bus name that keeps two lines apart; a bus name has 15 characters."""


class LineProgram(msgspec.Struct, frozen=True):
    """One program of the line. Its name is also the path of its files below the run folder."""

    name: str
    module: str
    arguments: list[str]
    logs: bool = False
    """Whether the program takes --out; each start then gets a folder of its own."""


class LineSetup(msgspec.Struct, frozen=True):
    """What the user asked for."""

    line: str
    """Name or file."""
    endpoint: str
    timers: str
    arbiters: int
    priority: int
    ways: list[PlannedRun]
    """Run of each train, the foremost first."""
    secure: str | None = None
    insecure: bool = False
    attended: list[int] = []
    """Trains whose desk is a `plant desk` of its own."""
    service: str | None = None
    """File of the service of trains on a network; there are then no `ways`."""
    routes: list[str] = []
    """Routes of the network over which the service runs."""
    trains: int = 0
    """Number of trains of the service."""


class LineUp(msgspec.Struct, frozen=True):
    """Content of the file by which `down`, `status` and `restart` find the programs."""

    line_name: str
    endpoint: str
    programs: list[LineProgram]
    """In the order of their start."""


def programs_of(setup: LineSetup, folder: Path) -> list[LineProgram]:
    """Return all programs of a line in the order of their start."""
    secure = [] if setup.secure is None else ["--secure", setup.secure]
    secure += ["--insecure"] if setup.insecure else []
    of_line = ["--line-timers", setup.timers, "--arbiters", str(setup.arbiters), *secure]
    common = ["--line", setup.line, "--line-radio", setup.endpoint]
    before = min(PRIORITY_MAX, setup.priority + BEFORE) if setup.priority else 0
    wayside = ["wayside", *common, *of_line, "--memory", str(folder / WAYSIDE)]
    wayside += ["--priority", str(before)]
    wayside += ["--routes", ",".join(setup.routes)] if setup.routes else []
    programs = [
        LineProgram(name, "plant_emulator", [*wayside, "--part", name])
        for name in wayside_parts(setup.arbiters)
    ]
    if setup.service is not None:
        trains = range(1, setup.trains + 1)
        return programs + [_networked(setup, [*of_line], train) for train in trains]
    numbered = list(enumerate(setup.ways, start=1))
    for train, _ in numbered:
        name = bus_name(folder, train)
        programs.append(LineProgram(f"T{train}/{BUS}", "firmware_py.buses.hub", [name]))
    for train, way in numbered:
        words = ["run", *common, *_place(folder, train, way), "--seed", str(train), *secure]
        words += ["--priority", str(max(0, setup.priority - BEHIND))]
        words += ["--desk", "external"] if train in setup.attended else []
        programs.append(LineProgram(f"T{train}/{PLANT}", "plant_emulator", words, logs=True))
    for train, way in numbered:
        # The memory overrides --from, so that a restarted controller takes the same command.
        words = ["device", *common, *_place(folder, train, way), *of_line]
        words += ["--nvram", str(folder / f"T{train}" / "nvram")]
        words += ["--line-memory", str(folder / f"T{train}" / "terms")]
        words += ["--priority", str(setup.priority)]
        programs.append(LineProgram(f"T{train}/{CONTROLLER}", "vobc", words, logs=True))
    return programs


def _networked(setup: LineSetup, of_line: list[str], train: int) -> LineProgram:
    """The program of a train that makes the trips of a service."""
    words = ["run", "--train", str(train), "--service", str(setup.service)]
    words += ["--trains", str(setup.trains), "--line-radio", setup.endpoint]
    words += [*of_line, "--priority", str(setup.priority)]
    return LineProgram(f"T{train}/{TRAIN}", "metro_hil.cli.vobc", words, logs=True)


def wayside_parts(arbiters: int) -> list[str]:
    """Return the part of each program of the wayside."""
    return ["router", *[f"arbiter{n}" for n in range(1, arbiters + 1)], "track"]


def _place(folder: Path, train: int, way: PlannedRun) -> list[str]:
    bus = f"embedded:{bus_name(folder, train)}"
    return ["--bus", bus, "--train", str(train), "--from", way.start, "--to", way.end]


def bus_name(folder: Path, train: int) -> str:
    """Return the name of a train's bus. Two lines on one machine never share it."""
    digest = hashlib.sha256(str(folder).encode()).hexdigest()[:DIGEST_CHARS]
    return f"{digest}-T{train}"


def chosen(programs: Sequence[LineProgram], name: str) -> LineProgram | None:
    """Return the program of that name; a train's name means its controller, or all of it."""
    wanted = (name, f"{name}/{CONTROLLER}", f"{name}/{TRAIN}")
    return next((each for each in programs if each.name in wanted), None)
