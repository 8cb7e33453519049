"""The tap of a real-time run: what it receives, what it shows, and when it ends the run."""

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from rich.console import Console

from can_dbc.binding import Frame
from can_dbc.brake import BrakeStatus
from can_dbc.codec import Encoder
from can_dbc.vobc import (
    AtoPhase,
    Cause,
    EventKind,
    Inhibit,
    Missing,
    OperatingMode,
    Supervision,
    VobcEvent,
    VobcMode,
    VobcMotion,
    VobcPosition,
    VobcStatus,
    VobcTarget,
    Withheld,
)
from firmware_py.buses.inproc import InprocBus
from firmware_py.clock.clock import LockstepClock
from firmware_py.ports import CanFrame
from firmware_py.storage.recorder import CandumpWriter
from metro_hil.model.end_condition import DURATION, UNATTENDED_S
from metro_hil.model.subprocesses import Child
from metro_hil.realtime.bus_watch import BusWatch
from metro_hil.realtime.line_hints import LOST_LOOKS, LineHints
from metro_hil.realtime.live_display import (
    FRESH_NS,
    BusPicture,
    Hints,
    LiveDisplay,
    no_hints,
    plain_line,
    render,
)

S = 1_000_000_000
BIT_RATE = 250_000
ENDPOINT = "tcp/127.0.0.1:7448"
STATUS = VobcStatus(
    supervision=Supervision.EMERGENCY,
    ato_phase=AtoPhase.OFF,
    missing=Missing(0),
    localised=True,
    slip_detected=False,
    work_us=900.0,
    cycle_slips=0,
)
MODE = VobcMode(
    mode=OperatingMode.AUTHORISED,
    cause=Cause.BRAKE_UNIT,
    departure_inhibits=Inhibit(0),
    doors_withheld=Withheld(0),
    jog_attempts=0,
    replicas_agree=True,
    alarm_raised=False,
)
BRAKE = BrakeStatus(
    applied_decel_mps2=1.25,
    cylinder_pressure_kpa=0.0,
    emergency_applied=False,
    holding_applied=False,
    released=False,
    ready=True,
)
HINTS = LineHints(3, ENDPOINT)
MOTION = VobcMotion(speed_mps=0.0, ceiling_mps=5.0, emergency_mps=6.0)


class Bench:
    """A controller that always sends the same, and the tap beside it."""

    def __init__(
        self,
        folder: Path,
        status: VobcStatus,
        mode: VobcMode = MODE,
        hints: Hints = no_hints,
    ) -> None:
        self.clock = LockstepClock()
        self.printed = io.StringIO()
        bus = InprocBus("vcan0", BIT_RATE)
        self._port, tap = bus.port("VOBC", frozenset()), bus.port("TAP", None)
        self._encoder = Encoder()
        self._said: list[Frame] = [status, mode, MOTION]
        picture = BusPicture(BIT_RATE)
        console = Console(file=self.printed, width=200)
        self.watch = BusWatch(
            tap,
            CandumpWriter(folder / "bus.log", "vcan0"),
            folder / "host.csv",
            picture,
            LiveDisplay(console, picture, "a run", hints),
            self.clock,
        )

    def says(self, frame: Frame) -> None:
        self._said.append(frame)

    def run(
        self,
        *,
        unattended: bool,
        centre: bool = False,
        children: Sequence[Child] = (),
        restart: Callable[[Child], bool] = lambda child: False,
    ) -> tuple[str, float]:
        """Why the run ended, and when, s."""

        def speak() -> bool:
            now_ns = self.clock.now_ns()
            for frame in self._said:
                for identifier, data in self._encoder.encode(frame):
                    self._port.send(now_ns, identifier, data)
            return False

        watched = (children, 3500.0, 100.0, speak)
        reason = self.watch.run(*watched, unattended=unattended, centre=centre, restart=restart)
        return reason, self.clock.now_ns() / S


@dataclass
class EndedChild:
    """Stands for the process of a program that ended."""

    name: str
    ended: bool = True

    def failure_words(self) -> str:
        return "by SIGKILL"


def test_the_end_of_a_program_that_is_not_started_again_ends_the_run(tmp_path: Path) -> None:
    children = [EndedChild("plant")]

    reason, at_s = Bench(tmp_path, STATUS).run(unattended=False, children=children)  # type: ignore[arg-type]

    assert reason == "the plant ended by itself: by SIGKILL"
    assert at_s < 1.0


