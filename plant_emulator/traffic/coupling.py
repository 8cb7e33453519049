"""Couples the trains of a line: the DC network, and authorities behind the leader.

Once an interval each train reports its power demand. It receives its voltage. On a line in one
direction it also reports its rear, and receives that of the train ahead.
"""

import math
from bisect import bisect_right
from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

from firmware_py.trackdb import LineZone
from plant_emulator.power import flow
from plant_emulator.power.network import Balance, Load
from plant_emulator.power.supplies import Supply
from plant_emulator.traffic.config import TrafficConfig

INTERVAL_NS: Final = 200_000_000
INTERVAL_S: Final = INTERVAL_NS / 1e9
REAR_STEP_M: Final = 25.0
"""Step in which followers receive the leader's rear. A step bounds the number of authority changes
on board."""
CLEAR_M: Final = 1.0e6
"""Rear of the train ahead of the foremost one on an open line: beyond every line."""


class IntervalReport(NamedTuple):
    """Report of a train about the last interval; powers are means."""

    front_m: float
    speed_mps: float
    rear_m: float
    """Rear end of the track reserved for the train. No follower's authority extends beyond it."""
    traction_w: float
    regenerated_w: float
    auxiliary_w: float


class CouplingAnswer(NamedTuple):
    """Answer to a train, valid from now on."""

    voltage_v: float
    current_a: float
    """Current from the line; negative while the train feeds back."""
    chopped_ratio: float
    effort_ratio: float
    leader_rear_m: float
    """Rear of the leader in the train's own chainage; far away without a train ahead."""


class Books:
    """Energy balance of the network since its start, in J."""

    def __init__(self) -> None:
        self.sources_j = self.rectifiers_j = self.stations_j = self.lines_j = self.trains_j = 0.0
        self.regenerated_j = self.resistor_j = self.traction_j = self.auxiliary_j = 0.0
        self.returned_j = self.storages_j = 0.0
        """Energies that inverters returned to the grid, and that storages gave less what they took.
        """
        self.lowest_v, self.highest_v = 1.0e9, 0.0
        self.drawn_j: dict[str, float] = {}
        """Energy that trains took from each power section of the line, by name."""
        self.fed_back_j: dict[str, float] = {}
        """Energy that trains gave to each power section, likewise."""

    def name_sections(self, names: Iterable[str]) -> None:
        """Open an account for each power section of the line or network."""
        for name in names:
            self.drawn_j[name] = self.fed_back_j[name] = 0.0

    def book_section(self, name: str, net_j: float) -> None:
        """Book what a train took from a section; negative for what it gave back."""
        book = self.drawn_j if net_j >= 0.0 else self.fed_back_j
        book[name] += abs(net_j)

    @property
    def lost_j(self) -> float:
        """Energy that became heat in substations, storages, feeders and rails."""
        return self.rectifiers_j + self.stations_j + self.lines_j

    @property
    def closure_ratio(self) -> float:
        """Energy of the sources minus all consumption, divided by the energy from the grid."""
        became_j = self.rectifiers_j + self.stations_j + self.lines_j + self.trains_j
        given_j = self.sources_j + self.storages_j
        return (given_j - became_j) / max(1.0, self.sources_j + self.returned_j)


class TrainFeed(NamedTuple):
    """What the network gives one train, valid from now on."""

    voltage_v: float
    current_a: float
    """Current from the line; negative while the train feeds back."""
    chopped_ratio: float
    """Share of the regenerated power that goes into the train's own resistor."""
    effort_ratio: float
    """Share of the tractive effort that the voltage permits."""

    @property
    def net_j(self) -> float:
        """Energy that the train takes in an interval; negative while it feeds back."""
        return self.voltage_v * self.current_a * INTERVAL_S


class PowerCoupling:
    """The DC network of all trains and its books, solved once an interval."""

    def __init__(self, supply: Supply) -> None:
        self.network = supply.network()
        self.books = Books()
        self.substations_w: tuple[float, ...] = ()
        """Power of each substation in the last interval."""

    def feed(self, loads: Sequence[Load]) -> list[TrainFeed]:
        """Solve one interval with the mean powers of all trains; results in their order."""
        fed, balance = self.network.solve(loads)
        self._book(loads, balance)
        self.substations_w = self.network.delivered_w()
        self.network.advance(INTERVAL_S)
        limits, books, found = self.network.limits, self.books, []
        for each in fed:
            volts = each.voltage_v
            effort, _ = flow.effort_share(volts, limits)
            chopped, _ = flow.chopped_share(volts, limits)
            books.lowest_v = min(books.lowest_v, volts)
            books.highest_v = max(books.highest_v, volts)
            books.traction_j += each.traction_w * INTERVAL_S
            books.regenerated_j += each.regenerated_w * INTERVAL_S
            books.resistor_j += each.resistor_w * INTERVAL_S
            found.append(TrainFeed(volts, each.current_a, chopped, effort))
        return found

    def _book(self, loads: Sequence[Load], balance: Balance) -> None:
        books = self.books
        books.sources_j += balance.sources_w * INTERVAL_S
        books.rectifiers_j += balance.rectifiers_w * INTERVAL_S
        books.stations_j += balance.stations_w * INTERVAL_S
        books.lines_j += balance.lines_w * INTERVAL_S
        books.trains_j += balance.trains_w * INTERVAL_S
        books.returned_j += balance.returned_w * INTERVAL_S
        books.storages_j += balance.storages_w * INTERVAL_S
        books.auxiliary_j += sum(load.auxiliary_w for load in loads) * INTERVAL_S


class Coupling(PowerCoupling):
    """Coupling of all trains of a line in one direction, the foremost first."""

    def __init__(
        self, config: TrafficConfig, supply: Supply, sections: Sequence[LineZone] = ()
    ) -> None:
        """Args:
        sections: power sections of the line. A train belongs to that of its front.
        """
        super().__init__(supply)
        self._config = config
        self._sections = sections
        self._starts_m = [each.start_m for each in sections]
        self.books.name_sections(each.name for each in sections)

    def answers(self, said: Sequence[IntervalReport]) -> list[CouplingAnswer]:
        """Solve one interval for the whole line."""
        loads = [
            Load(
                self._config.place_m(each.front_m),
                each.traction_w,
                each.regenerated_w,
                each.auxiliary_w,
            )
            for each in said
        ]
        feeds = self.feed(loads)
        for each, feed in zip(said, feeds, strict=True):
            self._book_section(each.front_m, feed.net_j)
        return [
            CouplingAnswer(*feed, self._leader_rear_m(train, said))
            for train, feed in enumerate(feeds)
        ]

    def _book_section(self, front_m: float, net_j: float) -> None:
        index = bisect_right(self._starts_m, front_m) - 1
        if index >= 0 and front_m < self._sections[index].end_m:
            self.books.book_section(self._sections[index].name, net_j)

    def _leader_rear_m(self, train: int, said: Sequence[IntervalReport]) -> float:
        """Return the rear of the train ahead.

        On a circuit the foremost train follows the last, which is a lap behind in chainage.
        """
        behind_m = said[train - 1].rear_m + (self._config.lap_m if train == 0 else 0.0)
        if train == 0 and not self._config.circular:
            return CLEAR_M
        return math.floor(behind_m / REAR_STEP_M) * REAR_STEP_M
