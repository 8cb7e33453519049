"""A radio that sends to no one and receives nothing, for a device that needs none."""

from collections.abc import Sequence

from firmware_py.ports import LinkCounters, RadioMessage


class SilentRadio:
    def __init__(self) -> None:
        self.counters = LinkCounters()

    def send(self, now_ns: int, key: str, payload: bytes) -> None:
        self.counters.dropped_out += 1

    def receive(self, now_ns: int) -> Sequence[RadioMessage]:
        return ()

    def close(self) -> None: ...
