"""The live picture of a run in the terminal, made only from received bus frames."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from can_dbc.brake import BrakeStatus
from can_dbc.codec import Decoder, Rejected
from can_dbc.doors import DoorState, DoorStatus
from can_dbc.traction import TractionStatus
from can_dbc.vobc import (
    AtoPhase,
    EventKind,
    Missing,
    Supervision,
    VobcEvent,
    VobcMode,
    VobcMotion,
    VobcPosition,
    VobcStatus,
    VobcTarget,
)
from firmware_py.buses.timing import frame_bits
from firmware_py.ports import CanFrame
from metro_hil.model.end_condition import cause_words, withheld_words

SEEN = (
    VobcStatus,
    VobcMode,
    VobcMotion,
    VobcPosition,
    VobcTarget,
    VobcEvent,
    BrakeStatus,
    TractionStatus,
    DoorStatus,
)
VOBC_SEEN = (VobcStatus, VobcMode, VobcMotion, VobcPosition, VobcTarget)
TRAIN_SEEN = (BrakeStatus, TractionStatus, DoorStatus)
FRESH_NS = 500_000_000
"""Age beyond which a frame is not shown: two and a half periods of the slowest, VOBC_TARGET."""
NOTHING = "--"
FAR_M = 80_000.0
"""Distance to the stop, in VOBC_TARGET, beyond which the train has no stopping point ahead."""
LINE_RADIO = 0
"""Number of the input that has no flag in `missing`."""
BAR_WIDTH = 46
FULL_SCALE_KMH = 90.0
PLAIN_PERIOD_S = 5.0
NS_PER_S = 1_000_000_000

STATE_STYLE = {
    Supervision.NO_AUTHORITY: "yellow",
    Supervision.NOMINAL: "green",
    Supervision.WARNING: "bold yellow",
    Supervision.SERVICE: "bold dark_orange",
    Supervision.EMERGENCY: "bold white on red",
}


@dataclass(slots=True)
class BusPicture:
    """The latest frame of each kind, and the bus load over the last second."""

    bit_rate: int
    decoder: Decoder = field(default_factory=lambda: Decoder(SEEN))
    latest: dict[type, object] = field(default_factory=dict)
    heard_ns: dict[type, int] = field(default_factory=dict)
    """Instant of the last frame of each kind."""
    frames: int = 0
    load_ratio: float = 0.0
    frames_per_s: float = 0.0
    line_silent: bool = False
    """Whether the controller receives nothing on the radio of its line."""
    _bits: int = 0
    _count: int = 0
    _since_ns: int | None = None

    def take(self, frame: CanFrame) -> None:
        """Count one frame and, if the decoder knows it, keep its content."""
        self.frames += 1
        self._count += 1
        self._bits += frame_bits(frame.can_id, frame.data, frame.extended, frame.remote)
        if frame.remote or frame.error or frame.extended:
            return
        heard = self.decoder.decode(frame.can_id, frame.data, frame.stamp_ns)
        if heard is not None and not isinstance(heard, Rejected):
            self.latest[type(heard)] = heard
            self.heard_ns[type(heard)] = frame.stamp_ns
            if isinstance(heard, VobcEvent) and heard.cause == LINE_RADIO:
                self._take_event(heard)

    def _take_event(self, told: VobcEvent) -> None:
        if told.event in (EventKind.INPUT_LOST, EventKind.INPUT_BACK):
            self.line_silent = told.event is EventKind.INPUT_LOST

    def close_window(self, now_ns: int) -> None:
        """Compute bus load and frame rate since the last call."""
        if self._since_ns is not None and now_ns > self._since_ns:
            elapsed_s = (now_ns - self._since_ns) / NS_PER_S
            self.load_ratio = self._bits / (self.bit_rate * elapsed_s)
            self.frames_per_s = self._count / elapsed_s
        self._since_ns, self._bits, self._count = now_ns, 0, 0

    def fresh(self, now_ns: int) -> "BusPicture":
        """Return the same picture without the frames that are too old to be shown."""
        latest = {
            kind: frame
            for kind, frame in self.latest.items()
            if now_ns - self.heard_ns.get(kind, now_ns) <= FRESH_NS
        }
        silent = not any(kind in latest for kind in VOBC_SEEN)
        return replace(self, latest=latest, line_silent=self.line_silent and not silent)

    def silence(self, kinds: Sequence[type], now_ns: int) -> str:
        """Return how long a node has been silent, or that it never sent; empty while it sends.

        Args:
            kinds: frames of the node.
            now_ns: the instant.
        """
        heard = [self.heard_ns[kind] for kind in kinds if kind in self.heard_ns]
        if not heard:
            return "not received yet"
        silent_ns = now_ns - max(heard)
        return f"silent for {silent_ns // NS_PER_S} s" if silent_ns > FRESH_NS else ""

    @property
    def status(self) -> VobcStatus | None:
        found = self.latest.get(VobcStatus)
        return found if isinstance(found, VobcStatus) else None

    @property
    def motion(self) -> VobcMotion | None:
        found = self.latest.get(VobcMotion)
        return found if isinstance(found, VobcMotion) else None


Hints = Callable[[BusPicture], Sequence[str]]
"""Returns whole sentences for the operator that do not follow from bus frames."""


def no_hints(_picture: BusPicture) -> Sequence[str]:
    return ()


def missing_words(missing: Missing) -> str:
    """Return the inputs that the controller waits for, as text."""
    words = {
        Missing.BRAKE: "brake status",
        Missing.TRACTION: "traction status",
        Missing.ODOMETER: "odometer",
        Missing.DOORS: "door status",
        Missing.DESK: "desk",
        Missing.TAG_READER: "tag reader",
        Missing.AUTHORITY: "movement authority",
        Missing.LOCALISATION: "position",
    }
    return ", ".join(text for flag, text in words.items() if flag in missing)


def render(
    picture: BusPicture, now_ns: int, elapsed_s: float, title: str, hints: Sequence[str] = ()
) -> RenderableType:
    """Return the whole panel for one moment; values that are too old are left blank."""
    table = Table.grid(padding=(0, 2))
    table.add_column(style="dim", justify="right", min_width=16)
    table.add_column(min_width=60)
    for name, text in _rows(picture, now_ns):
        table.add_row(name, text)
    for words in hints:
        table.add_row("line", Text(words, style="bold yellow"))
    head = Text.assemble(
        (title, "bold"), f"   {elapsed_s:6.1f} s   ", ("Ctrl-C ends the run", "dim")
    )
    return Group(head, table)


def _rows(picture: BusPicture, now_ns: int) -> list[tuple[str, RenderableType]]:
    fresh = picture.fresh(now_ns)
    status, motion = fresh.status, fresh.motion
    rows: list[tuple[str, RenderableType]] = []
    if silence := picture.silence(VOBC_SEEN, now_ns):
        rows.append(("controller", Text(silence, style="bold yellow")))
    else:
        rows += [("speed", Text(NOTHING))] if motion is None else _motion_rows(motion)
        rows += _target_rows(fresh)
        if status is None:
            rows.append(("protection", Text(NOTHING)))
        else:
            rows += _state_rows(status, _operation(fresh, status), _why(fresh))
    rows.append(("train", Text(_train_text(picture, fresh, now_ns))))
    load = Text(f"{picture.load_ratio * 100.0:5.1f} %  of {picture.bit_rate // 1000} kbit/s")
    load.append(f"   {picture.frames_per_s:4.0f} frames/s   {picture.frames} in all", style="dim")
    rows.append(("bus load", load))
    return rows


def _motion_rows(motion: VobcMotion) -> list[tuple[str, RenderableType]]:
    speed_kmh, ceiling_kmh = motion.speed_mps * 3.6, motion.ceiling_mps * 3.6
    emergency_kmh = motion.emergency_mps * 3.6
    return [
        ("speed", Text.assemble((f"{speed_kmh:z5.1f} km/h  ", "bold"), _bar(motion))),
        ("ceiling", Text(f"{ceiling_kmh:5.1f} km/h")),
        ("emergency margin", Text(f"{emergency_kmh - speed_kmh:z5.1f} km/h")),
    ]


def _bar(motion: VobcMotion) -> Text:
    """Return the speed as a filled bar with the ceiling (|) and the emergency limit (!) on it."""
    cells = ["━" if _cell(motion.speed_mps) > i else "─" for i in range(BAR_WIDTH)]
    text = Text("".join(cells))
    text.stylize("blue", 0, _cell(motion.speed_mps))
    text.stylize("grey37", _cell(motion.speed_mps))
    for speed_mps, mark, style in (
        (motion.ceiling_mps, "|", "bold yellow"),
        (motion.emergency_mps, "!", "bold red"),
    ):
        at = min(BAR_WIDTH - 1, _cell(speed_mps))
        text = Text.assemble(text[:at], (mark, style), text[at + 1 :])
    return text


def _cell(speed_mps: float) -> int:
    return max(0, min(BAR_WIDTH, round(speed_mps * 3.6 / FULL_SCALE_KMH * BAR_WIDTH)))


def _target_rows(picture: BusPicture) -> list[tuple[str, RenderableType]]:
    rows: list[tuple[str, RenderableType]] = []
    position, target = picture.latest.get(VobcPosition), picture.latest.get(VobcTarget)
    if isinstance(position, VobcPosition):
        text = f"{position.front_m:8.2f} m  ± {position.uncertainty_m:.2f} m"
        rows.append(("front at", Text(text)))
    if isinstance(target, VobcTarget):
        far = target.distance_to_stop_m > FAR_M
        stop = "none" if far else f"{target.distance_to_stop_m:8.2f} m"
        rows.append(("next stop in", Text(stop, style="bold")))
    return rows


def _why(picture: BusPicture) -> str:
    """Return the cause of the emergency brake as the controller reports it; empty without one."""
    status, mode = picture.status, picture.latest.get(VobcMode)
    emergency = status is not None and status.supervision is Supervision.EMERGENCY
    if not emergency or not isinstance(mode, VobcMode):
        return ""
    return f" ({cause_words(mode.cause)})"


def _operation(picture: BusPicture, status: VobcStatus) -> str:
    """Return the phase of ATO and, at a stop, why the doors stay closed."""
    words, mode = status.ato_phase.name.lower().replace("_", " "), picture.latest.get(VobcMode)
    if status.ato_phase is not AtoPhase.STOPPED or not isinstance(mode, VobcMode):
        return words
    shut = withheld_words(mode.doors_withheld)
    return words + (f" (doors shut: {shut})" if shut else "")


def _state_rows(status: VobcStatus, mode: str, why: str) -> list[tuple[str, RenderableType]]:
    state = Text(status.supervision.name + why, style=STATE_STYLE[status.supervision])
    if status.missing:
        state.append(f"  waits for: {missing_words(status.missing)}", style="yellow")
    cycle = Text(f"{status.work_us / 1000.0:5.2f} ms work")
    cycle.append(
        f"   {status.cycle_slips} slips", style="bold red" if status.cycle_slips else "dim"
    )
    return [("operation", Text(mode)), ("protection", state), ("cycle", cycle)]


def _train_text(picture: BusPicture, fresh: BusPicture, now_ns: int) -> str:
    """Return what the train's units report, or how long a unit has been silent."""
    if not any(kind in picture.heard_ns for kind in TRAIN_SEEN):
        return "not received yet"
    units = (
        ("traction", TractionStatus, _traction_text),
        ("brake", BrakeStatus, _brake_text),
        ("doors", DoorStatus, _doors_text),
    )
    return "   ".join(
        f"{name} {picture.silence((kind,), now_ns) or text(fresh.latest.get(kind))}"
        for name, kind, text in units
    )


