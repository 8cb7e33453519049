"""The DC network of a line: substations, sections of feeder and rails, and the trains on them.

Sections meet at named joints and form one tree or several. A section with substations at both ends
is fed bilaterally, one with a substation at one end unilaterally. A joint without a substation only
connects sections. A substation may have an inverter that returns power to the grid. A storage takes
the place of a substation at a joint. Each train is a node of its own on its section.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from plant_emulator.power import flow
from plant_emulator.power.box import J_PER_KWH

M_PER_KM: Final = 1000.0
END_M: Final = 50.0
"""Distance beyond the end of a section up to which that section still feeds a train."""
CEILING_MAX_V: Final = 2000.0
"""Greatest voltage that the frame LINE_SUPPLY carries."""
FIRST_INTERVAL_S: Final = 1.0
"""Interval for which storages are bounded before the first one is known."""


@dataclass(frozen=True, slots=True)
class Inverter:
    """Returns power from the line to the grid."""

    from_v: float
    """Voltage from which it takes current."""
    source_ohm: float
    """Rise of the voltage with each ampere that it takes."""
    power_max_w: float

    def __post_init__(self) -> None:
        _check_positive(self, "from_v", "source_ohm", "power_max_w")


@dataclass(frozen=True, slots=True)
class Substation:
    """A substation. Without an inverter it accepts no current."""

    joint: str
    no_load_v: float
    source_ohm: float
    inverter: Inverter | None = None


@dataclass(frozen=True, slots=True)
class Storage:
    """Stores energy that the line has left, and gives it back at low voltage."""

    joint: str
    gives_below_v: float
    takes_above_v: float
    source_ohm: float
    """Change of the voltage with each ampere, in both directions."""
    power_max_w: float
    capacity_kwh: float
    charge_ratio: float = 0.5
    """Energy at the start as a share of the capacity."""
    efficiency_ratio: float = 0.95
    """Efficiency of charging, and again of discharging."""

    def __post_init__(self) -> None:
        _check_positive(self, "gives_below_v", "source_ohm", "power_max_w", "capacity_kwh")
        if not self.gives_below_v < self.takes_above_v < math.inf:
            raise ValueError(f"takes_above_v {self.takes_above_v} is not above gives_below_v")
        if not 0.0 <= self.charge_ratio <= 1.0:
            raise ValueError(f"charge_ratio {self.charge_ratio} is not within 0..1")
        if not 0.0 < self.efficiency_ratio <= 1.0:
            raise ValueError(f"efficiency_ratio {self.efficiency_ratio} is not within 0..1")


def _check_positive(part: object, *names: str) -> None:
    for name in names:
        value = getattr(part, name)
        if not 0.0 < value < math.inf:
            raise ValueError(f"{name} {value} is not positive")


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
        if self.ceiling_v > CEILING_MAX_V:
            raise ValueError(f"ceiling_v {self.ceiling_v} is above {CEILING_MAX_V:g}")
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
    """Power from the grid at the no-load voltage, behind the rectifiers' resistance, less the power
    that inverters return."""
    rectifiers_w: float
    """Loss in the resistances of rectifiers, inverters and storages."""
    stations_w: float
    """Power of the substations' own loads."""
    lines_w: float
    trains_w: float
    """Net power of all trains, including what they feed back."""
    returned_w: float
    """Power that inverters return to the grid."""
    storages_w: float
    """Power out of all storages, behind their resistance; negative while they charge."""

    @property
    def error_w(self) -> float:
        became_w = self.rectifiers_w + self.stations_w + self.lines_w + self.trains_w
        return self.sources_w + self.storages_w - became_w


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
        storages: Sequence[Storage] = (),
    ) -> None:
        self.voltages = voltages or Voltages()
        self.sections = tuple(sections)
        self.substations = tuple(substations)
        self.storages = tuple(storages)
        self.charges_j = [s.charge_ratio * s.capacity_kwh * J_PER_KWH for s in self.storages]
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
        self.sources = _rows(flow.SOURCE_ROWS, len(self.joints))
        """Substation or storage of each joint, see `flow`."""
        for substation in self.substations:
            self._add(substation)
        for storage in self.storages:
            self._add_storage(storage)
        if not self.substations:
            raise NetworkError("no substation")
        self._bound_storages(FIRST_INTERVAL_S)
        self.limits = self.voltages.listed()
        self.unconverged = 0
        self.solved = 0
        self.iterations = 0
        self._warm: dict[str | int, float] = {}

    def _add(self, substation: Substation) -> None:
        where = f"substation {substation.joint}"
        if not 0.0 < substation.source_ohm < math.inf:
            raise NetworkError(f"{where}: source_ohm {substation.source_ohm} is not positive")
        self._check_voltage(where, "no_load_v", substation.no_load_v)
        inverter = substation.inverter
        if inverter is None:
            taking = (0.0, 0.0, 0.0)
        else:
            self._check_voltage(where, "inverter.from_v", inverter.from_v)
            if inverter.from_v <= substation.no_load_v:
                raise NetworkError(
                    f"{where}: inverter.from_v {inverter.from_v} is not above no_load_v; power "
                    "would circulate"
                )
            taking = (inverter.from_v, inverter.source_ohm, inverter.power_max_w / inverter.from_v)
        self._place(where, substation.joint, substation.no_load_v, substation.source_ohm, *taking)

    def _add_storage(self, storage: Storage) -> None:
        where = f"storage {storage.joint}"
        self._check_voltage(where, "gives_below_v", storage.gives_below_v)
        self._check_voltage(where, "takes_above_v", storage.takes_above_v)
        taking = (storage.takes_above_v, storage.source_ohm, 0.0)
        self._place(where, storage.joint, storage.gives_below_v, storage.source_ohm, *taking)

    def _check_voltage(self, where: str, key: str, value_v: float) -> None:
        low_v, high_v = self.voltages.full_effort_v, self.voltages.ceiling_v
        if not low_v < value_v < high_v:
            raise NetworkError(
                f"{where}: {key} {value_v} is not a working voltage; it must be above "
                f"full_effort_v ({low_v:g}) and below ceiling_v ({high_v:g})"
            )

    def _place(
        self,
        where: str,
        joint: str,
        gives_v: float,
        gives_ohm: float,
        takes_v: float,
        takes_ohm: float,
        takes_max_a: float,
    ) -> None:
        if joint not in self.joints:
            raise NetworkError(f"{where}: no section begins or ends at it")
        index = self.joints.index(joint)
        if self.sources[flow.GIVES_OHM][index] > 0.0:
            raise NetworkError(f"{where}: is defined twice")
        column = (gives_v, gives_ohm, math.inf, takes_v, takes_ohm, takes_max_a)
        for row, value in zip(self.sources, column, strict=True):
            row[index] = value

    def _bound_storages(self, interval_s: float) -> None:
        """Bound the currents so that no storage runs empty or over within the interval."""
        for storage, charge_j in zip(self.storages, self.charges_j, strict=True):
            index = self.joints.index(storage.joint)
            room_j = storage.capacity_kwh * J_PER_KWH - charge_j
            gives_w = min(storage.power_max_w, charge_j * storage.efficiency_ratio / interval_s)
            takes_w = min(storage.power_max_w, room_j / storage.efficiency_ratio / interval_s)
            self.sources[flow.GIVES_MAX][index] = gives_w / storage.gives_below_v
            self.sources[flow.TAKES_MAX][index] = takes_w / storage.takes_above_v

    def advance(self, interval_s: float) -> None:
        """Charge and discharge the storages for an interval at the last solution's powers."""
        for number, storage in enumerate(self.storages):
            given_w, taken_w = self._storage_w(storage)
            charge_j = self.charges_j[number] + interval_s * (
                taken_w * storage.efficiency_ratio - given_w / storage.efficiency_ratio
            )
            self.charges_j[number] = min(max(charge_j, 0.0), storage.capacity_kwh * J_PER_KWH)
        self._bound_storages(interval_s)

    def _storage_w(self, storage: Storage) -> tuple[float, float]:
        """Return the powers that a storage gives and takes, behind its resistance."""
        index = self.joints.index(storage.joint)
        voltage_v = self._warm.get(storage.joint, storage.gives_below_v)
        given_a = flow.given_a(voltage_v, index, self.sources, self.limits)
        taken_a = flow.taken_a(voltage_v, index, self.sources, self.limits)
        return storage.gives_below_v * given_a, storage.takes_above_v * taken_a

    def delivered_w(self) -> tuple[float, ...]:
        """Return the power of each substation from the grid at the last solution; negative while
        its inverter returns power.
        """
        found = []
        for station in self.substations:
            index = self.joints.index(station.joint)
            voltage_v = self._warm.get(station.joint, station.no_load_v)
            given_a = flow.given_a(voltage_v, index, self.sources, self.limits)
            taken_a = flow.taken_a(voltage_v, index, self.sources, self.limits)
            returned_w = 0.0 if station.inverter is None else station.inverter.from_v * taken_a
            found.append(station.no_load_v * given_a - returned_w)
        return tuple(found)

    def section_of(self, at_m: float) -> int:
        """Return the first section that contains this chainage. Raises NetworkError.

        A train up to END_M outside of all sections belongs to the nearest one.
        """
        for index, section in enumerate(self.sections):
            low_m, high_m = sorted((section.begin_m, section.end_m))
            if low_m <= at_m <= high_m:
                return index
        outside_m = [
            max(min(each.begin_m, each.end_m) - at_m, at_m - max(each.begin_m, each.end_m))
            for each in self.sections
        ]
        if min(outside_m) > END_M:
            raise NetworkError(f"no section at {at_m:g} m")
        return outside_m.index(min(outside_m))

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
        sources, loads = _rows(flow.SOURCE_ROWS, nodes), _rows(3, nodes)
        for here, everywhere in zip(self.sources, sources, strict=True):
            for joint, node in enumerate(of_joint):
                everywhere[node] = here[joint]
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
        given_w = taken_w = rectifiers_w = stations_w = lines_w = 0.0
        for node, voltage_v in enumerate(volts):
            if parent[node] >= 0:
                fall_v = voltage_v - volts[parent[node]]
                lines_w += siemens[node] * fall_v * fall_v
            if sources[flow.GIVES_OHM][node] <= 0.0:
                continue
            current_a = flow.given_a(voltage_v, node, sources, self.limits)
            taken_a = flow.taken_a(voltage_v, node, sources, self.limits)
            gives_v, takes_v = sources[flow.GIVES_BELOW][node], sources[flow.TAKES_ABOVE][node]
            given_w += gives_v * current_a
            taken_w += takes_v * taken_a
            rectifiers_w += (gives_v - voltage_v) * current_a + (voltage_v - takes_v) * taken_a
            stations_w += flow.IDLE_S * voltage_v * voltage_v
        stored = [self._storage_w(storage) for storage in self.storages]
        out_w, in_w = sum([given for given, _ in stored]), sum([taken for _, taken in stored])
        return Balance(
            sources_w=given_w - out_w - (taken_w - in_w),
            rectifiers_w=rectifiers_w,
            stations_w=stations_w,
            lines_w=lines_w,
            trains_w=sum([train.voltage_v * train.current_a for train in fed]),
            returned_w=taken_w - in_w,
            storages_w=out_w - in_w,
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
