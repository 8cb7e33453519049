"""What supervision wants of those who command, and of trains."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Final

from zenoh_config.t2t import SUPERVISION, Heartbeat, LineOrder, OrderKind, T2tMessage
from zenoh_config.t2t_supervision import Removal

ORDER_REPEATS: Final = 10
SERVICE: Final = frozenset((OrderKind.OUT_OF_SERVICE, OrderKind.IN_SERVICE))
"""A train has to know of these itself: it tells every master there will be."""


@dataclass(slots=True)
class TrainOrder:
    """Of the master of an area, for a train; said again and again."""

    kind: OrderKind | None
    """None: take it off the roster."""
    area: int
    train: int
    left: int = ORDER_REPEATS


@dataclass(slots=True)
class OrderSource:
    """Says them, in one life of the wayside."""

    boot: int
    masters: dict[int, Heartbeat] = field(default_factory=dict)
    """By area, the last that was heard."""
    _sequence: int = 0

    def says(self, orders: Iterable[TrainOrder], now_ns: int) -> list[T2tMessage]:
        """To whoever commands each area at present, and to a train that has to know it itself: also
        where nobody commands if it may do so again.
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
