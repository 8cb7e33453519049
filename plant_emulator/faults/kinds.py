"""What a fault is: where it acts, which hazard it threatens, and the register of all kinds."""

import enum
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, TypeVar

T = TypeVar("T")


class FaultPlace(enum.Enum):
    """Where a fault acts; it decides who brings it about."""

    BUS = "bus"
    """Between the nodes of the train bus. Brought about by the bench."""
    SENSOR = "sensor"
    SERIAL = "serial"
    """On the line between tag reader and controller."""
    ACTUATOR = "actuator"
    SUPPLY = "supply"
    DOORS = "doors"
    DESK = "desk"
    RADIO = "radio"
    WAYSIDE = "wayside"
    """What the rest of the railway decides: centre, signals, platform doors."""
    ALARMS = "alarms"
    """What the train itself notices around it and in it."""
    PROCESS = "process"
    """In the controller's process. Brought about by the bench."""


BENCH_PLACES: Final = frozenset({FaultPlace.BUS, FaultPlace.PROCESS})
"""The plant cannot bring these about; it only says when they begin and end."""


class Hazard(enum.Enum):
    """What may come of a fault when nothing stands against it."""

    OVERRUN = "train passes the end of its authority"
    OVERSPEED = "train runs faster than the line allows"
    MISLOCATED = "train is not where it believes to be"
    NO_BRAKE = "train brakes later or less than protection counts on"
    UNWANTED_MOTION = "train moves when or whither it must not"
    DOOR_DANGER = "doors open where or while they must not"
    LOST_SERVICE = "train stops or stays without need"
    WRONG_COMMAND = "a unit acts on what the controller never said"


@dataclass(frozen=True, slots=True)
class Kind:
    """One entry of the catalogue."""

    name: str
    place: FaultPlace
    hazards: tuple[Hazard, ...]
    parameters: type
    """A frozen dataclass; its fields are the keys of the scenario file, its docstring the story.
    Values out of range are refused with ValueError in its `__post_init__`."""


CATALOGUE: Final[dict[str, Kind]] = {}
"""By name, in the order of the modules."""


def fault(name: str, place: FaultPlace, *hazards: Hazard) -> Callable[[type[T]], type[T]]:
    """Enters a dataclass of parameters into the catalogue."""

    def enter(parameters: type[T]) -> type[T]:
        assert name not in CATALOGUE, f"fault {name} is declared twice"
        CATALOGUE[name] = Kind(name, place, hazards, parameters)
        return parameters

    return enter


def check_range(owner: object, name: str, low: float, high: float) -> None:
    """Raises ValueError that names key and value."""
    value = getattr(owner, name)
    if not low <= value <= high:
        raise ValueError(f"{name} {value:g} is not within {low:g}..{high:g}")
