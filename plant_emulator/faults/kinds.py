"""Definition of a fault kind: the place where it acts and the hazards that it threatens.

Registers all kinds.
"""

import enum
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, TypeVar

T = TypeVar("T")


class FaultPlace(enum.Enum):
    """Place where a fault acts; it decides which component applies the fault."""

    BUS = "bus"
    """Between the nodes of the train bus; the bench applies it."""
    SENSOR = "sensor"
    SERIAL = "serial"
    """On the line between tag reader and controller."""
    ACTUATOR = "actuator"
    SUPPLY = "supply"
    DOORS = "doors"
    DESK = "desk"
    RADIO = "radio"
    WAYSIDE = "wayside"
    """Decisions of the rest of the railway: centre, signals, platform doors."""
    ALARMS = "alarms"
    """Events that the train itself detects, outside or on board."""
    PROCESS = "process"
    """In the controller's process; the bench applies it."""


BENCH_PLACES: Final = frozenset({FaultPlace.BUS, FaultPlace.PROCESS})
"""Places where the bench applies faults. The plant only reports when such faults begin and end."""


class Hazard(enum.Enum):
    """Possible consequence of a fault without any protection."""

    OVERRUN = "train passes the end of its authority"
    OVERSPEED = "train runs faster than the line allows"
    MISLOCATED = "train is not where it believes to be"
    NO_BRAKE = "train brakes later or less than ATP assumes"
    UNWANTED_MOTION = "train moves when or in a direction that is not permitted"
    DOOR_DANGER = "doors open where or when they must not"
    LOST_SERVICE = "train stops or waits without need"
    WRONG_COMMAND = "a unit acts on a command that the controller did not send"


@dataclass(frozen=True, slots=True)
class Kind:
    """One entry of the catalogue."""

    name: str
    place: FaultPlace
    hazards: tuple[Hazard, ...]
    parameters: type
    """Class of the parameters: a frozen dataclass. Its fields are the keys of the scenario file,
    its docstring is the description, and its `__post_init__` raises ValueError for values out of
    range."""


CATALOGUE: Final[dict[str, Kind]] = {}
"""All kinds by name, in the order of the modules."""


def fault(name: str, place: FaultPlace, *hazards: Hazard) -> Callable[[type[T]], type[T]]:
    """Register a dataclass of parameters in the catalogue."""

    def enter(parameters: type[T]) -> type[T]:
        assert name not in CATALOGUE, f"fault {name} is declared twice"
        CATALOGUE[name] = Kind(name, place, hazards, parameters)
        return parameters

    return enter


def check_range(owner: object, name: str, low: float, high: float) -> None:
    """Raise ValueError that names key and value if the value is out of range."""
    value = getattr(owner, name)
    if not low <= value <= high:
        raise ValueError(f"{name} {value:g} is not within {low:g}..{high:g}")
