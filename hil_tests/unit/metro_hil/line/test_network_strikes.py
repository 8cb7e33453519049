"""Faults of trains on a network in real time: when they begin, what they do, what they explain."""

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import msgspec
import pytest

from firmware_py.clock.clock import LockstepClock
from firmware_py.ports import RadioMessage
from firmware_py.radio.inproc_radio import InprocRadio
from firmware_py.trackdb.circuit import load_network, load_path
from hil_tests.unit.metro_hil.line.test_line_story import BEAT, GIVEN
from hil_tests.unit.metro_hil.line.test_network_witness import OUT
from hil_tests.unit.metro_hil.line.test_turning_masters import SHORT, SHORT_TRACKS, written
from hil_tests.unit.vobc.train_to_train.test_t2t_envelope import REPORT
from metro_hil.line.exercise.plan import Fault, Strike
from metro_hil.line.exercise.schedule import FaultSchedule
from metro_hil.line.turning.network_events import NetworkEvents
from metro_hil.line.turning.network_verdict import OLD_TEXT, document_of, failed, is_explained, show
from metro_hil.line.turning.networked import NetworkSession
from metro_hil.line.turning.networked_command import OrderInput
from metro_hil.line.turning.plan import plan_fleet
from metro_hil.line.turning.train import TurningTrain
from metro_hil.model.run_options import parse
from plant_emulator.wayside.interlocking import SignalBox
from plant_emulator.wayside.network_places import TrainPlace, TrainPresence, key_of_place
from plant_emulator.wayside.route_objects import divided
from zenoh_config.codec import pack
from zenoh_config.t2t import T2tMessage
from zenoh_config.t2t_keys import key_of

MS: Final = 1_000_000
S: Final = 1_000_000_000
ZERO_NS: Final = 50 * S
"""Instant of the observer's clock at which the time of the network is 0."""
BRAKE: Final[dict[str, Any]] = {
    "at_s": 20.0,
    "train": 2,
    "kind": "emergency",
    "cause": "movement authority or its restrictions too old",
}


class Network:
    """What an observer of the short network receives."""

    def __init__(self, folder: Path) -> None:
        file = written(folder, SHORT, SHORT_TRACKS)
        paths = [load_path(f"{file}:out"), load_path(f"{file}:back")]
        areas = {path.line.name: divided(load_network(file), path) for path in paths}
        self.said: list[tuple[float, str]] = []
        self.events = NetworkEvents("short", paths, areas, self._say)
        found = areas["short-out"].area_at(OUT.front_m)
        assert found is not None
        self.area = found.number

    def _say(self, now_ns: int, text: str) -> None:
        self.said.append((self.events.second_of(now_ns), text))

    def place(self, train: int, at_s: float, place: TrainPlace = OUT) -> None:
        payload = msgspec.json.encode(msgspec.structs.replace(place, at_s=at_s))
        key = key_of_place("short", train)
        self.events.on_message([RadioMessage(ZERO_NS + round(at_s * S), key, payload)])

    def message(self, message: T2tMessage, at_s: float) -> None:
        area = replace(message, area=self.area)
        key = key_of("short-out", area)
        self.events.on_message([RadioMessage(ZERO_NS + round(at_s * S), key, pack(area))])

    def strike(self, at_s: float) -> Any:
        return self.events.strike("kill-master", ZERO_NS + round(at_s * S))

    def document(self, *brakes: dict[str, Any], missed: tuple[str, ...] = ()) -> dict[str, Any]:
        found = [{"protection_brakes": [*brakes], "late_s": 0.0, "trips": []}] * 2
        return document_of(
            *(self.events, found),
            network="short",
            trains=2,
            exit_reason="duration over",
            dropped=0,
            crashed_s=None,
            missed=missed,
        )


@pytest.fixture
def network(tmp_path: Path) -> Network:
    return Network(tmp_path)


def test_a_fault_begins_when_it_is_due_and_can_begin_and_ends_later() -> None:
    cut, crash = Fault(Strike.CUT_MASTER, 1.0), Fault(Strike.CRASH_WAYSIDE, 2.0)
    schedule, done, refuses = FaultSchedule([cut, crash], 0.5), list[str](), [cut]

    def apply(fault: Fault, now_ns: int) -> bool:
        if fault in refuses:
            return False
        done.append(fault.strike.value)
        schedule.ends(now_ns, lambda: done.append("over"))
        return True

    def step(now_s: float) -> None:
        now_ns = round(now_s * S)
        schedule.step(now_ns, 10 * S, lambda fault: apply(fault, now_ns))

    for now_s in (2.5, 11.9, 12.0):
        step(now_s)
    assert done == ["crash-arbiter-at"]
    assert schedule.waiting == [cut]
    refuses.clear()
    step(12.4)
    assert done == ["crash-arbiter-at", "cut-master-at"]
    step(12.5)
    step(13.0)

    assert done == ["crash-arbiter-at", "cut-master-at", "over", "over"]
    assert schedule.waiting == []


