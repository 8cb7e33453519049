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
class Order:
    """Of the master of an area, for a train; said again and again."""

    kind: OrderKind | None
    """None: take it off the roster."""
    area: int
    train: int
    left: int = ORDER_REPEATS


@dataclass(slots=True)
class Desk:
    """Says them, in one life of the wayside."""

    boot: int
    masters: dict[int, Heartbeat] = field(default_factory=dict)
    """By area, the last that was heard."""
    _sequence: int = 0

    def says(self, orders: Iterable[Order], now_ns: int) -> list[T2tMessage]:
        """To whoever commands each area at present."""
        said: list[T2tMessage] = []
        for order in orders:
            master = self.masters.get(order.area)
            if master is None or order.left <= 0:
                continue
            order.left -= 1
            said.append(self._said(order, master, master.source, now_ns))
            if order.kind in SERVICE:
                said.append(self._said(order, master, order.train, now_ns))
        return said

    def _said(self, order: Order, master: Heartbeat, to: int, now_ns: int) -> T2tMessage:
        self._sequence += 1
        head = (SUPERVISION, to, order.area, master.term, self.boot, self._sequence, now_ns)
        if order.kind is None:
            return Removal(*head, master.stamp_ns, order.train)
        return LineOrder(*head, order.kind, order.train)
