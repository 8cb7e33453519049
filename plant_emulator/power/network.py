"""The DC network of a line: substations, sections of feeder and rails, and the trains on them.

Sections meet at named joints and form one tree or several. A section with substations at both ends
is fed bilaterally, one with a substation at one end unilaterally. A joint without a substation only
connects sections. Each train is a node of its own on its section.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from plant_emulator.power import flow

M_PER_KM: Final = 1000.0


@dataclass(frozen=True, slots=True)
class Substation:
    """A rectifier substation, which accepts no current."""

    joint: str
    no_load_v: float
    source_ohm: float


@dataclass(frozen=True, slots=True)
class Section:
    """Feeder and return conductor together, from one joint to another."""

    begin: str
    end: str
    begin_m: float
    end_m: float
    """Chainage of the two ends, by which trains are assigned to sections."""
    ohm_per_km: float


@dataclass(frozen=True, slots=True)
class Voltages:
    """Voltages at which trains reduce their power and at which their resistors take over."""

    no_effort_v: float = 500.0
    full_effort_v: float = 600.0
    chops_from_v: float = 880.0
    chops_all_v: float = 900.0
    smooth_v: float = 2.0
    """Width of the rectifier's knee."""
    floor_v: float = 100.0
    ceiling_v: float = 1200.0

    def __post_init__(self) -> None:
        if not 0.0 < self.floor_v <= self.no_effort_v < self.full_effort_v:
            raise ValueError("not 0 < floor_v <= no_effort_v < full_effort_v")
        if not self.full_effort_v < self.chops_from_v < self.chops_all_v <= self.ceiling_v:
            raise ValueError("not full_effort_v < chops_from_v < chops_all_v <= ceiling_v")
        if not self.smooth_v > 0.0:
            raise ValueError(f"smooth_v {self.smooth_v} is not positive")

    def listed(self) -> list[float]:
        """Return the limits in the order of `flow`'s indices."""
        return [
            *(self.no_effort_v, self.full_effort_v, self.chops_from_v, self.chops_all_v),
            *(self.smooth_v, self.floor_v, self.ceiling_v),
        ]


class Load(NamedTuple):
    """One train as a load of the network."""

    at_m: float
    wants_w: float
    """Electrical traction power wanted; never negative."""
    gives_w: float
    """Regenerated power offered; never negative."""
    auxiliary_w: float


class Fed(NamedTuple):
    """Solution for one train."""

    voltage_v: float
    current_a: float
    """Current from the line; negative while the train feeds back."""
    traction_w: float
    regenerated_w: float
    """Power out of the inverters, whether line, auxiliaries or resistor take it."""
    resistor_w: float


@dataclass(frozen=True, slots=True)
class Balance:
    """Power balance of one solved instant: sources = rectifiers + stations + lines + trains."""

    sources_w: float
    """Power at the no-load voltage, behind the rectifiers' resistance."""
    rectifiers_w: float
    stations_w: float
    """Power of the substations' own loads."""
    lines_w: float
    trains_w: float
    """Net power of all trains, including what they feed back."""

    @property
    def error_w(self) -> float:
        return self.sources_w - self.rectifiers_w - self.stations_w - self.lines_w - self.trains_w


class NetworkError(ValueError):
    """Raised for an invalid network; the text names the part."""