def test_only_a_train_that_commands_another_one_is_struck_and_its_takeover_is_timed(
    network: Network,
) -> None:
    network.place(1, 10.0)
    network.message(BEAT, 10.0)
    assert network.strike(10.0) is None

    network.place(2, 10.1, msgspec.structs.replace(OUT, front_m=20.0, rear_m=-10.0, end_m=20.0))
    # The heartbeat is too old.
    assert network.strike(10.6) is None
    network.message(replace(BEAT, sequence=2), 10.6)
    struck = network.strike(10.7)
    assert struck is not None
    assert (struck.train, struck.areas) == (1, (("short-out", network.area),))
    assert struck.at_s == pytest.approx(10.7)
    (nothing,) = network.events.takeovers()
    assert (nothing.struck, nothing.train, nothing.after_s) == (1, None, None)
    (doubt,) = network.events.doubts()
    assert doubt.startswith(f"short-out, area {network.area}: train 1 was struck in term 7")

    network.message(replace(BEAT, source=2, term=9), 11.1)
    network.message(replace(BEAT, source=2, term=11), 12.0)

    (takeover,) = network.events.takeovers()
    assert (takeover.train, takeover.struck) == (2, 1)
    assert takeover.after_s == pytest.approx(0.4)
    assert network.events.doubts() == []
    at_s, text = network.said[-2]
    assert at_s == pytest.approx(11.1)
    assert text == (
        f"short-out, area {network.area}: train 2 commands, term 9; train 1 sent its last "
        "heartbeat 0.50 s before"
    )


def test_a_later_change_of_command_is_no_takeover(
    network: Network, capsys: pytest.CaptureFixture[str]
) -> None:
    for train in (1, 2):
        network.place(train, 10.0)
    network.message(BEAT, 10.0)
    network.strike(10.0)
    network.message(replace(BEAT, source=2, term=9), 20.1)

    show(network.document())

    where = f"short-out, area {network.area}"
    told = capsys.readouterr().out.splitlines()
    assert f"{where}: no other train commanded after train 1 was struck" in told


def test_ages_count_by_the_clock_of_each_train(network: Network) -> None:
    """The clock of train 2 began at 8 s; its fastest report took 0 ms."""
    network.place(2, 10.0)
    for stamp_ms, took_ms in ((2000, 40), (2100, 0), (2200, 30)):
        report = replace(REPORT, source=2, stamp_ns=stamp_ms * MS)
        network.message(report, 8.0 + (stamp_ms + took_ms) / 1000.0)
    network.message(replace(GIVEN, echo_ns=2200 * MS, stamp_ns=0), 10.25)
    network.message(replace(GIVEN, echo_ns=2400 * MS, sequence=3), 10.7)

    train = network.events.lines["short-out"].train(2)
    assert train.latencies_ms == pytest.approx([50.0, 300.0])
    assert network.events.authority_oldest_s() == pytest.approx(0.5)

    # On its next trip the train has another clock.
    turned = msgspec.structs.replace(OUT, path="short-back", trip=1)
    network.place(2, 11.0, turned)
    assert train.place is None
    assert train.given == {}
    assert network.events.lines["short-back"].train(2).place is not None
    network.place(2, 12.0, msgspec.structs.replace(turned, presence=TrainPresence.GONE))
    assert network.events.lines["short-back"].train(2).place is None


@pytest.mark.parametrize(
    ("changes", "struck_s", "crashed_s", "explained"),
    [
        ({}, {}, None, False),
        ({"cause": "overspeed"}, {2: 20.0}, None, True),
        ({}, {2: 20.1}, None, False),
        # Another train was struck: only a service brake.
        ({}, {1: 10.0}, None, False),
        ({"kind": "service"}, {1: 10.0}, None, True),
        ({"kind": "service"}, {1: 20.1}, None, False),
        ({"kind": "service", "cause": "overspeed"}, {1: 10.0}, None, True),
        ({"kind": "service"}, {}, 20.0, True),
        ({}, {}, 20.0, True),
        ({}, {}, 20.1, False),
        ({"cause": "overspeed"}, {}, 10.0, False),
    ],
)
def test_faults_explain_only_the_brakes_that_follow_from_them(
    changes: dict[str, Any],
    struck_s: dict[int, float],
    crashed_s: float | None,
    explained: bool,
) -> None:
    assert is_explained({**BRAKE, **changes}, struck_s, crashed_s=crashed_s) is explained


