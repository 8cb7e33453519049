"""Train-to-train control in the device: its radio and its command, around a core that is set."""

from collections import Counter
from dataclasses import replace
from typing import Any, cast

import pytest

from firmware_py.ports import RadioMessage
from firmware_py.radio.inproc_radio import InprocRadio
from firmware_py.trackdb import load_line
from hil_tests.unit.vobc.test_vobc_wire import MOTION, heard, link, orders
from hil_tests.unit.vobc.train_to_train.test_t2t_envelope import AUTHORITY, HEARTBEAT, REPORT
from vobc.config import load_config
from vobc.process.line_command import LineCommand, commanded
from vobc.process.line_silence import LineSilence
from vobc.train_to_train.train import TrainCore
from vobc.train_to_train.vocabulary import HeldAuthority, Role, Stepped, TrainMemory, TrainState
from vobc.vocabulary import Authority, Interval, Motion, Restriction
from vobc.wire.line_radio import WAITING_MAX, LineRadio
from zenoh_config import t2t_keys
from zenoh_config.codec import BENCH_KEY, pack, unpack
from zenoh_config.messages import SpeedRestriction
from zenoh_config.t2t import T2tMessage
from zenoh_config.timers import TIMERS_A

MS, OWN, NAME = 1_000_000, 4, "Test line"
CONFIG, LINE = load_config("florence4"), load_line("florence")
HELD = HeldAuthority(900.0, 15.0, 4900 * MS, 1, 7, 100, (SpeedRestriction(10.0, 20.0, 5.0),))
MEMORY = TrainMemory(3)


class Core:
    """Stands for the train's core: it says what the test sets, and keeps what it was given."""

    address = OWN

    def __init__(self) -> None:
        self.listens: frozenset[int] = frozenset()
        self.refusals: Counter[str] = Counter()
        self.round_trip_ms, self.round_trip_max_ms = 12.5, 100
        self.due_ns = 50 * MS
        self.says = Stepped(None, None, ())
        self.given: list[tuple[T2tMessage, ...]] = []
        self.own: list[Any] = []

    def next_due_ns(self) -> int:
        return self.due_ns

    def step(self, _now_ns: int, given: tuple[T2tMessage, ...], own: Any) -> Stepped:
        self.given.append(given)
        self.own.append(own)
        return self.says


class Rig:
    """A line radio around a core that is set, and the memory that it stored."""

    def __init__(self, **changes: Any) -> None:
        self.core, self.stored, self.works = Core(), list[TrainMemory](), True
        self.radio = LineRadio(cast("TrainCore", self.core), NAME, self.store, **changes)

    def store(self, memory: TrainMemory) -> bool:
        self.stored.append(memory)
        return self.works

    def step(self, *, apply: bool = True) -> list[tuple[str, bytes]]:
        return self.radio.step(0, None, apply=apply)  # type: ignore[arg-type]


def sent(
    message: T2tMessage, *, key: str = "", secret: bytes = BENCH_KEY, database: int | None = None
) -> RadioMessage:
    payload = pack(message, secret, database=database)
    return RadioMessage(0, key or t2t_keys.key_of(NAME, message), payload)


def test_at_first_the_train_has_no_authority_and_no_role() -> None:
    radio = Rig().radio

    assert (radio.authority, radio.state, radio.roles) == (None, TrainState.LOST, {})
    assert radio.refused() == {}
    assert radio.key == BENCH_KEY
    assert radio.subscriptions == t2t_keys.of_train(NAME, OWN)
    assert radio.round_trip_ms == (12.5, 100)


def test_authorities_wait_for_the_control_cycle_and_reports_do_not() -> None:
    rig = Rig()
    rig.radio.takes([sent(AUTHORITY), sent(REPORT)])

    rig.step(apply=False)
    rig.step(apply=True)
    rig.step(apply=True)

    assert rig.core.given == [(REPORT,), (AUTHORITY,), ()]


