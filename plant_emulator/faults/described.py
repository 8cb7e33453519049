"""The catalogue of faults as text: parameters with units and ranges, and how each bench applies
them.
"""

import ast
import dataclasses
import enum
import functools
import inspect
import sys
import types
import typing
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

from plant_emulator.faults import declared  # noqa: F401  # enters all kinds into the catalogue
from plant_emulator.faults.kinds import CATALOGUE, FaultPlace, Kind

UNITS: Final[Mapping[str, str]] = {
    "bytes_per_s": "bytes/s",
    "ratio_per_s": "1/s",
    "pulses_per_s": "pulses/s",
    "mps2": "m/s²",
    "ma": "mA",
    "mps": "m/s",
    "percent": "%",
    "s": "s",
    "m": "m",
    "v": "V",
    "ratio": "1",
}
"""Unit by the suffix of a parameter's name; longer suffixes come first."""
RANGE_CHECK: Final = "check_range"

PLACE_TITLES: Final[Mapping[FaultPlace, str]] = {
    FaultPlace.BUS: "Bus",
    FaultPlace.SENSOR: "Sensors",
    FaultPlace.SERIAL: "Tag reader's line",
    FaultPlace.ACTUATOR: "Actuators",
    FaultPlace.SUPPLY: "Supply",
    FaultPlace.DOORS: "Doors",
    FaultPlace.DESK: "Desk",
    FaultPlace.RADIO: "Radio",
    FaultPlace.WAYSIDE: "Wayside",
    FaultPlace.ALARMS: "Alarms",
    FaultPlace.PROCESS: "Controller's process",
}


@dataclass(frozen=True, slots=True)
class Benches:
    """How a fault is applied on each kind of bench."""

    lockstep: str
    processes: str
    hardware: str


_GATEWAY: Final = "a gateway between the controller's bus and the train's"
_TRAIN: Final = Benches(
    "in the emulated train",
    "in the emulated train, a process of its own",
    "in the emulated train, which is connected to the real wires",
)
_SIGNALS: Final = "signals to the controller's process"
_FOREIGN: Final = "impossible for a controller that the bench did not start"
_FRAMES: Final = Benches("between the controller's port and the bus", _GATEWAY, _GATEWAY)
_BLOCKED: Final = "the gateway passes nothing that the node sends or acts on"

BY_PLACE: Final[Mapping[FaultPlace, Benches]] = {
    **dict.fromkeys((FaultPlace.SENSOR, FaultPlace.ACTUATOR, FaultPlace.SUPPLY), _TRAIN),
    **dict.fromkeys((FaultPlace.DOORS, FaultPlace.DESK, FaultPlace.ALARMS), _TRAIN),
    FaultPlace.BUS: _FRAMES,
    FaultPlace.SERIAL: Benches(
        "at the reader's end of the line",
        "at the reader's end of the pseudo-terminal",
        "at the reader's end of the real line",
    ),
    FaultPlace.RADIO: Benches(
        "at the wayside's radio", "at the wayside's radio session", "at the wayside's radio session"
    ),
    FaultPlace.WAYSIDE: Benches(
        "in the emulated wayside",
        "in the emulated wayside, which is in the train's process",
        "in the emulated wayside, which is connected to the real radio",
    ),
    FaultPlace.PROCESS: Benches("to the modelled process", _SIGNALS, f"{_SIGNALS}; {_FOREIGN}"),
}
BY_KIND: Final[Mapping[str, Benches]] = {
    "frame_corrupt": Benches(
        "on_wire: error frames and error counters of all nodes on the bus, each attempt costs its"
        " bits; after_crc and before_crc: between the controller's port and the bus",
        f"{_GATEWAY}; with on_wire the error frames cause a delay",
        f"{_GATEWAY}; with on_wire the error frames cause a delay",
    ),
    "masquerade": Benches("a further node on the bus", _GATEWAY, _GATEWAY),
    "babbling_idiot": Benches(
        "a further node on the bus, which wins or loses by its identifier",
        "the gateway sends the frames on both buses and arbitrates where a bus does not",
        "the gateway sends the frames on both buses, where they are arbitrated",
    ),
    "bus_off": Benches(
        "every frame of the node is destroyed: off after 32, back 128 times 11 recessive bits"
        " after the end",
        f"{_BLOCKED}, up to 5.6 ms after the end",
        f"{_BLOCKED}, up to 5.6 ms after the end",
    ),
    "link_cut": Benches("the node is disconnected from the bus", _BLOCKED, _BLOCKED),
    "controller_killed": Benches(
        "to the modelled process",
        f"{_SIGNALS}; its memory cannot be lost",
        f"{_SIGNALS}; its memory cannot be lost; {_FOREIGN}",
    ),
    "clock_step": Benches("to the modelled process", "not possible", "not possible"),
}
"""Kinds that are applied in another way than the other faults of their place."""


