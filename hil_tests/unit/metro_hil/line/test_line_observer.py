"""A run of a line is valid only while its observer keeps up and sees every takeover that the run
ordered."""

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from can_dbc.vobc import Cause, Supervision
from firmware_py.interrupts import Interrupts
from firmware_py.ports import LinkCounters, RadioMessage
from firmware_py.trackdb import load_line
from firmware_py.trackdb.areas import load_areas
from hil_tests.unit.metro_hil.line.test_line_story import BEAT, GIVEN, Told
from hil_tests.unit.vobc.train_to_train.test_t2t_envelope import REPORT
from metro_hil.cli.hil.line import _run
from metro_hil.engine.errors import EngineError
from metro_hil.line.exercise.observer import Observer
from metro_hil.line.exercise.plan import Fault, PlannedRun, Strike
from metro_hil.line.exercise.real_time import RealLine, Settings
from metro_hil.line.exercise.taps import ProtectionOutput
from metro_hil.line.exercise.verdict import complaints, doubts
from metro_hil.model.run_folder import RunFolder
from metro_hil.model.subprocesses import ChildError
from plant_emulator.wayside.detection import Place, key_of, packed
from zenoh_config import t2t_keys
from zenoh_config.codec import pack
from zenoh_config.t2t import T2tMessage

MS = 1_000_000
S = 1_000_000_000
DURATION_S = 3.0
START_MS = 5000
"""Start of the run by the machine's clock, ms."""


class HandClock:
    """A clock that advances while the line waits, or when a test makes a step take long."""

    epoch_offset_ns = 0

    def __init__(self) -> None:
        self.ns = START_MS * MS

    def now_ns(self) -> int:
        return self.ns

    def wait_until(self, at_ns: int) -> None:
        self.ns = max(self.ns, at_ns)


class Air:
    """Two trains that send positions every 20 ms, and messages of a master and its member every
    100 ms."""

    def __init__(self, delay_ms: Callable[[int], int], takeover_ms: int | None = None) -> None:
        """Args: delay_ms: transit time of a message sent at a millisecond of the run.
        takeover_ms: when train 2 begins to command."""
        self._delay_ms, self._takeover_ms = delay_ms, takeover_ms
        self._sent_ms = -20
        self._waiting: list[tuple[int, RadioMessage]] = []
        self.counters = LinkCounters()
        self.withheld: set[str] = set()
        """Names of message types that never arrive."""
        self.silent_from_ms: dict[int, int] = {}
        """When the positions of a train end, by train."""

    def receive(self, now_ns: int) -> Sequence[RadioMessage]:
        now_ms = now_ns // MS - START_MS
        while self._sent_ms + 20 <= now_ms:
            self._sent_ms += 20
            self._say(self._sent_ms)
        due = [m for due_ms, m in self._waiting if due_ms <= now_ms]
        self._waiting = [each for each in self._waiting if each[0] > now_ms]
        return [each._replace(stamp_ns=now_ns) for each in due]

    def _say(self, at_ms: int) -> None:
        at_ns = (START_MS + at_ms) * MS
        for train, rear_m in ((1, 1000.0), (2, 100.0)):
            if at_ms < self.silent_from_ms.get(train, 1 << 40):
                place = Place(rear_m + 80.0, rear_m, 16, at_ns)
                self._send(at_ms, key_of("loop", train), packed(place))
        if at_ms % 100:
            return
        taken = self._takeover_ms is not None and at_ms >= self._takeover_ms
        master, member, term = (2, 1, 9) if taken else (1, 2, 7)
        head: dict[str, Any] = {"stamp_ns": at_ns, "sequence": at_ms + 1, "term": term}
        held: dict[str, Any] = {"member": True, "held_term": term, "held_end_m": 1100.0, "area": 1}
        for message in (
            replace(BEAT, source=master, **head),
            replace(GIVEN, source=master, destination=member, echo_ns=at_ns, **head),
            replace(REPORT, source=master, **head, **held),
        ):
            if type(message).__name__ not in self.withheld:
                self._say_message(at_ms, message)

    def _say_message(self, at_ms: int, message: T2tMessage) -> None:
        self._send(at_ms, t2t_keys.key_of("loop", message), pack(message))

    def _send(self, at_ms: int, key: str, payload: bytes) -> None:
        self._waiting.append((at_ms + self._delay_ms(at_ms), RadioMessage(0, key, payload)))


