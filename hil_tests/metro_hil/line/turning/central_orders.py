"""Orders of a network's centre to one train.

The train has a wayside of its own with platform doors. Its centre repeats what the centre of the
network orders.
"""

from dataclasses import replace
from typing import Protocol

from firmware_py.ports import RadioMessage
from firmware_py.trackdb import LineMap
from firmware_py.trackdb.version import database_version
from plant_emulator.wayside.centre import Centre
from plant_emulator.wayside.railway import Railway
from zenoh_config.codec import SafetyKey, unpack
from zenoh_config.messages import TrainOrders


class OrderSession(Protocol):
    """The session of a train, by the time of the network."""

    order: RadioMessage | None
    """The newest order to the train on its present path."""

    def send(self, now_ns: int, key: str, payload: bytes) -> None: ...


class CentralOrders:
    """Passes each status of a train to the centre, and the centre's orders to the train."""

    def __init__(
        self, session: OrderSession, railway: Railway, line: LineMap, key: SafetyKey
    ) -> None:
        """Args:
        railway: the wayside of the train's own.
        line: path of the trip.
        key: of safety codes, which the controller uses, too.
        """
        railway.use_key(key)
        self._session, self._centre, self._key = session, railway.centre, key
        self._database = database_version(line)
        self._echo_ns = -1
        railway.on_status = self._on_status

    def _on_status(self, message: RadioMessage) -> None:
        self._session.send(message.stamp_ns, message.key, message.payload)

    def obey(self, train: int) -> None:
        """Let the train's own centre repeat the newest order."""
        message, self._session.order = self._session.order, None
        if message is None:
            return
        orders = unpack(message.payload, self._key, database=self._database)
        is_new = isinstance(orders, TrainOrders) and orders.echo_stamp_ns > self._echo_ns
        if not isinstance(orders, TrainOrders) or not is_new or orders.train != train:
            return
        self._echo_ns = orders.echo_stamp_ns
        repeat(self._centre, orders)


def repeat(centre: Centre, orders: TrainOrders) -> None:
    """Let a centre give the orders of supervision that another one gave."""
    centre.standing = replace(
        centre.standing, hold=orders.hold, skip_next=orders.skip_next, emergency=orders.emergency
    )
    centre.releases, centre.released_emergency = orders.releases, orders.released_emergency