def test_a_message_of_another_protocol_is_handed_on() -> None:
    rig = Rig()
    other = RadioMessage(0, "key", pack(orders()))

    assert rig.radio.takes([other, sent(HEARTBEAT)]) == [other]
    assert rig.radio.takes([sent(HEARTBEAT, key="of/another/sender")]) == []

    rig.step()
    assert rig.core.given == [(HEARTBEAT,)]
    assert rig.radio.refused() == {"wrong source": 1}


def test_only_messages_of_this_survey_and_key_are_taken_and_sent() -> None:
    key = bytes(range(32))
    rig = Rig(database=11, key=key)
    rig.core.says = Stepped(None, None, (HEARTBEAT,))

    rig.radio.takes([sent(REPORT), sent(REPORT, key=""), RadioMessage(0, "key", b"noise")])
    rig.radio.takes(
        [RadioMessage(0, t2t_keys.key_of(NAME, REPORT), pack(REPORT, key, database=11))]
    )
    ((_, payload),) = rig.step()

    assert rig.core.given == [(REPORT,)]
    assert sum(rig.radio.refusals.values()) == 3
    assert unpack(payload, key, database=11) == HEARTBEAT


def test_a_thousand_messages_wait_authorities_among_them() -> None:
    rig = Rig()
    rig.radio.takes([sent(AUTHORITY)] * (WAITING_MAX - 1))
    rig.radio.takes([sent(REPORT), sent(REPORT), sent(AUTHORITY)])

    rig.step()

    assert WAITING_MAX == 1000
    assert rig.radio.refusals == {"flood": 2}
    assert [len(given) for given in rig.core.given] == [1000]


def test_a_step_is_due_for_a_message_or_for_the_core() -> None:
    rig = Rig()
    assert not rig.radio.is_due(50 * MS - 1)
    assert rig.radio.is_due(50 * MS)

    rig.radio.takes([sent(AUTHORITY)])
    assert not rig.radio.is_due(0)
    rig.radio.takes([sent(REPORT)])
    assert rig.radio.is_due(0)
    rig.step()
    assert not rig.radio.is_due(0)


def test_the_port_listens_to_new_areas_once_they_change() -> None:
    rig, heard_of = Rig(), list[Any]()

    class Port:
        def listen(self, wanted: Any) -> None:
            heard_of.append(wanted)

    rig.radio.tune(Port())  # type: ignore[arg-type]
    rig.core.listens = frozenset({6, 5})
    for _ in range(2):
        rig.radio.tune(Port())  # type: ignore[arg-type]

    assert heard_of == [t2t_keys.of_train(NAME, OWN, [5, 6])]
    assert rig.radio.subscriptions == heard_of[0]


def test_nothing_is_applied_or_sent_before_the_memory_is_stored() -> None:
    rig = Rig()
    rig.core.says = Stepped(None, HELD, (HEARTBEAT,), TrainState.CONTROLLED, ((1, Role.MEMBER),))
    assert len(rig.step()) == 1
    assert rig.radio.authority is HELD
    assert (rig.radio.state, rig.radio.roles) == (TrainState.CONTROLLED, {1: Role.MEMBER})

    rig.works = False
    rig.core.says = replace(rig.core.says, memory=MEMORY)
    assert rig.step() == []
    assert rig.radio.authority is None
    rig.core.says = replace(rig.core.says, memory=None)
    assert rig.step() == []
    rig.works = True
    assert len(rig.step()) == 1
    assert rig.radio.authority is HELD
    rig.step()
    assert rig.stored == [MEMORY] * 3


def test_a_message_that_does_not_fit_its_fields_is_counted_and_the_others_are_sent() -> None:
    rig = Rig()
    rig.core.refusals["too old"] = 2
    wrong = replace(REPORT, protected_m=float("nan"))
    rig.core.says = Stepped(None, None, (HEARTBEAT, wrong, REPORT))

    found = rig.step()

    assert [unpack(payload) for _, payload in found] == [HEARTBEAT, REPORT]
    assert [key for key, _ in found] == [
        t2t_keys.key_of(NAME, each) for each in (HEARTBEAT, REPORT)
    ]
    assert rig.radio.refused() == {"not sendable": 1, "too old": 2}