def line(tmp_path: Path, *faults: Fault) -> RealLine:
    areas = load_areas("loop")
    settings = Settings(
        *(
            load_line("loop"),
            areas,
            "loop",
            [PlannedRun("S2", "S4"), PlannedRun("S1", "S3")],
            "tcp/h:1",
            "A",
            1,
        ),
        faults=list(faults),
        down_s=0.5,
        duration_s=DURATION_S,
        priority=0,
    )
    return RealLine(settings, tmp_path, lambda at_s, words: None)


def watched(run: RealLine, air: Air, *taps: Any) -> list[str]:
    """Let the run watch to its end; return why it is invalid."""
    clock: Any = HandClock()
    run._clock = clock
    run._start_ns = clock.now_ns()
    nothing = SimpleNamespace(
        ended=list,
        carried=dict,
        strike=lambda *_: None,
        order=lambda *_: None,
        start_controller=lambda *_: None,
        start_wayside=lambda: None,
    )
    crew: Any = nothing
    port: Any = air

    assert run._watch(crew, port, taps, Interrupts())

    run.record.close()
    return [*run.doubts, *doubts(run.story, 2)]


def constant(delay_ms: int) -> Callable[[int], int]:
    return lambda _: delay_ms


@pytest.mark.parametrize("delay_ms", [0, 100, 400])
def test_an_observer_within_half_a_second_leaves_the_run_valid(
    tmp_path: Path, delay_ms: int
) -> None:
    run = line(tmp_path)

    assert watched(run, Air(constant(delay_ms))) == []
    assert complaints(run.story, 2, behind_rear_m=-300.0) == []


@pytest.mark.parametrize("delay_ms", [600, 2000, 30_000])
def test_an_observer_further_behind_makes_the_run_invalid(tmp_path: Path, delay_ms: int) -> None:
    """Messages arrive in order, so all of them are old although none waits at the observer."""

    def behind(at_ms: int) -> int:
        return 0 if at_ms < 500 else delay_ms

    said = watched(line(tmp_path), Air(behind))

    assert said[0].startswith("the observer lagged: the newest")
    assert "0.5 s are allowed" in said[0]


def test_a_lag_that_is_over_before_the_end_makes_the_run_invalid_too(tmp_path: Path) -> None:
    def held_up(at_ms: int) -> int:
        return max(0, 1700 - at_ms) if 1000 <= at_ms < 1700 else 0

    (said,) = watched(line(tmp_path), Air(held_up))

    assert "0.7" in said


def test_messages_in_transit_at_the_end_make_the_run_invalid(tmp_path: Path) -> None:
    """The last messages never arrive, and none is old enough yet to show this."""

    def stuck(at_ms: int) -> int:
        return 0 if at_ms < 1000 * DURATION_S - 300 else 60_000

    (said,) = watched(line(tmp_path), Air(stuck))

    assert said == "messages had not reached the observer at the end (trains 1, 2)"


def test_one_train_whose_places_are_old_makes_the_run_invalid(tmp_path: Path) -> None:
    air = Air(constant(0))
    air.silent_from_ms[2] = 1500

    said = watched(line(tmp_path), air)

    assert "the newest place of train 2" in said[0]
    assert said[1].endswith("(trains 2)")


def test_an_observer_that_judges_too_slowly_makes_the_run_invalid(tmp_path: Path) -> None:
    run = line(tmp_path)
    on_message = run.record.on_message

    def slow(messages: Sequence[RadioMessage]) -> None:
        clock: Any = run._clock
        on_message(messages)
        if clock.ns // S == START_MS // 1000 + 2:
            clock.ns += S

    run.record.on_message = slow  # type: ignore[assignment, method-assign]

    assert "the observer lagged" in watched(run, Air(constant(0)))[0]