def test_the_verdict_fails_for_an_unexplained_brake_and_shows_takeovers(
    network: Network, capsys: pytest.CaptureFixture[str]
) -> None:
    network.place(1, 10.0)
    network.place(2, 10.0, msgspec.structs.replace(OUT, front_m=20.0, rear_m=-10.0, end_m=20.0))
    network.message(BEAT, 10.0)
    network.strike(10.0)
    # The authority of train 2 answers a report of 10.2 s; its own one is of 10.45 s.
    network.message(replace(REPORT, source=2, stamp_ns=0), 8.0)
    network.message(replace(GIVEN, echo_ns=2200 * MS), 10.25)
    network.message(replace(BEAT, source=2, term=9), 10.35)
    network.message(replace(REPORT, source=2, held_term=9, stamp_ns=2450 * MS), 10.45)

    assert not failed(network.document({**BRAKE, "train": 1}))
    document = network.document({**BRAKE, "kind": "service"}, BRAKE, missed=("nothing cut",))
    assert failed(document)
    show(document)

    told = capsys.readouterr().out.splitlines()
    assert f"at 20.00 s, train 2: service brake, {OLD_TEXT}, explained by a fault" in told
    assert f"at 20.00 s, train 2: emergency brake, {OLD_TEXT}" in told
    where = f"short-out, area {network.area}"
    assert f"{where}: train 2 commanded 0.35 s after train 1 was struck" in told
    assert told[-2:] == ["oldest authority of other trains: 0.25 s", "invalid: nothing cut"]


@pytest.mark.parametrize(
    ("is_mute", "is_deaf"), [(True, True), (True, False), (False, True), (False, False)]
)
def test_what_is_sent_in_a_cut_arrives_at_its_end(is_mute: bool, is_deaf: bool) -> None:
    clock, air = LockstepClock(), InprocRadio(0.005)
    other = air.port("other", ("to/other", key_of_place("short", 1)))
    session = NetworkSession(air.port("train 1", ()), "short", 1, clock)
    session.listen(("to/train",))
    session.zero_ns = 0

    def exchange(at_ms: int) -> tuple[list[str], list[str]]:
        """Send both ways, and return what arrived within 10 ms."""
        clock.wait_until(at_ms * MS)
        now_ns = clock.now_ns()
        session.send(now_ns, "to/other", f"{at_ms}".encode())
        other.send(now_ns, "to/train", f"{at_ms}".encode())
        clock.wait_until((at_ms + 10) * MS)
        return arrived()

    def arrived() -> tuple[list[str], list[str]]:
        now_ns = clock.now_ns()
        out = [each.payload.decode() for each in other.receive(now_ns)]
        return out, [each.payload.decode() for each in session.receive(now_ns)]

    session.cut(is_mute=is_mute, is_deaf=is_deaf)
    assert exchange(100) == ([] if is_mute else ["100"], [] if is_deaf else ["100"])
    # The place of the train belongs to the rails.
    session.tell(OUT)
    clock.wait_until(150 * MS)
    assert [each.key for each in other.receive(clock.now_ns())] == [key_of_place("short", 1)]
    session.cut(is_mute=False, is_deaf=False)
    clock.wait_until(160 * MS)

    assert arrived() == (["100"] if is_mute else [], ["100"] if is_deaf else [])
    assert exchange(200) == (["200"], ["200"])


@pytest.fixture
def standard_input(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    read, write = os.pipe()
    with os.fdopen(read) as end:
        monkeypatch.setattr("sys.stdin", end)
        yield write


def test_orders_come_one_a_line_and_none_is_waited_for(standard_input: int) -> None:
    orders = OrderInput()

    assert orders() == []
    os.write(standard_input, b"cut\nhe")
    assert orders() == ["cut"]
    os.write(standard_input, b"al\nkill\n")
    assert orders() == ["heal", "kill"]
    os.close(standard_input)
    assert orders() == []


def test_a_controller_that_is_stopped_in_motion_does_not_know_its_place_afterwards() -> None:
    words = ["run", "--lockstep", "--service", "docs/examples/line/shuttle.toml"]
    plan = plan_fleet(parse(words))
    train = TurningTrain(plan, 1, SignalBox(plan.network))
    assert train.enter(0)
    now_s = 0
    while train.place_m < 30.0:
        now_s += 1
        train.advance(now_s * S)
    assert train.moving

    train.stop()
    train.advance((now_s + 15) * S)
    assert not train.moving
    assert train.bench is not None
    assert "localisation" not in train.bench.vobc.output.cause
    train.go_on()
    train.advance((now_s + 17) * S)

    assert "localisation" in train.bench.vobc.output.cause
    assert not train.moving
    train.close()