class Commanded(Rig):
    """A line command with a port on a radio, and what was written down."""

    def __init__(self, **changes: Any) -> None:
        super().__init__()
        air = InprocRadio(0.0)
        self.port = air.port("train", self.radio.subscriptions)
        self.peer = air.port("peer", (t2t_keys.key_of(NAME, HEARTBEAT),))
        self.written = 0
        self.command = LineCommand(
            self.radio, self.port, CONFIG, LINE, axles=16, write_down=self.write_down, **changes
        )

    def write_down(self) -> None:
        self.written += 1

    def say(self, *messages: T2tMessage, key: str = "") -> None:
        for message in messages:
            self.peer.send(0, key or t2t_keys.key_of(NAME, message), pack(message))


FAST = replace(MOTION, speed_mps=Interval(9.0, 10.0, 11.0), standstill=False)


def own(motion: Motion | None, *, out_of_service: bool = False) -> Any:
    rig = Commanded()
    rig.command.out_of_service = out_of_service
    rig.command.apply(0, motion)
    return rig.core.own[-1]


@pytest.mark.parametrize("motion", [None, replace(FAST, localised=False)])
def test_a_train_without_a_place_says_only_its_axles(motion: Motion | None) -> None:
    assert own(motion) == (False, *([0.0] * 5), False, 0.0, 0.0, 16, False)
    assert own(motion, out_of_service=True).out_of_service
    assert Commanded().command.out_of_service is False


def test_a_moving_train_says_how_far_it_can_get_by_either_brake() -> None:
    """The emergency brake at 11 m/s on the steepest fall, and the easy brake of 0.5 m/s²."""
    said, slow = own(FAST), own(replace(FAST, speed_mps=Interval(-3.0, -2.0, -1.0)))

    assert (said.localised, said.standstill, said.axles) == (True, False, 16)
    assert (said.front_min_m, said.front_max_m, said.speed_mps) == (99.0, 101.5, 10.0)
    assert said.rear_min_m == 99.0 - CONFIG.train.length_m
    assert said.rests_m == pytest.approx(said.rear_min_m + 81.0 / 20.0)
    assert said.easy_m == pytest.approx(101.5 + 33.0 + 121.0)
    command = Commanded().command
    way_m = command._curve.stopping_m(11.0, lead_s=0.05)
    assert said.reach_m == pytest.approx(101.5 + way_m)
    assert slow.reach_m == pytest.approx(101.5 + command._curve.stopping_m(0.0, lead_s=0.05))
    assert slow.easy_m == slow.reach_m
    assert slow.rests_m == slow.rear_min_m


def test_a_standing_train_reaches_its_front_and_no_more() -> None:
    said = own(replace(FAST, standstill=True, speed_mps=Interval(0.0, 0.0, 0.1)))

    assert said.standstill
    assert said.reach_m == 101.5


def test_the_curve_of_the_train_is_that_of_its_protection_on_the_steepest_fall() -> None:
    curve = Commanded().command._curve
    fall_mps2 = -LINE.worst_gradient_permille(LINE.start_m, LINE.end_m) / 1000.0 * 9.81

    assert curve.decel_mps2 == pytest.approx(CONFIG.atp.guaranteed_decel_mps2 - fall_mps2)
    assert curve.reaction_s == pytest.approx(
        CONFIG.atp.runaway_s(0.05) + CONFIG.atp.brake_build_up_s
    )
    runaway_mps = (CONFIG.atp.runaway_mps2 + fall_mps2) * CONFIG.atp.runaway_s(0.05)
    assert curve.gain_mps == pytest.approx(runaway_mps + fall_mps2 * CONFIG.atp.brake_build_up_s)


def test_messages_are_sent_after_the_cycle_and_once() -> None:
    rig = Commanded()
    rig.core.says = Stepped(None, HELD, (HEARTBEAT,))

    rig.command.apply(0, FAST)
    assert not rig.peer.receive(MS)
    rig.command.send(0)
    rig.command.send(0)

    assert [unpack(each.payload) for each in rig.peer.receive(MS)] == [HEARTBEAT]
    assert rig.command.held is HELD
    assert rig.written == 0