@pytest.mark.parametrize(("delay_ms", "valid"), [(100, True), (700, False)])
def test_an_early_emergency_brake_is_judged_only_with_recent_messages(
    tmp_path: Path, delay_ms: int, valid: bool
) -> None:
    """At 0.8 s an observer that lags cannot know whether the train was already commanded."""
    told = [(800, Supervision.EMERGENCY, int(Cause.OVERSPEED))]

    def on_message(now_ns: int) -> list[ProtectionOutput]:
        due = [each for each in told if now_ns >= (START_MS + each[0]) * MS]
        told[:] = told[len(due) :]
        return [ProtectionOutput(now_ns, 2, supervision, cause) for _, supervision, cause in due]

    def late_at_first(at_ms: int) -> int:
        return delay_ms if at_ms < 900 else 0

    run, air = line(tmp_path), Air(late_at_first)
    air.withheld = {"AreaAuthority", "TrainReport"}
    run._beginning = lambda now_ns: now_ns if now_ns > (START_MS + 2000) * MS else None  # type: ignore[method-assign]

    said = watched(run, air, SimpleNamespace(on_message=on_message, dropped=0))

    assert len(run.story.train(2).emergencies) == 1
    assert (said == []) is valid


def test_lost_messages_make_the_run_invalid(tmp_path: Path) -> None:
    air, tap = Air(constant(0)), SimpleNamespace(on_message=lambda now_ns: (), dropped=2)
    air.counters.dropped_in = 3

    said = watched(line(tmp_path), air, tap)

    assert said == ["the recorder lost 3 messages", "the tap on the bus of train 1 lost 2 messages"]


@pytest.mark.parametrize(
    ("takeover_ms", "seen"), [(None, False), (500, False), (1400, True), (2900, True)]
)
def test_an_ordered_takeover_must_be_observed(
    tmp_path: Path, takeover_ms: int | None, seen: bool
) -> None:
    """A takeover before the fault does not count as one that the run ordered."""
    run = line(tmp_path, Fault(Strike.KILL_MASTER, 1.0))

    said = watched(run, Air(constant(0), takeover_ms))

    assert [("no later term was received" in each) for each in said] == ([] if seen else [True])


def test_a_master_without_another_train_in_its_area_has_no_successor() -> None:
    told = Told()
    told.story.stands(1, Place(3080.0, 3000.0, 16))
    told.on_message(replace(BEAT, area=1, source=2), 100)

    told.story.orders_takeover(1, 2)
    assert told.story.unseen_takeovers() == []

    told.story.stands(1, Place(1080.0, 1000.0, 16))
    told.story.orders_takeover(1, 2)
    assert [each.train for each in told.story.unseen_takeovers()] == [2]


def test_a_fault_that_finds_no_master_makes_the_run_invalid(tmp_path: Path) -> None:
    run = line(tmp_path, Fault(Strike.STOP_MASTER, 1.0))
    air = Air(constant(0))
    air.withheld = {"Heartbeat"}

    said = watched(run, air)

    assert said == ["stop-master: no train commands, so none is struck"]


def test_a_wayside_stopped_by_the_run_causes_no_lag_while_it_is_away(tmp_path: Path) -> None:
    """The wayside is down from 1 to 1.5 s after the begin; all are connected again at 2.2 s."""

    def away(at_ms: int) -> int:
        return 0 if not 900 < at_ms < 2200 else 60_000

    run = line(tmp_path, Fault(Strike.CRASH_WAYSIDE, 1.0))

    assert watched(run, Air(away)) == []


def test_a_train_that_moved_had_an_authority_even_if_none_was_received() -> None:
    told = Told()
    told.story.tells(1, Supervision.NOMINAL, Cause.NONE, 50 * MS)

    assert complaints(told.story, 2, behind_rear_m=7.0) == ["train 2: never had an authority"]
    assert doubts(told.story, 2) == [
        "train 1: it drove, but the observer received no authority for it"
    ]


def test_a_message_from_the_future_does_not_hide_a_lag() -> None:
    told = Told()
    told.on_message(replace(BEAT, stamp_ns=900 * S), 100)
    observer = Observer(told.story, 0)

    observer.looks(100 * MS + 500 * MS)
    assert observer.doubts({}) == []
    observer.looks(100 * MS + 501 * MS)

    (said,) = observer.doubts({})
    assert said.startswith("the observer lagged: the newest message was 0.50 s old")


def test_an_aborted_run_has_not_passed(tmp_path: Path) -> None:
    run = line(tmp_path)

    def breaks_off() -> bool:
        raise ChildError("controller 1 ended with 1")

    run.run = breaks_off  # type: ignore[method-assign]

    with pytest.raises(EngineError, match="controller 1 ended with 1"):
        _run(run, run._settings, RunFolder(tmp_path))

    results = json.loads((tmp_path / "results.json").read_text())
    assert results["verdict"] == "invalid"
    assert results["doubts"] == ["it did not finish: controller 1 ended with 1"]
