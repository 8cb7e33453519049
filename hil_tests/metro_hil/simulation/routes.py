"""Routing of messages between the simulated nodes."""

from collections.abc import Sequence

from metro_hil.simulation.node import QueuedMessage
from zenoh_config.messages import WAYSIDE
from zenoh_config.t2t import BROADCAST, SUPERVISION, Heartbeat, T2tMessage


class Routes:
    """Determines which nodes receive a message, as the radio's key expressions do."""

    def __init__(self, trains: Sequence[int]) -> None:
        self._others = {
            source: tuple(each for each in trains if each != source) for source in trains
        }
        self._trains = tuple(trains)
        self._heartbeat = {source: (*others, WAYSIDE) for source, others in self._others.items()}
        # The supervision console is simulated as part of the wayside.
        self._one: dict[int, tuple[int, ...]] = {SUPERVISION: (WAYSIDE,)}

    def letters(self, out: Sequence[T2tMessage]) -> list[QueuedMessage]:
        return [
            QueuedMessage(
                self._targets(message),
                message,
                message.area if message.destination == BROADCAST else None,
            )
            for message in out
        ]

    def _targets(self, message: T2tMessage) -> tuple[int, ...]:
        destination = message.destination
        if destination == BROADCAST:
            if type(message) is Heartbeat:
                return self._heartbeat[message.source]
            return self._others.get(message.source, self._trains)
        one = self._one.get(destination)
        if one is None:
            one = self._one[destination] = (destination,)
        return one
