"""The network terminal of an FMU that emulates several nodes of the train."""

from collections.abc import Sequence

from metro_hil.foreign_plant.fmu import FmuError
from metro_hil.foreign_plant.ls_bus import (
    CAN_TRANSMIT,
    LsBusError,
    frame_of,
    operations,
    transmit,
)
from metro_hil.foreign_plant.terminal_node import TerminalNode

Arrival = tuple[int, int, bytes]
"""Instant of a frame's end, identifier, data."""


class PlantTerminal(TerminalNode):
    """Collects the frames of one step of the plant.

    The FMU receives each frame at the instant at which it ended on the bus.
    """

    frames: list[tuple[int, bytes]]
    """Frames that the FMU sent in the last call."""
    all_texts: list[bytes]
    """Contents of the further outputs in the last call."""

    def begin(self, now_ns: int) -> None:
        super().begin(now_ns)
        self.frames, self.all_texts = [], []
        self._collect()

    def advance(self, until_ns: int, arrivals: Sequence[Arrival]) -> None:
        """Step to `until_ns` with all events on the way. Raises FmuError."""
        self.frames, self.all_texts = [], []
        waiting = [(max(at_ns, self.now_ns), can_id, data) for at_ns, can_id, data in arrivals]
        waiting.reverse()
        while True:
            at_ns = min(until_ns, self.due_ns, waiting[-1][0] if waiting else until_ns)
            received = b""
            while waiting and waiting[-1][0] <= at_ns:
                _, can_id, data = waiting.pop()
                received += transmit(can_id, data)
            self.go(at_ns, received)
            self._collect()
            if at_ns >= until_ns and not waiting:
                return

    def _collect(self) -> None:
        self.all_texts += self.texts
        try:
            for operation in operations(self.sent):
                if operation.code == CAN_TRANSMIT:
                    self.frames.append(frame_of(operation))
        except LsBusError as error:
            raise FmuError(f"LS-BUS: {error}") from error
