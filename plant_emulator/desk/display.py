"""The desk's display: the controller's latest frames from the train bus."""

from typing import Final, TypeVar

from can_dbc.binding import Frame, message
from can_dbc.doors import DoorCars, DoorCommand
from can_dbc.vobc import (
    VobcLimits,
    VobcMode,
    VobcMotion,
    VobcPosition,
    VobcStatus,
    VobcSupervision,
    VobcTarget,
)

KINDS: Final[tuple[type[Frame], ...]] = (
    VobcStatus,
    VobcMotion,
    VobcMode,
    VobcPosition,
    VobcTarget,
)
"""Frames that a driver model uses."""
SCREEN_KINDS: Final[tuple[type[Frame], ...]] = (
    *KINDS,
    VobcLimits,
    VobcSupervision,
    DoorCommand,
    DoorCars,
)
"""Frames that the screen shows to a person."""
FRESH_NS: Final = 500_000_000
"""Age beyond which a frame is not shown: two and a half periods of the slowest, VOBC_TARGET."""
NS_PER_S: Final = 1_000_000_000

Shown = TypeVar("Shown", bound=Frame)


class DeskDisplay:
    """Stores the last frame of each kind and returns it while it is fresh."""

    __slots__ = ("_received",)

    def __init__(self) -> None:
        self._received: dict[type[Frame], tuple[Frame, int]] = {}

    def hear(self, frame: Frame, now_ns: int) -> None:
        """Store a frame; frames of other kinds are ignored."""
        if isinstance(frame, SCREEN_KINDS):
            self._received[type(frame)] = (frame, now_ns)

    def latest(self, kind: type[Shown], now_ns: int) -> Shown | None:
        """Return the last frame of a kind; None before the first, and when it is too old."""
        frame, heard_ns = self._received.get(kind, (None, 0))
        if not isinstance(frame, kind) or now_ns - heard_ns > FRESH_NS:
            return None
        return frame

    def speeds(self, now_ns: int) -> VobcMotion | None:
        """Return the speeds on the display; None when the display is dark."""
        return self.latest(VobcMotion, now_ns)

    def silence(self, now_ns: int) -> str:
        """Describe which frames the controller stopped sending and since when; empty while all are
        fresh.
        """
        lost = {
            kind: now_ns - heard_ns
            for kind, (_, heard_ns) in self._received.items()
            if now_ns - heard_ns > FRESH_NS
        }
        if not self._received:
            return "no frame from the controller yet"
        if len(lost) == len(self._received):
            return f"controller silent for {min(lost.values()) // NS_PER_S} s"
        return ", ".join(
            f"{message(kind).name} silent for {age_ns // NS_PER_S} s"
            for kind, age_ns in lost.items()
        )