def test_a_beat_answers_only_what_is_due_and_writes_down_each_time() -> None:
    rig = Commanded()
    rig.core.says = Stepped(None, None, (HEARTBEAT,))

    rig.command.beat(10 * MS, FAST)
    assert rig.core.given == []
    rig.say(AUTHORITY)
    rig.command.beat(20 * MS, FAST)
    assert rig.core.given == []
    rig.command.beat(50 * MS, FAST)

    assert rig.core.given == [()]
    assert len(rig.peer.receive(60 * MS)) == 1
    assert rig.written == 3
    rig.command.apply(60 * MS, FAST)
    assert rig.core.given == [(), (AUTHORITY,)]


def test_cycle_and_beat_take_what_the_port_received_and_tune_it() -> None:
    rig = Commanded()
    rig.say(AUTHORITY)
    rig.command.apply(MS, FAST)
    rig.core.listens = frozenset({5})
    rig.command.send(MS)
    assert rig.radio.subscriptions == t2t_keys.of_train(NAME, OWN, [5])

    rig.say(AUTHORITY)
    rig.command.beat(2 * MS, FAST)
    rig.radio.step(3 * MS, None, apply=True)  # type: ignore[arg-type]

    assert rig.core.given == [(AUTHORITY,), (AUTHORITY,)]


def test_refusals_of_the_line_are_noted_by_reason_and_as_they_come() -> None:
    rig, noted = Commanded(), []
    for second, total in enumerate((1, 1, 4)):
        rig.core.refusals["too old"] = total
        rig.command.beat(10 * MS, FAST)
        found = rig.command.refusals.due(second * 1000 * MS)
        noted.append([(each.count, each.detail) for each in found])

    assert noted == [[(1, "from the line")], [], [(3, "from the line")]]
    assert rig.command.refusals.totals == {(0, "too old"): 4}


def test_the_link_gets_the_authority_held_with_its_restrictions() -> None:
    rig, radio = Commanded(), link()
    radio.take(300 * MS, heard(orders()))
    rig.core.says = Stepped(None, HELD, ())
    rig.command.apply(0, FAST)

    rig.command.hold_on(radio)

    assert radio.authority == Authority(900.0, 7, 100, 15.0)
    assert radio.received_authority is not None
    assert radio.received_authority.received_at_ns == 4900 * MS
    assert radio.orders is not None
    assert radio.orders.restrictions[-1] == Restriction(10.0, 20.0, 5.0)
    rig.core.says = Stepped(None, None, ())
    rig.command.apply(0, FAST)
    rig.command.hold_on(radio)
    assert radio.authority is None
    assert radio.orders.restrictions == (Restriction(10.0, 20.0, 8.25),)


def test_silence_and_slow_arbiters_are_seen_on_the_port_and_on_the_centre() -> None:
    bare, silence = Commanded(), LineSilence("tcp/a:1")
    rig = Commanded(silence=silence)
    assert (bare.command.silence(0, 0), bare.command.silence_words) == (None, "")
    assert rig.command.silence(0, 0) is None

    for now_s, from_centre, words in ((4, 1, False), (8, 1, False), (9, 1, True), (10, 2, False)):
        rig.command.silence(now_s * 1000 * MS, from_centre)
        assert bool(rig.command.silence_words) is words
    lost = rig.command.silence(15_000 * MS, 2)
    assert lost is not None
    assert lost.words == rig.command.silence_words
    rig.say(AUTHORITY)
    rig.command.beat(16_000 * MS, FAST)
    assert rig.command.silence(16_000 * MS, 3) is not None, "one more of each"
    assert rig.command.silence_words == ""
    rig.core.round_trip_ms = 101.0
    event = rig.command.silence(17_000 * MS, 4)

    assert event is not None
    assert rig.command.silence_words == event.words == silence.slow


def test_a_commanded_train_has_the_age_of_authorities_that_the_line_agreed_on() -> None:
    found = commanded(CONFIG, TIMERS_A)

    assert found.atp.authority_age_max_s == pytest.approx(TIMERS_A.authority_ms / 1000.0)
    assert replace(found, atp=CONFIG.atp) == CONFIG