def _traction_text(traction: object) -> str:
    assert isinstance(traction, TractionStatus)
    return f"{traction.force_n / 1000.0:6.1f} kN"


def _brake_text(brake: object) -> str:
    assert isinstance(brake, BrakeStatus)
    held = "  EMERGENCY" if brake.emergency_applied else "  held" if brake.holding_applied else ""
    return f"{brake.applied_decel_mps2:4.2f} m/s²{held}"


def _doors_text(doors: object) -> str:
    assert isinstance(doors, DoorStatus)
    side = doors.right if doors.right is not DoorState.LOCKED else doors.left
    return side.name.lower()


class LiveDisplay:
    """Shows the picture on a terminal, or as a line every few seconds without one."""

    def __init__(
        self, console: Console, picture: BusPicture, title: str, hints: Hints = no_hints
    ) -> None:
        self._picture, self._title, self._console = picture, title, console
        self._hints = hints
        self._live = (
            Live(console=console, auto_refresh=False, transient=True)
            if console.is_terminal
            else None
        )
        self._start_ns: int | None = None
        self._plain_next_ns = 0

    def start(self, now_ns: int) -> None:
        self._start_ns = now_ns
        if self._live:
            self._live.start()

    def stop(self) -> None:
        if self._live:
            self._live.stop()

    def say(self, text: str) -> None:
        """Print a lasting line above the picture."""
        self._console.print(text, highlight=False, markup=False, soft_wrap=True)

    def refresh(self, now_ns: int) -> None:
        assert self._start_ns is not None
        elapsed_s = (now_ns - self._start_ns) / NS_PER_S
        hints = self._hints(self._picture.fresh(now_ns))
        if self._live:
            panel = render(self._picture, now_ns, elapsed_s, self._title, hints)
            self._live.update(panel, refresh=True)
        elif now_ns >= self._plain_next_ns:
            self._plain_next_ns = now_ns + int(PLAIN_PERIOD_S * NS_PER_S)
            self.say("  ".join([plain_line(self._picture, now_ns, elapsed_s), *hints]))


