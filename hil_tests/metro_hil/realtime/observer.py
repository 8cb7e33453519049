"""Receives frames from the taps and truth from the plant; logs them and passes them to monitors."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Protocol

from can_dbc.binding import can_id, kinds, sender
from can_dbc.brake import BrakeCommand
from can_dbc.codec import Decoder, Rejected
from can_dbc.nodes import Node
from can_dbc.vobc import VobcPosition, VobcStatus
from firmware_py.buses.timing import frame_bits
from firmware_py.ports import CanFrame, CanPort
from firmware_py.storage.recorder import CandumpWriter
from metro_hil.metrics.brake_reports import BrakeReports
from metro_hil.model.frame_hash import FrameHash
from metro_hil.monitors.description import CONTROLLER_IDS as SAID_IDS
from metro_hil.realtime.merge import Merge
from plant_emulator.truth import Truth

CONTROLLER_IDS: Final = frozenset(
    can_id(kind) for kind in kinds() if sender(kind) == Node.VOBC.name
)
"""Identifiers of the controller's frames, without twins."""
BRAKE_ID: Final = can_id(BrakeCommand)
STATUS_ID: Final = can_id(VobcStatus)
NS_PER_S: Final = 1_000_000_000


class Monitors(Protocol):
    """Monitors that judge a run while it goes on."""

    def frame(self, stamp_ns: int, can_id: int, data: bytes) -> None: ...

    def said(self, now_ns: int, can_id: int, data: bytes) -> None: ...

    def sample(self, truth: Truth, now_ns: int) -> None: ...


@dataclass(frozen=True, slots=True)
class ControllerFrame:
    """A frame of the controller on its own segment, before the gateway could change it."""

    frame: CanFrame


@dataclass(slots=True)
class SegmentTap:
    """Listens to one segment and logs all of its frames."""

    port: CanPort
    log: CandumpWriter
    offset_ns: int
    """Offset from a stamp to nanoseconds since 1970."""
    frames: int = 0
    bits: int = 0

    def take(self, now_ns: int) -> Sequence[CanFrame]:
        frames = self.port.receive(now_ns)
        for frame in frames:
            self.log.frame(
                frame.stamp_ns + self.offset_ns,
                frame.can_id,
                frame.data,
                extended=frame.extended,
                remote=frame.remote,
                error=frame.error,
            )
            self.bits += frame_bits(frame.can_id, frame.data, frame.extended, frame.remote)
        self.frames += len(frames)
        return frames

    @property
    def alive(self) -> bool:
        """Whether the bus is still there."""
        return bool(getattr(self.port, "alive", True))


class RunObserver:
    """Passes everything on in the order of its instants, counted from the start of the run."""

    def __init__(
        self,
        monitors: Monitors,
        *,
        train: SegmentTap,
        controller: SegmentTap,
        cycle_id: int,
        on_cycle: Callable[[int], None],
    ) -> None:
        """Connect taps and monitors.

        Args:
            train: tap of the train's segment; its frames are hashed, and the train's units receive
                them.
            controller: tap of the controller's segment; the same one without a gateway. With a
                gateway the controller's frames are judged here.
            cycle_id: identifier of the frame that marks a control cycle.
            on_cycle: receives the instant of each such frame.
        """
        self.train, self.controller = train, controller
        self.chain = FrameHash()
        self.brake_reports = BrakeReports()
        self._monitors, self._cycle_id, self._on_cycle = monitors, cycle_id, on_cycle
        self._merge: Merge[CanFrame | ControllerFrame | Truth] = Merge()
        self._decoder = Decoder((VobcStatus, VobcPosition))
        self.status: VobcStatus | None = None
        self.position: VobcPosition | None = None
        self.origin_ns: int | None = None
        """Start of the run on the machine's clock; earlier frames are not judged."""
        self.controller_last_ns: int | None = None
        self.starts_ns: list[int] = []
        """Instant of the first frame after each start of the controller."""
        self._start_awaited = True
        self._over = False

    def await_start(self) -> None:
        """Expect the first frame of a restarted controller; no earlier frame is on its way."""
        self._start_awaited = True

    def frames(self, now_ns: int) -> None:
        """Take the frames that have arrived."""
        split = self.train is not self.controller
        for frame in self.controller.take(now_ns):
            if frame.can_id in CONTROLLER_IDS and _is_common(frame):
                self._note_controller(frame)
            if not split:
                self._merge.add(frame.stamp_ns, frame)
            elif frame.can_id in SAID_IDS and _is_common(frame):
                self._merge.add(frame.stamp_ns, ControllerFrame(frame))
        if split:
            for frame in self.train.take(now_ns):
                self._merge.add(frame.stamp_ns, frame)

    def truth(self, truth: Truth, stamp_ns: int) -> None:
        """Take one sample of truth; the first one defines the start of the run."""
        if self.origin_ns is None:
            self.origin_ns = stamp_ns - round(truth.t_s * NS_PER_S)
        self._merge.add(stamp_ns, truth)

    def judge(self, now_ns: int) -> None:
        """Pass on the items that are old enough to be in order."""
        origin_ns = self.origin_ns
        if origin_ns is None or self._over:
            return
        for stamp_ns, thing in self._merge.due(now_ns):
            self._hand_on(stamp_ns - origin_ns, thing)

    def finish(self) -> None:
        """Pass on the rest at the end of the case. Later frames are logged, but not judged."""
        if self.origin_ns is not None:
            for stamp_ns, thing in self._merge.rest():
                self._hand_on(stamp_ns - self.origin_ns, thing)
        self._over = True

    @property
    def controller_heard(self) -> bool:
        """Whether the controller has sent a frame since the bench began to listen."""
        return bool(self.starts_ns)

    @property
    def dropped_frames(self) -> int:
        taps = (self.train,) if self.train is self.controller else (self.train, self.controller)
        return sum(tap.port.counters.dropped_in for tap in taps)

    def _hand_on(self, run_ns: int, thing: CanFrame | ControllerFrame | Truth) -> None:
        if isinstance(thing, Truth):
            self._monitors.sample(thing, run_ns)
        elif run_ns < 0:
            return
        elif isinstance(thing, ControllerFrame):
            self._monitors.said(run_ns, thing.frame.can_id, thing.frame.data)
        elif _is_common(thing):
            self.chain.frame(run_ns, thing.can_id, thing.data)
            self._monitors.frame(run_ns, thing.can_id, thing.data)
            self.brake_reports.frame(run_ns, thing.can_id, thing.data)

    def _note_controller(self, frame: CanFrame) -> None:
        if self._start_awaited:
            self._start_awaited = False
            self.starts_ns.append(frame.stamp_ns)
        self.controller_last_ns = frame.stamp_ns
        if frame.can_id == self._cycle_id:
            self._on_cycle(frame.stamp_ns)
        heard = self._decoder.decode(frame.can_id, frame.data, frame.stamp_ns)
        if heard is None or isinstance(heard, Rejected):
            return
        if isinstance(heard, VobcStatus):
            self.status = heard
        elif isinstance(heard, VobcPosition):
            self.position = heard


def _is_common(frame: CanFrame) -> bool:
    """Tell whether a node of a train can have sent the frame: an 11-bit data frame."""
    return not (frame.extended or frame.remote or frame.error)