class Network:
    """Solves the network instant by instant, each time from the last voltages.

    `unconverged` counts instants without a solution. A simulation must check it.
    """

    def __init__(
        self,
        sections: Sequence[Section],
        substations: Sequence[Substation],
        voltages: Voltages | None = None,
    ) -> None:
        self.voltages = voltages or Voltages()
        self.sections = tuple(sections)
        self.substations = tuple(substations)
        self.joints = _joints(self.sections)
        self.order, self.roots, self.turned = _tree(self.sections, self.joints)
        self.joints_of = [
            [self.joints.index(name) for name in (s.begin, s.end)[:: -1 if turned else 1]]
            for s, turned in zip(self.sections, self.turned, strict=True)
        ]
        self.spans_m = [
            [s.end_m, s.begin_m] if turned else [s.begin_m, s.end_m]
            for s, turned in zip(self.sections, self.turned, strict=True)
        ]
        self.ohms_per_m = [s.ohm_per_km / M_PER_KM for s in self.sections]
        self.sources = [[0.0] * len(self.joints), [0.0] * len(self.joints)]
        """No-load voltage and resistance of each joint's substation."""
        for substation in self.substations:
            self._add(substation)
        self.limits = self.voltages.listed()
        self.unconverged = 0
        self.solved = 0
        self.iterations = 0
        self._warm: dict[str | int, float] = {}

    def _add(self, substation: Substation) -> None:
        where = f"substation {substation.joint}"
        if substation.joint not in self.joints:
            raise NetworkError(f"{where}: no section begins or ends at it")
        if not 0.0 < substation.source_ohm < math.inf:
            raise NetworkError(f"{where}: source_ohm {substation.source_ohm} is not positive")
        if not self.voltages.full_effort_v < substation.no_load_v < self.voltages.ceiling_v:
            raise NetworkError(
                f"{where}: no_load_v {substation.no_load_v} is not a working voltage"
            )
        index = self.joints.index(substation.joint)
        if self.sources[1][index] > 0.0:
            raise NetworkError(f"{where}: is defined twice")
        self.sources[0][index] = substation.no_load_v
        self.sources[1][index] = substation.source_ohm

    def section_of(self, at_m: float) -> int:
        """Return the first section that contains this chainage; raises NetworkError."""
        for index, section in enumerate(self.sections):
            low_m, high_m = sorted((section.begin_m, section.end_m))
            if low_m <= at_m <= high_m:
                return index
        raise NetworkError(f"no section at {at_m:g} m")

    def solve(self, trains: Sequence[Load]) -> tuple[list[Fed], Balance]:
        """Solve one instant and return the results in the order of the given trains."""
        nodes = len(self.joints) + len(trains)
        parent, siemens = [0] * nodes, [0.0] * nodes
        of_train, of_joint = [0] * len(trains), [-1] * len(self.joints)
        for root in self.roots:
            of_joint[root] = -2
        n = flow.arrange(
            self.order,
            self.joints_of,
            self.spans_m,
            self.ohms_per_m,
            [self.section_of(train.at_m) for train in trains],
            [train.at_m for train in trains],
            parent,
            siemens,
            of_train,
            of_joint,
            [0] * len(trains),
        )
        assert n == nodes
        sources, loads = _rows(2, nodes), _rows(3, nodes)
        for joint, node in enumerate(of_joint):
            sources[0][node] = self.sources[0][joint]
            sources[1][node] = self.sources[1][joint]
        for node, load in zip(of_train, trains, strict=True):
            loads[0][node] = load.wants_w
            loads[1][node] = load.gives_w
            loads[2][node] = load.auxiliary_w
        volts = self._start(nodes, of_joint, of_train)
        done = flow.solve(
            parent, siemens, sources, loads, self.limits, volts, _rows(4, nodes), nodes
        )
        self.solved += 1
        if done < 0:
            self.unconverged += 1
        else:
            self.iterations += done
            self._keep(volts, of_joint, of_train)
        fed = [self._fed(volts[node], load) for node, load in zip(of_train, trains, strict=True)]
        return fed, self._balance(parent, siemens, sources, volts, fed)

    def joint_voltages_v(self) -> dict[str, float]:
        """Joint voltages at the last solved instant; empty before the first solution."""
        return {name: self._warm[name] for name in self.joints if name in self._warm}

    def _start(self, nodes: int, of_joint: list[int], of_train: list[int]) -> list[float]:
        volts = [max(self.sources[0])] * nodes
        for name, node in zip(self.joints, of_joint, strict=True):
            volts[node] = self._warm.get(name, volts[node])
        for train, node in enumerate(of_train):
            volts[node] = self._warm.get(train, volts[node])
        return volts

    def _keep(self, volts: list[float], of_joint: list[int], of_train: list[int]) -> None:
        for name, node in zip(self.joints, of_joint, strict=True):
            self._warm[name] = volts[node]
        for train, node in enumerate(of_train):
            self._warm[train] = volts[node]

    def _fed(self, voltage_v: float, load: Load) -> Fed:
        effort, _ = flow.effort_share(voltage_v, self.limits)
        chopped, _ = flow.chopped_share(voltage_v, self.limits)
        net_w = load.wants_w * effort + load.auxiliary_w - load.gives_w * (1.0 - chopped)
        return Fed(
            voltage_v=voltage_v,
            current_a=net_w / voltage_v,
            traction_w=load.wants_w * effort,
            regenerated_w=load.gives_w,
            resistor_w=load.gives_w * chopped,
        )

    def _balance(
        self,
        parent: list[int],
        siemens: list[float],
        sources: list[list[float]],
        volts: list[float],
        fed: Sequence[Fed],
    ) -> Balance:
        sources_w = rectifiers_w = stations_w = lines_w = 0.0
        for node, voltage_v in enumerate(volts):
            if parent[node] >= 0:
                fall_v = voltage_v - volts[parent[node]]
                lines_w += siemens[node] * fall_v * fall_v
            no_load_v, ohm = sources[0][node], sources[1][node]
            if ohm <= 0.0:
                continue
            fed_a, _ = flow.source_current(voltage_v, no_load_v, ohm, self.limits)
            current_a = fed_a + flow.IDLE_S * voltage_v
            sources_w += no_load_v * current_a
            rectifiers_w += (no_load_v - voltage_v) * current_a
            stations_w += flow.IDLE_S * voltage_v * voltage_v
        return Balance(
            sources_w=sources_w,
            rectifiers_w=rectifiers_w,
            stations_w=stations_w,
            lines_w=lines_w,
            trains_w=sum([train.voltage_v * train.current_a for train in fed]),
        )


def _rows(count: int, nodes: int) -> list[list[float]]:
    return [[0.0] * nodes for _ in range(count)]


def _joints(sections: Sequence[Section]) -> list[str]:
    names: list[str] = []
    for section in sections:
        where = f"section {section.begin}-{section.end}"
        if section.begin == section.end or section.begin_m == section.end_m:
            raise NetworkError(f"{where}: has no length")
        if not 0.0 < section.ohm_per_km < math.inf:
            raise NetworkError(f"{where}: ohm_per_km {section.ohm_per_km} is not positive")
        for name in (section.begin, section.end):
            if name not in names:
                names.append(name)
    if not names:
        raise NetworkError("no section")
    return names


def _tree(
    sections: Sequence[Section], joints: Sequence[str]
) -> tuple[list[int], list[int], list[bool]]:
    """Return the sections in an order in which each one's earlier joint is known, the roots, and
    whether each section runs against that order.

    Raises NetworkError for a ring.
    """
    order: list[int] = []
    roots: list[int] = []
    turned = [False] * len(sections)
    known: set[str] = set()
    for root in joints:
        if root in known:
            continue
        roots.append(joints.index(root))
        known.add(root)
        reached = [root]
        while reached:
            here = reached.pop(0)
            for index, section in enumerate(sections):
                if index in order or here not in (section.begin, section.end):
                    continue
                there = section.end if section.begin == here else section.begin
                if there in known:
                    raise NetworkError(
                        f"section {section.begin}-{section.end}: closes a ring; a network is a tree"
                    )
                turned[index] = section.end == here
                order.append(index)
                known.add(there)
                reached.append(there)
    return order, roots, turned