def plain_line(picture: BusPicture, now_ns: int, elapsed_s: float) -> str:
    """Return the picture in one line, for logs; values that are too old are left blank."""
    fresh = picture.fresh(now_ns)
    status, motion, target = fresh.status, fresh.motion, fresh.latest.get(VobcTarget)
    if silence := picture.silence(VOBC_SEEN, now_ns):
        return f"{elapsed_s:6.1f} s  controller {silence}, bus {picture.frames_per_s:.0f} frames/s"
    line = f"{elapsed_s:6.1f} s  {NOTHING} km/h"
    if motion is not None:
        line = (
            f"{elapsed_s:6.1f} s  {motion.speed_mps * 3.6:z5.1f} km/h"
            f"  ceiling {motion.ceiling_mps * 3.6:5.1f}"
        )
    if isinstance(target, VobcTarget) and target.distance_to_stop_m < FAR_M:
        line += f"  stop in {target.distance_to_stop_m:7.2f} m"
    line += f"  {NOTHING if status is None else status.supervision.name}{_why(fresh)}"
    line += "" if status is None else f"  {_operation(fresh, status)}"
    line += f"  bus {picture.load_ratio * 100.0:.0f} %"
    if status is None:
        return line
    line += f"  work {status.work_us / 1000.0:.2f} ms"
    return line + (f"  waits for: {missing_words(status.missing)}" if status.missing else "")


Say = Callable[[str], None]
