"""Commands of supervision to masters and to trains."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Final

from zenoh_config.t2t import SUPERVISION, Heartbeat, LineOrder, OrderKind, T2tMessage
from zenoh_config.t2t_supervision import Removal

ORDER_REPEATS: Final = 10
SERVICE: Final = frozenset((OrderKind.OUT_OF_SERVICE, OrderKind.IN_SERVICE))
"""Commands that the train itself must receive, because it reports them to every later master."""


@dataclass(slots=True)
class TrainOrder:
    """A command about a train to the master of an area; it is sent repeatedly."""

    kind: OrderKind | None
    """None: take the train off the roster."""
    area: int
    train: int
    left: int = ORDER_REPEATS


@dataclass(slots=True)
class OrderSource:
    """Sends the commands during one incarnation of the wayside."""

    boot: int
    masters: dict[int, Heartbeat] = field(default_factory=dict)
    """Last received heartbeat, by area."""
    _sequence: int = 0

    def says(self, orders: Iterable[TrainOrder], now_ns: int) -> list[T2tMessage]:
        """Return the commands to the present masters and to trains that must receive them.

        A train that returns to service receives its command even if no train commands the area.
        """
        said: list[T2tMessage] = []
        for order in orders:
            master = self.masters.get(order.area)
            if order.left <= 0 or (master is None and order.kind is not OrderKind.IN_SERVICE):
                continue
            order.left -= 1
            if master is not None:
                said.append(self._said(order, master.term, master.source, now_ns, master.stamp_ns))
            if order.kind in SERVICE:
                term = 0 if master is None else master.term
                said.append(self._said(order, term, order.train, now_ns))
        return said

    def _said(
        self, order: TrainOrder, term: int, to: int, now_ns: int, echo_ns: int = 0
    ) -> T2tMessage:
        self._sequence += 1
        head = (SUPERVISION, to, order.area, term, self.boot, self._sequence, now_ns)
        if order.kind is None:
            return Removal(*head, echo_ns, order.train)
        return LineOrder(*head, order.kind, order.train)