@dataclass(frozen=True, slots=True)
class FaultParameter:
    """One parameter of a fault, as a key of a scenario file."""

    name: str
    kind: str
    """The type: `number`, `whole number`, `text`, `true or false`, `table of numbers` or the
    choices."""
    unit: str
    default: str
    range: str
    """The permitted range; empty if every value is permitted."""
    story: str


@dataclass(frozen=True, slots=True)
class Described:
    """One entry of the catalogue as text."""

    name: str
    place: FaultPlace
    hazards: tuple[str, ...]
    story: str
    parameters: tuple[FaultParameter, ...]
    benches: Benches


def described(kind: Kind) -> Described:
    benches = BY_KIND.get(kind.name, BY_PLACE[kind.place])
    # The docstring is the description; line breaks become blanks.
    story = " ".join((inspect.getdoc(kind.parameters) or "").split())
    hazards = tuple(hazard.value for hazard in kind.hazards)
    return Described(kind.name, kind.place, hazards, story, tuple(_parameters(kind)), benches)


@functools.cache
def all_described() -> tuple[Described, ...]:
    """Return the whole catalogue by place, module and order of declaration.

    The catalogue itself has the order in which a program happens to import the modules.
    """
    kinds = sorted(CATALOGUE.values(), key=lambda kind: kind.parameters.__module__)
    return tuple(described(kind) for place in FaultPlace for kind in kinds if kind.place is place)


def _parameters(kind: Kind) -> Iterator[FaultParameter]:
    hints = typing.get_type_hints(kind.parameters)
    stories, ranges = _read_source(kind.parameters)
    for each in dataclasses.fields(kind.parameters):
        choices, story = _choices(hints[each.name])
        yield FaultParameter(
            name=each.name,
            kind=choices,
            unit=_unit(each.name),
            default=_text(each.default),
            range=ranges.get(each.name, ""),
            story=" ".join([*stories.get(each.name, "").split(), *story.split()]),
        )


def _choices(hint: Any) -> tuple[str, str]:
    """Return the permitted type or choices, and the documented meaning of the choices."""
    if isinstance(hint, types.UnionType):
        hint = next(each for each in typing.get_args(hint) if each is not type(None))
    if isinstance(hint, type) and issubclass(hint, enum.Enum):
        words = [member.name.lower() for member in hint]
        stories, _ = _read_source(hint)
        meanings = [
            f"{name.lower()}: {story[0].lower() + story[1:].rstrip('.')}"
            for name, story in stories.items()
        ]
        return ", ".join(words), f"{'; '.join(meanings)}." if meanings else ""
    plain = {float: "number", int: "whole number", str: "text", bool: "true or false"}
    return plain.get(hint, "table of numbers"), ""


@functools.cache
def _classes(module: str) -> dict[str, ast.ClassDef]:
    """Return the classes of a module by name, as syntax trees."""
    tree = ast.parse(inspect.getsource(sys.modules[module]))
    return {each.name: each for each in tree.body if isinstance(each, ast.ClassDef)}


def _read_source(owner: type) -> tuple[dict[str, str], dict[str, str]]:
    """Return the docstrings of a class's fields, and the ranges that the class checks."""
    tree = _classes(owner.__module__)[owner.__name__]
    stories: dict[str, str] = {}
    name = ""
    for line in tree.body:
        if isinstance(line, ast.AnnAssign) and isinstance(line.target, ast.Name):
            name = line.target.id
        elif isinstance(line, ast.Assign) and isinstance(line.targets[0], ast.Name):
            name = line.targets[0].id
        elif name and isinstance(line, ast.Expr) and isinstance(line.value, ast.Constant):
            stories[name] = str(line.value.value)
        else:
            name = ""
    ranges = {}
    for call in ast.walk(tree):
        if isinstance(call, ast.Call) and getattr(call.func, "id", "") == RANGE_CHECK:
            key, low, high = (ast.literal_eval(each) for each in call.args[1:])
            ranges[str(key)] = f"{_number(low)} … {_number(high)}"
    return stories, ranges


def _unit(name: str) -> str:
    return next(
        (unit for end, unit in UNITS.items() if name.endswith(f"_{end}") or name == end), ""
    )


def _text(value: Any) -> str:
    if value is None:
        return "none"
    if isinstance(value, enum.Enum):
        return value.name.lower()
    if isinstance(value, bool):
        return str(value).lower()
    return _number(value) if isinstance(value, int | float) else str(value)


def _number(value: float) -> str:
    return f"{value:.12g}".replace("-", "−")
