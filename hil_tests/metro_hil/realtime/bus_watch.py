"""Watches a run in real time from a tap: logs and displays every frame, and detects the end."""

from collections.abc import Callable, Sequence
from pathlib import Path

from can_dbc.binding import can_id
from can_dbc.brake import BrakeCommand
from can_dbc.vobc import VobcMode, VobcPosition, VobcStatus
from firmware_py.clock.clock import Clock
from firmware_py.clock.executive import Executive, Task, run
from firmware_py.clock.realtime import steal_ns
from firmware_py.clock.watchdog import Watchdog
from firmware_py.ports import CanPort
from firmware_py.storage.recorder import CandumpWriter, LineLog
from metro_hil.model.end_condition import (
    ARRIVED,
    DURATION,
    INTERRUPTED,
    ArrivalWatch,
    Ending,
    HeldEmergencyCondition,
    ShutDoorsCondition,
)
from metro_hil.model.subprocesses import Child
from metro_hil.realtime.live_display import BusPicture, LiveDisplay

DRAIN_MS = 20.0
DISPLAY_MS = 250.0
WINDOW_MS = 1000.0
SILENT_NS = 2_000_000_000
"""Silence after which a controller counts as hung, whatever its process does."""
NS_PER_S = 1_000_000_000
CONTROLLER_ID = can_id(BrakeCommand)
HOST_COLUMNS = ("t_s", "steal_ms", "frames_per_s", "bus_load_ratio")