def test_a_run_goes_on_with_a_controller_that_is_started_again(tmp_path: Path) -> None:
    children = [EndedChild("controller"), EndedChild("plant", ended=False)]
    asked = list[str]()

    def restart(child: Child) -> bool:
        asked.append(child.name)
        children[0] = EndedChild("controller", ended=False)
        return True

    bench = Bench(tmp_path, STATUS)
    end = bench.run(unattended=False, children=children, restart=restart)  # type: ignore[arg-type]

    assert end == (DURATION, 100.0)
    assert asked == ["controller"]


def test_an_emergency_that_cannot_be_released_ends_the_run(tmp_path: Path) -> None:
    reason, at_s = Bench(tmp_path, STATUS).run(unattended=True)

    assert "brake unit" in reason
    assert at_s == pytest.approx(UNATTENDED_S, abs=1.0)


@pytest.mark.parametrize(
    ("supervision", "unattended"),
    [(Supervision.EMERGENCY, False), (Supervision.NO_AUTHORITY, True)],
)
def test_a_releasable_or_waiting_train_does_not_end_the_run(
    tmp_path: Path, supervision: Supervision, unattended: bool
) -> None:
    bench = Bench(tmp_path, replace(STATUS, supervision=supervision))
    assert bench.run(unattended=unattended) == (DURATION, 100.0)


@pytest.mark.parametrize("cause", [Cause.REMOTE, Cause.AUTHORITY_OLD, Cause.OVERSPEED])
def test_a_train_that_its_centre_may_release_waits_with_a_hint(
    tmp_path: Path, cause: Cause
) -> None:
    bench = Bench(tmp_path, STATUS, replace(MODE, cause=cause), HINTS)

    assert bench.run(unattended=True, centre=True) == (DURATION, 100.0)
    words = "waits for the centre: `vobc emergency-brake T3 --end` releases the train"
    assert words in bench.printed.getvalue()


def test_a_train_that_only_the_desk_may_release_ends_the_run_on_such_a_line_too(
    tmp_path: Path,
) -> None:
    bench = Bench(tmp_path, STATUS, replace(MODE, cause=Cause.BUTTON), HINTS)
    reason, at_s = bench.run(unattended=True, centre=True)

    assert "button" in reason
    assert at_s == pytest.approx(UNATTENDED_S, abs=1.0)
    assert "waits for the centre" not in bench.printed.getvalue()


@pytest.mark.parametrize(
    ("kind", "cause", "shown"),
    [
        (EventKind.INPUT_LOST, 0, True),
        (EventKind.INPUT_BACK, 0, False),
        (EventKind.INPUT_LOST, int(Missing.BRAKE), False),
        (EventKind.OVERRUN, 0, False),
    ],
)
def test_a_silent_radio_is_shown(tmp_path: Path, kind: EventKind, cause: int, shown: bool) -> None:
    bench = Bench(tmp_path, replace(STATUS, supervision=Supervision.NOMINAL), hints=HINTS)
    bench.says(VobcEvent(kind, cause, 1, 0, 0))

    bench.run(unattended=False)

    words = f"nothing is received on the line's radio at {ENDPOINT}: is its wayside there, and of "
    assert (words in bench.printed.getvalue()) is shown


def test_the_display_names_the_reason_of_an_emergency(tmp_path: Path) -> None:
    bench = Bench(tmp_path, STATUS)
    bench.run(unattended=True)
    assert "EMERGENCY (brake unit)  off" in bench.printed.getvalue()


STOPPED = replace(STATUS, supervision=Supervision.NOMINAL, ato_phase=AtoPhase.STOPPED)
MISALIGNED = replace(MODE, cause=Cause.NONE, doors_withheld=Withheld.MISALIGNED)


def test_a_train_that_stopped_with_doors_kept_closed_ends_the_run(tmp_path: Path) -> None:
    bench = Bench(tmp_path, STOPPED, MISALIGNED)
    reason, at_s = bench.run(unattended=True)

    assert "misaligned" in reason
    assert at_s == pytest.approx(UNATTENDED_S, abs=1.0)
    assert "NOMINAL  stopped (doors shut: misaligned)  bus" in bench.printed.getvalue()


def test_doors_that_a_person_may_open_do_not_end_the_run(tmp_path: Path) -> None:
    assert Bench(tmp_path, STOPPED, MISALIGNED).run(unattended=False) == (DURATION, 100.0)


