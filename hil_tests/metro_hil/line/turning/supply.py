"""The supply network of trains that turn round, on all tracks of their network."""

import copy
from collections.abc import Mapping, Sequence
from math import nan
from typing import Final, NamedTuple, Protocol

from firmware_py.trackdb.network import TrackNetwork
from firmware_py.trackdb.paths import TrackPlace
from metro_hil.line.energy import FullService
from metro_hil.model.network_places import NetworkAxis
from plant_emulator.power import HighVoltageBox
from plant_emulator.power.box import Due
from plant_emulator.power.network import Load
from plant_emulator.power.supplies import Supply
from plant_emulator.traffic.coupling import INTERVAL_S, Books, PowerCoupling, TrainFeed

NS_PER_S: Final = 1_000_000_000
ROW_NS: Final = 1_000_000_000
"""Time between two rows of the record."""


class SupplyRow(NamedTuple):
    """One instant of the supply network."""

    at_s: float
    trains_v: Mapping[int, float]
    """Voltage at the pantograph of each train on the network, by its number."""
    substations_w: tuple[float, ...]


class FedTrain(Protocol):
    """The parts of a train that its supply needs, as `TurningTrain` has them."""

    @property
    def number(self) -> int: ...

    @property
    def power(self) -> HighVoltageBox | None: ...

    @property
    def on_network(self) -> bool: ...

    @property
    def front(self) -> TrackPlace: ...

    @property
    def middle(self) -> TrackPlace: ...

    def feed(self, feed: TrainFeed, due: Due) -> None: ...


class FleetSupply:
    """Solves the supply network for all trains once an interval."""

    def __init__(self, supply: Supply, network: TrackNetwork, *, headway_s: float) -> None:
        """Args:
        headway_s: the service's; 0 without a timetable.
        """
        self.coupling = PowerCoupling(supply)
        self.rows: list[SupplyRow] = []
        """One row each second."""
        self._network, self._axis = network, NetworkAxis(network)
        sections = (each for track in network.tracks for each in track.power_sections)
        self.coupling.books.name_sections(each.name for each in sections)
        self._at_m: dict[int, float] = {}
        """Place of each train on the network's axis in the last interval."""
        self._period_ns = round(max(headway_s, INTERVAL_S) * NS_PER_S)
        self._began: tuple[int, Books] | None = None
        """The first instant at which all trains ran, and the books then."""
        self._ended: tuple[int, Books] | None = None

    def step(self, now_ns: int, trains: Sequence[FedTrain]) -> None:
        """Account for the time since the last call, at most an interval, and feed all trains."""
        fed: list[tuple[FedTrain, Due]] = []
        loads: list[Load] = []
        for train in trains:
            if train.power is None:
                continue
            if train.on_network:
                self._at_m[train.number] = self._axis.place_m(train.middle)
            wish, due = train.power.take_load(INTERVAL_S)
            if train.on_network or any(due):
                powers_w = wish.traction_w, wish.regenerated_w, wish.auxiliary_w
                loads.append(Load(self._at_m[train.number], *powers_w))
                fed.append((train, due))
        feeds = self.coupling.feed(loads)
        for (train, due), feed in zip(fed, feeds, strict=True):
            train.feed(feed, due)
            self._book_section(train, feed.net_j)
        if now_ns % ROW_NS == 0:
            volts = {
                train.number: feed.voltage_v
                for (train, _), feed in zip(fed, feeds, strict=True)
                if train.on_network
            }
            self.rows.append(SupplyRow(now_ns / NS_PER_S, volts, self.coupling.substations_w))
        if all(train.on_network for train in trains):
            self._note(now_ns)

    def _book_section(self, train: FedTrain, net_j: float) -> None:
        """Book the energy of a train in the power section of its front."""
        if not train.on_network:
            return
        front = train.front
        for each in self._network.track(front.track).power_sections:
            if each.start_m <= front.at_m <= each.end_m:
                self.coupling.books.book_section(each.name, net_j)
                return

    def _note(self, now_ns: int) -> None:
        """Note the books while all trains run."""
        if self._began is None:
            self._began = now_ns, copy.copy(self.coupling.books)
        elif (now_ns - self._began[0]) % self._period_ns == 0:
            self._ended = now_ns, copy.copy(self.coupling.books)

    def volts_of(self, train: int) -> tuple[list[float], list[float]]:
        """Instants in s and voltages of a train; NaN while it is not on the network."""
        return (
            [row.at_s for row in self.rows],
            [row.trains_v.get(train, nan) for row in self.rows],
        )

    @property
    def full_service(self) -> FullService | None:
        """None if all trains did not run together for a headway."""
        if self._began is None or self._ended is None:
            return None
        (began_ns, first), (ended_ns, last) = self._began, self._ended
        return FullService(
            began_ns / NS_PER_S,
            ended_ns / NS_PER_S,
            last.sources_j - first.sources_j,
            last.regenerated_j - first.regenerated_j,
            last.resistor_j - first.resistor_j,
        )
