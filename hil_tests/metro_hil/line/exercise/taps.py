"""The state of each train's ATP from its own bus, which needs neither radio nor wayside."""

from collections.abc import Iterable, Iterator
from typing import Final, NamedTuple

from can_dbc.codec import Decoder
from can_dbc.vobc import Supervision, VobcMode, VobcStatus
from firmware_py.ports import CanFrame, CanPort

SEEN: Final = (VobcStatus, VobcMode)
RECEIVED_IDS: Final = Decoder(SEEN).ids


class ProtectionOutput(NamedTuple):
    at_ns: int
    train: int
    supervision: Supervision
    cause: int


class ProtectionTap:
    """Listens to one train's bus.

    It reports an emergency with its cause, which comes some frames later.
    """

    def __init__(self, train: int, port: CanPort) -> None:
        self._train, self._port = train, port
        self._decoder = Decoder(SEEN)
        self._emergency = False

    @property
    def dropped(self) -> int:
        """Frames for which the inbox had no room."""
        return self._port.counters.dropped_in

    def on_message(self, now_ns: int) -> Iterator[ProtectionOutput]:
        yield from self._said(self._port.receive(now_ns))

    def _said(self, frames: Iterable[CanFrame]) -> Iterator[ProtectionOutput]:
        for frame in frames:
            heard = self._decoder.decode(frame.can_id, frame.data, frame.stamp_ns)
            if isinstance(heard, VobcStatus):
                self._emergency = heard.supervision is Supervision.EMERGENCY
                if not self._emergency:
                    yield ProtectionOutput(frame.stamp_ns, self._train, heard.supervision, 0)
            elif isinstance(heard, VobcMode) and self._emergency:
                yield ProtectionOutput(
                    frame.stamp_ns, self._train, Supervision.EMERGENCY, heard.cause
                )