class Seen:
    """The display for frames that came at given instants."""

    def __init__(self) -> None:
        self.picture, self._encoder = BusPicture(BIT_RATE), Encoder()

    def hear(self, frame: Frame, at_ns: int) -> None:
        for identifier, data in self._encoder.encode(frame):
            self.picture.take(CanFrame(at_ns, identifier, data))

    def panel(self, now_ns: int) -> str:
        console = Console(file=io.StringIO(), width=120, record=True)
        console.print(render(self.picture, now_ns, now_ns / S, "a run"))
        return console.export_text()

    def line(self, now_ns: int) -> str:
        return plain_line(self.picture, now_ns, now_ns / S)


@pytest.fixture
def moving() -> Seen:
    """The display of a moving train whose controller and brake unit sent frames at 0 s."""
    seen = Seen()
    motion = VobcMotion(speed_mps=10.0, ceiling_mps=12.0, emergency_mps=13.0)
    target = VobcTarget(distance_to_stop_m=150.0, distance_to_authority_m=400.0)
    position = VobcPosition(front_m=1234.5, uncertainty_m=2.5)
    status = replace(STATUS, supervision=Supervision.NOMINAL)
    for frame in (status, MODE, motion, target, position, BRAKE):
        seen.hear(frame, 0)
    return seen


def test_fresh_values_are_shown(moving: Seen) -> None:
    for text in (moving.panel(FRESH_NS), moving.line(FRESH_NS)):
        assert "36.0 km/h" in text
        assert "NOMINAL" in text
        assert "150.00 m" in text
        assert "silent" not in text
    assert "1234.50 m" in moving.panel(FRESH_NS)


def test_for_a_silent_controller_only_the_silence_is_shown(moving: Seen) -> None:
    moving.hear(BRAKE, 8 * S)

    for text in (moving.panel(8 * S), moving.line(8 * S)):
        assert "controller" in text
        assert "silent for 8 s" in text
        for stale in ("36.0", "NOMINAL", "150.00", "1234.50", "ms"):
            assert stale not in text.replace("m/s²", "")
    assert "brake 1.25 m/s²" in moving.panel(8 * S)


def test_a_silent_unit_of_the_train_is_shown_as_silent(moving: Seen) -> None:
    moving.hear(STATUS, 3 * S)

    text = moving.panel(3 * S)

    assert "brake silent for 3 s" in text
    assert "1.25" not in text
    assert "controller" not in text
    assert "doors not received yet" in text


def test_a_missing_frame_of_the_controller_is_blank(moving: Seen) -> None:
    moving.hear(STATUS, 3 * S)

    for text in (moving.panel(3 * S), moving.line(3 * S)):
        assert "--" in text
        assert "36.0" not in text
        assert "EMERGENCY" in text


def test_old_frames_give_no_hints() -> None:
    """Only the centre may release this train in emergency, and then it falls silent."""
    seen = Seen()
    seen.hear(STATUS, 0)
    seen.hear(replace(MODE, cause=Cause.REMOTE), 0)

    assert HINTS(seen.picture.fresh(FRESH_NS)) != []
    assert HINTS(seen.picture.fresh(FRESH_NS + 1)) == []


@pytest.mark.parametrize(
    ("missing", "shown"),
    [
        (Missing.LOCALISATION, True),
        (Missing.LOCALISATION | Missing.AUTHORITY, True),
        (Missing.AUTHORITY, False),
        (Missing.LOCALISATION | Missing.TAG_READER, False),
    ],
)
def test_a_train_without_a_place_shows_how_it_gets_on_its_way_again(
    tmp_path: Path, missing: Missing, shown: bool
) -> None:
    waits = replace(STATUS, supervision=Supervision.NO_AUTHORITY, missing=missing)
    bench = Bench(tmp_path, waits, hints=LineHints(3, ENDPOINT))

    bench.run(unattended=False)

    assert ("drive on sight over two tags" in bench.printed.getvalue()) is shown


def test_a_train_that_has_just_started_is_not_lost() -> None:
    picture = BusPicture(BIT_RATE)
    hints = LineHints(3, ENDPOINT)
    picture.latest = {VobcStatus: replace(STATUS, missing=Missing.LOCALISATION)}
    lost = [bool(hints(picture)) for _ in range(LOST_LOOKS)]
    picture.latest = {VobcStatus: replace(STATUS, missing=Missing.NOTHING)}

    assert lost == [False] * (LOST_LOOKS - 1) + [True]
    assert hints(picture) == []
