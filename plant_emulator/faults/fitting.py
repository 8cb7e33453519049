"""Checks that the train has the parts that the faults of a scenario affect."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

from can_dbc.nodes import Node
from firmware_py.settings import SettingsError, nearest
from firmware_py.trackdb import LineMap
from firmware_py.trackdb.network import TrackNetwork
from firmware_py.trackdb.paths import Path
from plant_emulator.faults.declared_loops import LOOP_FAULTS
from plant_emulator.faults.declared_process import ClockStep, ControllerKilled
from plant_emulator.faults.declared_train import (
    PowerSectionOff,
    TagDisplaced,
    TagDuplicate,
    TagMissed,
)
from plant_emulator.faults.declared_wayside import (
    AuthorityWithdrawn,
    OtherDatabase,
    RearUnprotected,
    RouteSet,
    SignalStop,
    SwitchLost,
    SwitchStray,
    SwitchStuck,
    TrackClosed,
    WrongMap,
)
from plant_emulator.faults.kinds import FaultPlace, Kind
from plant_emulator.faults.plan import FaultPlan
from plant_emulator.foreign import ForeignParts
from plant_emulator.train_config import TrainConfig
from plant_emulator.world import TrainScenario

EFFORT: Final = (Node.TCU, Node.BCU)
SWITCH_FAULTS: Final = (SwitchLost, SwitchStray, SwitchStuck)
TRACK_FAULTS: Final = (*SWITCH_FAULTS, RouteSet, TrackClosed)
"""Faults that need a network with switches."""
TAG_FAULTS: Final = (TagDisplaced, TagDuplicate, TagMissed)
"""Faults of tags of the line. A false tag may have any number."""
ZONE_FAULTS: Final = (AuthorityWithdrawn, OtherDatabase, RearUnprotected, SignalStop, WrongMap)
"""Faults of the zone controller, which gives no authority to trains that command themselves."""
NODES_OF_PLACE: Final[Mapping[FaultPlace, tuple[Node, ...]]] = {
    FaultPlace.ACTUATOR: EFFORT,
    FaultPlace.SENSOR: (Node.ODO,),
    FaultPlace.SUPPLY: (Node.HVB, Node.TCU),
    FaultPlace.DOORS: (Node.DCU,),
    FaultPlace.DESK: (Node.DESK,),
    FaultPlace.ALARMS: (Node.TCMS,),
}
"""Nodes in whose emulation the faults of a place act."""
NODES_OF_KIND: Final[Mapping[str, tuple[Node, ...]]] = {
    "low_adhesion": (*EFFORT, Node.ODO),
    "load_cell": (Node.TCMS,),
    "train_longer": (),
    **dict.fromkeys(("tag_missed", "tag_displaced", "tag_duplicate", "tag_false"), (Node.BTM,)),
    "antenna_dead": (Node.BTM,),
    **dict.fromkeys(("traction_runaway", "traction_weak", "traction_late"), (Node.TCU,)),
    **dict.fromkeys(("brake_late", "brake_weak", "brake_stuck", "brake_unit_failed"), (Node.BCU,)),
    **dict.fromkeys(("emergency_late", "holding_late", "holding_sticks"), (Node.BCU,)),
}
"""Kinds that act in other nodes than the other faults of their place."""


@dataclass(frozen=True, slots=True)
class FaultTargets:
    """Train and track that the faults of a scenario may affect."""

    train: TrainConfig
    network: TrackNetwork | None = None
    """With its switches; None for a line without one."""
    sections: frozenset[str] = frozenset()
    """Names of the power sections of line and network."""
    tags: frozenset[int] = frozenset()
    """Numbers of the tags of line and network."""


def targets_of(scenario: TrainScenario) -> FaultTargets:
    """The targets in a scenario."""
    return targets_on(scenario.train, scenario.line, scenario.tracks)


def targets_on(
    train: TrainConfig, line: LineMap, tracks: tuple[TrackNetwork, Path] | None
) -> FaultTargets:
    """The targets of a train on a line; `tracks` as in a scenario."""
    network = None if tracks is None else tracks[0]
    names = {each.name for each in line.power_sections}
    tags = {each.tag_id for each in line.tags}
    for track in () if network is None else network.tracks:
        names |= {each.name for each in track.power_sections}
        tags |= {each.tag_id for each in track.tags}
    return FaultTargets(train, network, frozenset(names), frozenset(tags))


def check_fitting(faults: Iterable[FaultPlan], targets: FaultTargets, source: str) -> None:
    """Raise SettingsError for a fault that would have no effect because train or track lacks the
    part.
    """
    train = targets.train
    for plan in faults:
        if isinstance(plan.parameters, TRACK_FAULTS):
            _check_network(plan, source, targets.network)
        if isinstance(plan.parameters, PowerSectionOff):
            _check_section(plan, plan.parameters.section, source, targets.sections)
        if isinstance(plan.parameters, TAG_FAULTS):
            _check_tag(plan, plan.parameters.tag_id, source, targets.tags)
        if isinstance(plan.parameters, LOOP_FAULTS) and not train.loop.connected:
            raise SettingsError(
                f"{source}: fault[{plan.index}].kind: {plan.kind.name}: the train {train.name} has "
                "no current loops; choose one with loops, or set loop.connected of the real train"
            )


def check_acting(faults: Iterable[FaultPlan], source: str, *, trains: int, trips: int) -> None:
    """Raise SettingsError for a fault of a train or trip that the case does not have.

    A switch belongs to all trains, so the trip of one of them decides when its fault acts.
    """
    for plan in faults:
        where = f"{source}: fault[{plan.index}]"
        for key, number, most in (("train", plan.train, trains), ("trip", plan.trip, trips)):
            if number is not None and number > most:
                raise SettingsError(
                    f"{where}.{key}: {number}: the case has {most}; choose 1 to {most}"
                )
        if trains > 1 and plan.train is None and isinstance(plan.parameters, SWITCH_FAULTS):
            raise SettingsError(
                f"{where}.train: missing key: {plan.kind.name} acts on a switch of all trains; "
                "add the train in whose trips it acts"
            )


def check_commanded(faults: Iterable[FaultPlan], source: str) -> None:
    """Raise SettingsError for a fault that cannot act on trains that command themselves."""
    for plan in faults:
        window = plan.window
        ends = any((window.end_s, window.duration_s, window.until))
        why = ""
        if plan.kind.place is FaultPlace.RADIO or isinstance(plan.parameters, ZONE_FAULTS):
            why = "acts on authorities of the zone controller, and masters issue them here"
        elif isinstance(plan.parameters, ClockStep):
            why = "does not reach the radio of masters"
        elif isinstance(plan.parameters, ControllerKilled) and ends:
            why = "cannot restart a train under masters; leave out its end"
        if why:
            raise SettingsError(f"{source}: fault[{plan.index}].kind: {plan.kind.name} {why}")


def _check_section(plan: FaultPlan, name: str, source: str, known: frozenset[str]) -> None:
    where = f"{source}: fault[{plan.index}].section: {name!r}"
    if not known:
        raise SettingsError(f"{where}: the line has no power sections; add power_sections to it")
    if name not in known:
        raise SettingsError(f"{where}: no such section; {nearest(name, sorted(known), 'name')}")


def _check_tag(plan: FaultPlan, tag_id: int | None, source: str, known: frozenset[int]) -> None:
    if tag_id is None or tag_id in known:
        return
    where = f"{source}: fault[{plan.index}].tag_id: {tag_id}"
    if not known:
        raise SettingsError(f"{where}: the line has no tags")
    closest = min(known, key=lambda each: (abs(each - tag_id), each))
    raise SettingsError(f"{where}: no such tag; nearest of {len(known)} tags: {closest}")


def _check_network(plan: FaultPlan, source: str, network: TrackNetwork | None) -> None:
    kinds = {RouteSet: "route", TrackClosed: "track"}
    key = kinds.get(type(plan.parameters), "switch")
    value = getattr(plan.parameters, key)
    where = f"{source}: fault[{plan.index}].{key}: {value!r}"
    if network is None:
        raise SettingsError(
            f"{where}: the line has no switch; run the train over a route of a network with one"
        )
    known = {
        "route": [route.name for route in network.routes],
        "track": [track.name for track in network.tracks],
        "switch": [switch.name for switch in network.switches],
    }
    names = known[key]
    if value not in names:
        raise SettingsError(f"{where}: no such {key}; {nearest(value, names, 'name')}")


def nodes_of(kind: Kind) -> tuple[Node, ...]:
    """Return the nodes in whose emulation a fault acts; empty if it acts elsewhere."""
    return NODES_OF_KIND.get(kind.name, NODES_OF_PLACE.get(kind.place, ()))


def check_provided(faults: Iterable[FaultPlan], foreign: ForeignParts) -> None:
    """Raise SettingsError for a fault in a part that a program outside the bench emulates."""
    for plan in faults:
        lost = [node.name for node in nodes_of(plan.kind) if node in foreign.nodes]
        if lost:
            raise SettingsError(
                f"fault[{plan.index}].kind: {plan.kind.name} acts in the bench's own {lost[0]}, "
                "which the plant provides; leave out the fault or let the bench emulate the node"
            )
