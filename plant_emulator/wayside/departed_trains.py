"""Reports trains that went on over another path to the masters of the path that they have left.

A train that changes ends stays on the roster of the area where it stood, as a silent train. When it
has left that area, this part of the wayside says so by the message with which a person reports a
train as gone. The master checks it as it does for a person: while axles are counted where the train
may be, it keeps the train. Pure.
"""

from collections.abc import Callable, Iterable
from typing import Final

from firmware_py.ports import RadioMessage
from zenoh_config import t2t_keys
from zenoh_config.codec import BENCH_KEY, SafetyKey, pack, unpack
from zenoh_config.t2t import SUPERVISION, Heartbeat
from zenoh_config.t2t_supervision import Removal, RemovalAnswer, RemovalState

PERIOD_NS: Final = 200_000_000
"""Time between two repetitions until the master answers that the train is gone."""


class DepartedTrains:
    """The trains that have left one path and are not known to be off its rosters yet."""

    def __init__(self, line_name: str, *, database: int | None, key: SafetyKey = BENCH_KEY) -> None:
        self.subscriptions = t2t_keys.of_departures(line_name)
        self.left: set[tuple[int, int]] = set()
        """Number and area of each."""
        self._line_name, self._database, self._key = line_name, database, key
        self._beats: dict[int, Heartbeat] = {}
        """The newest heartbeat of the highest term by area."""
        self._due_ns = 0
        self._sequence = 0

    def leaves(self, train: int, areas: Iterable[int]) -> None:
        """A train takes no part in these areas any more."""
        self.left |= {(train, area) for area in areas}

    def enters(self, train: int) -> None:
        """A train takes part in the line again, so it speaks for itself."""
        self.left = {each for each in self.left if each[0] != train}

    def step(
        self,
        now_ns: int,
        messages: Iterable[RadioMessage],
        is_clear: Callable[[int, int], bool],
    ) -> list[tuple[str, bytes]]:
        """Return key and payload of all messages to send.

        Args:
            is_clear: whether no part of a train, by its number, stands in an area.
        """
        for message in messages:
            self._on_message(message)
        if now_ns < self._due_ns:
            return []
        self._due_ns = now_ns + PERIOD_NS
        return [
            self._removal(now_ns, train, self._beats[area])
            for train, area in sorted(self.left)
            if area in self._beats and is_clear(train, area)
        ]

    def _on_message(self, message: RadioMessage) -> None:
        opened = unpack(message.payload, self._key, database=self._database)
        if isinstance(opened, Heartbeat):
            before = self._beats.get(opened.area)
            if before is None or (before.term, before.stamp_ns) <= (opened.term, opened.stamp_ns):
                self._beats[opened.area] = opened
        elif isinstance(opened, RemovalAnswer) and opened.state is RemovalState.GONE:
            self.left.discard((opened.train, opened.area))

    def _removal(self, now_ns: int, train: int, beat: Heartbeat) -> tuple[str, bytes]:
        self._sequence += 1
        head = (SUPERVISION, beat.source, beat.area, beat.term, 1, self._sequence, now_ns)
        removal = Removal(*head, beat.stamp_ns, train)
        payload = pack(removal, self._key, database=self._database)
        return t2t_keys.key_of(self._line_name, removal), payload