class BusWatch:
    """Periodic tasks of the tap: drain the bus, refresh the display, compute the bus load."""

    def __init__(
        self,
        tap: CanPort,
        log: CandumpWriter,
        host_log: Path,
        picture: BusPicture,
        display: LiveDisplay,
        clock: Clock,
        *,
        watched: bool = False,
    ) -> None:
        """Args:
        watched: the page of the run reads the log, which then gets each frame at once.
        """
        self._watched = watched
        self._tap, self._log, self._picture, self._display = tap, log, picture, display
        self._clock = clock
        self._host = LineLog(host_log, HOST_COLUMNS)
        self._epoch_offset_ns = clock.epoch_offset_ns
        self._start_ns = clock.now_ns()
        self._steal_start_ns = self._steal_last_ns = steal_ns()
        self._silence = Watchdog(SILENT_NS, self._note_silence, self._start_ns)
        self._controller_heard = False
        self._bits_load_sum = 0.0
        self._windows = 0

    def run(
        self,
        children: Sequence[Child],
        stop_m: float,
        duration_s: float | None,
        interrupted: Callable[[], bool],
        *,
        unattended: bool,
        centre: bool = False,
        restart: Callable[[Child], bool] = lambda child: False,
    ) -> str:
        """Run until arrival, the end of the duration, an interrupt or the end of a child.

        Return the reason of the end.

        Args:
            unattended: no person can reset an emergency brake or open doors by hand.
            centre: supervision of the line runs and may release a train's emergency brake.
            restart: starts the program of a child that ended again, or returns False.
        """
        now_ns = self._clock.now_ns()
        alone = (HeldEmergencyCondition(centre), ShutDoorsCondition()) if unattended else None
        arrival = ArrivalWatch(stop_m)
        end_ns = None if duration_s is None else now_ns + int(duration_s * NS_PER_S)
        reason = ""

        def over(now_ns: int) -> bool:
            nonlocal reason
            ended = [child for child in children if child.ended]
            if interrupted():
                reason = INTERRUPTED
            elif ended and all(restart(child) for child in ended):
                # A restarted controller needs seconds until its first frame.
                self._controller_heard = False
            elif ended:
                reason = f"the {ended[0].name} ended by itself: {ended[0].failure_words()}"
            elif self._controller_heard and not self._silence.check(now_ns):
                reason = f"the controller fell silent for {SILENT_NS / NS_PER_S:.0f} s"
            elif self._arrived(arrival, now_ns):
                reason = ARRIVED
            elif end_ns is not None and now_ns >= end_ns:
                reason = DURATION
            elif alone is not None and (words := self._needs_a_hand(*alone, now_ns)):
                reason = words
            return reason != ""

        tasks = [
            Task("drain", DRAIN_MS, self.drain),
            Task("window", WINDOW_MS, self._close_window),
            Task("display", DISPLAY_MS, self._display.refresh, offset_ms=DISPLAY_MS),
        ]
        self._display.start(now_ns)
        try:
            run([Executive(tasks, now_ns)], self._clock, over)
        finally:
            self._display.stop()
        return reason

    def drain(self, now_ns: int) -> None:
        """Move the received frames into log and picture."""
        offset_ns, picture = self._epoch_offset_ns, self._picture
        received = self._tap.receive(now_ns)
        for frame in received:
            self._log.frame(frame.stamp_ns + offset_ns, frame.can_id, frame.data)
            picture.take(frame)
            if frame.can_id == CONTROLLER_ID:
                self._controller_heard = True
                self._silence.kick(frame.stamp_ns)
        if received and self._watched:
            self._log.flush()

    def _note_silence(self, silent_ns: int) -> None:
        words = f"the controller has been silent for {silent_ns / NS_PER_S:.1f} s"
        self._display.say(words)

    def _close_window(self, now_ns: int) -> None:
        picture = self._picture
        picture.close_window(now_ns)
        self._bits_load_sum += picture.load_ratio
        self._windows += 1
        stolen_ns = steal_ns()
        if stolen_ns is not None and self._steal_last_ns is not None:
            steal_ms = (stolen_ns - self._steal_last_ns) / 1e6
            elapsed_s = (now_ns - self._start_ns) / NS_PER_S
            self._host.row(
                f"{elapsed_s:.3f}",
                f"{steal_ms:.1f}",
                f"{picture.frames_per_s:.0f}",
                f"{picture.load_ratio:.4f}",
            )
        self._steal_last_ns = stolen_ns

    def _arrived(self, arrival: ArrivalWatch, now_ns: int) -> bool:
        status, position = self._picture.status, self._picture.latest.get(VobcPosition)
        if not isinstance(status, VobcStatus) or not isinstance(position, VobcPosition):
            return False
        return arrival.arrived(now_ns, status.ato_phase, position.front_m)

    def _needs_a_hand(
        self, emergency: HeldEmergencyCondition, doors: ShutDoorsCondition, now_ns: int
    ) -> str | None:
        status, mode = self._picture.status, self._picture.latest.get(VobcMode)
        if not isinstance(status, VobcStatus) or not isinstance(mode, VobcMode):
            return None
        shut = doors.shut_for_good(now_ns, status.ato_phase, mode.doors_withheld)
        return emergency.stands_for_good(now_ns, status.supervision, mode.cause) or shut

    def ending(self, reason: str, *, truth_known: bool, realtime: Sequence[str] = ()) -> Ending:
        """Return what the tap knows about the run, and close its log."""
        self._host.close()
        stolen_ns, steal_s = steal_ns(), None
        if stolen_ns is not None and self._steal_start_ns is not None:
            steal_s = (stolen_ns - self._steal_start_ns) / NS_PER_S
        rejections = self._picture.decoder.rejections
        return Ending(
            exit_reason=reason,
            failed=reason not in (ARRIVED, DURATION, INTERRUPTED),
            frames=self._picture.frames,
            bus_load_ratio=self._bits_load_sum / max(1, self._windows),
            rejected_frames={
                f"{can_id:03X} {why.name.lower()}": count
                for (can_id, why), count in rejections.items()
            },
            steal_s=steal_s,
            realtime=realtime,
            truth_known=truth_known,
            dropped_frames=self._tap.counters.dropped_in,
            lost_log_lines=self._log.lost_lines + self._host.lost_lines,
        )
