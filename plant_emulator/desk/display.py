"""What the desk's display shows: the controller's own words, as they come over the train bus."""

from typing import Final

from can_dbc.binding import Frame
from can_dbc.doors import DoorCommand
from can_dbc.vobc import VobcMode, VobcMotion, VobcPosition, VobcStatus, VobcTarget

KINDS: Final[tuple[type[Frame], ...]] = (
    VobcStatus,
    VobcMotion,
    VobcMode,
    VobcPosition,
    VobcTarget,
)
"""Frames that a driver goes by."""
SCREEN_KINDS: Final[tuple[type[Frame], ...]] = (*KINDS, DoorCommand)
"""Frames that a person is shown."""
FRESH_NS: Final = 500_000_000
"""Older speeds are not shown."""


class DeskDisplay:
    """The last of each frame; None before the first."""

    __slots__ = ("_motion_ns", "doors", "mode", "motion", "position", "status", "target")

    def __init__(self) -> None:
        self.status: VobcStatus | None = None
        self.motion: VobcMotion | None = None
        self.mode: VobcMode | None = None
        self.position: VobcPosition | None = None
        self.target: VobcTarget | None = None
        self.doors: DoorCommand | None = None
        self._motion_ns = 0

    def hear(self, frame: Frame, now_ns: int) -> None:
        """Frames of other kinds are passed over."""
        if isinstance(frame, VobcMotion):
            self.motion = frame
            self._motion_ns = now_ns
        elif isinstance(frame, VobcStatus):
            self.status = frame
        elif isinstance(frame, VobcMode):
            self.mode = frame
        elif isinstance(frame, VobcPosition):
            self.position = frame
        elif isinstance(frame, VobcTarget):
            self.target = frame
        elif isinstance(frame, DoorCommand):
            self.doors = frame

    def speeds(self, now_ns: int) -> VobcMotion | None:
        """None when the display is dark."""
        if self.motion is None or now_ns - self._motion_ns > FRESH_NS:
            return None
        return self.motion
