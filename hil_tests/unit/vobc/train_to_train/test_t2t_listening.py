"""Which areas a train listens to: those that concern it; it ignores messages of the others."""

from collections.abc import Sequence
from dataclasses import replace
from unittest.mock import Mock

import pytest

from firmware_py.radio.inproc_radio import InprocRadio
from firmware_py.trackdb.areas import Area, AreaMap
from hil_tests.unit.vobc.train_to_train.test_t2t_hearing import (
    NOT_NEWER,
    OWN,
    SPOKEN,
    fresh,
    head,
    report,
    why_not,
)
from vobc.train_to_train.train import FAREWELL_M, LISTENS_NS, TrainCore
from vobc.train_to_train.vocabulary import OwnTrain, Role, T2tConfig, TrainMemory
from vobc.wire.line_radio import LineRadio
from zenoh_config import keys, t2t_keys
from zenoh_config.codec import pack
from zenoh_config.messages import WAYSIDE, RefusedReason
from zenoh_config.t2t import (
    BROADCAST,
    FIRST_ARBITER,
    LAST_TRAIN,
    SUPERVISION,
    LineOrder,
    ObjectState,
    ObjectStatus,
    OrderKind,
    RosterAck,
    SwitchKind,
    SwitchStep,
    T2tMessage,
)

MS = 1_000_000
LENGTH_M = 80.0
AREA_M = 2000.0
LINE = AreaMap("Long line", tuple([Area(n + 1, n * AREA_M, (n + 1) * AREA_M) for n in range(10)]))
BORDER_M = 10_000.0
"""Border between areas 5 and 6, m."""


class Ride:
    """One train that the test steps every second."""

    def __init__(self) -> None:
        self.core = TrainCore(T2tConfig(), LINE, address=OWN, memory=TrainMemory(2), start_ns=0)
        self.now_ns = 0

    def at(
        self,
        front_m: float,
        *,
        localised: bool = True,
        for_s: int = 1,
        heard: Sequence[T2tMessage] = (),
    ) -> frozenset[int]:
        rear_m = front_m - LENGTH_M
        own = OwnTrain(
            *(localised, front_m, front_m, rear_m, rear_m, 2.0, False, front_m, front_m, 16)
        )
        for _ in range(for_s):
            self.now_ns += 1000 * MS
            self.core.step(self.now_ns, tuple(heard), own)
        return self.core.listens


def test_a_train_listens_in_its_own_area_and_in_the_next_once_it_applies_there() -> None:
    ride = Ride()
    assert ride.core.listens == frozenset()

    assert ride.at(BORDER_M - LINE.apply_m - 0.1) == {5}
    assert ride.at(BORDER_M - LINE.apply_m) == {5, 6}
    assert ride.at(BORDER_M + LENGTH_M + FAREWELL_M) == {5, 6}


def test_it_goes_on_listening_for_ten_seconds_in_an_area_that_no_longer_concerns_it() -> None:
    ride = Ride()
    ride.at(BORDER_M)
    gone_m = BORDER_M + LENGTH_M + FAREWELL_M + 0.1

    assert LISTENS_NS == 10_000 * MS
    assert ride.at(gone_m, for_s=10) == {5, 6}
    assert ride.at(gone_m) == {6}


def test_a_train_that_still_commands_an_area_it_left_goes_on_listening_there() -> None:
    """A master stays with its trains until another one has taken over."""
    ride = Ride()
    ride.at(BORDER_M)
    gone_m = BORDER_M + LENGTH_M + FAREWELL_M + 0.1
    ride.at(gone_m, for_s=10)
    desk = ride.core.desk(5)
    assert desk is not None
    desk.role = Role.MASTER

    assert ride.at(gone_m) == {5, 6}
    # Without a lease the train is no longer master.
    assert ride.at(gone_m, for_s=2) == {6}


def test_bounds_that_oscillate_around_a_border_change_nothing() -> None:
    ride = Ride()
    before_m = BORDER_M - LINE.apply_m
    both = ride.at(before_m)

    for _ in range(5):
        assert ride.at(before_m - 0.5, for_s=9) is both
        assert ride.at(before_m) is both


def test_a_lost_train_goes_on_listening_where_it_has_a_role() -> None:
    ride = Ride()
    ride.at(1000.0)
    desk = ride.core.desk(1)
    assert desk is not None
    assert desk.role is not Role.OUTSIDE

    assert ride.at(0.0, localised=False, for_s=60) == {1}


def test_a_train_that_never_had_a_position_listens_nowhere() -> None:
    assert Ride().at(1000.0, localised=False, for_s=5) == frozenset()


def key(message: T2tMessage) -> str:
    return t2t_keys.key_of(LINE.name, message)


def test_the_radio_port_follows_the_areas_that_the_train_listens_to() -> None:
    ride = Ride()
    radio = LineRadio(ride.core, LINE.name, lambda _: True)
    port = Mock(listen=Mock())

    def receives(area: int) -> bool:
        said = key(report(head(7, to=BROADCAST, area=area)))
        return any(keys.matches(each, said) for each in radio.subscriptions)

    def steps() -> None:
        ride.now_ns += 1000 * MS
        own = OwnTrain(*(True, 500.0, 500.0, 420.0, 420.0, 2.0, False, 500.0, 500.0, 16))
        radio.step(ride.now_ns, own, apply=True)
        radio.tune(port)

    assert not receives(1)
    steps()
    assert [area for area in range(1, 11) if receives(area)] == [1]
    port.listen.assert_called_once_with(radio.subscriptions)
    steps()
    port.listen.assert_called_once()


@pytest.mark.parametrize("areas", [(), (4,)])
def test_a_train_always_receives_its_own_messages_and_those_under_its_address(
    areas: tuple[int, ...],
) -> None:
    wanted = t2t_keys.of_train(LINE.name, OWN, areas)
    for_it = LineOrder(*head(SUPERVISION, to=OWN, area=9), OrderKind.STOP, OWN)
    double = report(head(OWN, to=BROADCAST, area=9))

    for message in (for_it, double):
        assert any(keys.matches(each, key(message)) for each in wanted)
    other = report(head(7, to=BROADCAST, area=9))
    assert not any(keys.matches(each, key(other)) for each in wanted)


def test_a_port_of_the_virtual_radio_can_change_its_subscriptions() -> None:
    air = InprocRadio(0.005)
    wayside, train = air.port("wayside", ()), air.port("train", ("m/1",))
    for at_ms, wanted in enumerate((("m/2",), ("m/1", "m/2"), ())):
        train.listen(wanted)
        for said in ("m/1", "m/2"):
            wayside.send(at_ms * 10 * MS, said, pack(report(head(7))))

        assert tuple(each.key for each in train.receive((at_ms + 1) * 10 * MS)) == wanted


def test_message_orders_of_a_left_area_are_discarded() -> None:
    hearing = fresh()
    here, there = report(head(7, area=1)), report(head(7, area=2))
    order = LineOrder(*head(SUPERVISION, area=1), OrderKind.STOP, OWN)
    switch = ObjectStatus(*head(WAYSIDE, area=1), 3, ObjectState.FREE, 0, 0, False)
    first, last = report(head(1)), report(head(LAST_TRAIN))
    ack = RosterAck(*head(FIRST_ARBITER), 1)
    forgotten, kept = (here, first, last), (there, order, switch, ack)
    assert [why_not(hearing, each) for each in (*forgotten, *kept)] == [None] * 7

    hearing.forget(1)

    assert [why_not(hearing, each) for each in forgotten] == [None] * 3
    assert [why_not(hearing, each) for each in kept] == [NOT_NEWER] * 4


def test_a_train_can_meet_more_trains_than_it_has_streams() -> None:
    """There are 700 trains in each of ten areas. Without dropping old streams it would ignore
    the later ones."""
    ride = Ride()
    for area in range(1, 11):
        middle_m = (area - 0.5) * AREA_M
        ride.at(middle_m, for_s=12)
        for source in range(100, 800):
            said = replace(report(head(source, to=BROADCAST, area=area)), sequence=1)
            assert ride.core._hearing.admits(said, SPOKEN)
        assert len(ride.core._hearing._newest) <= 1400


@pytest.mark.parametrize("area", [0, 11, 255])
def test_messages_of_unknown_areas_are_refused(area: int) -> None:
    ride = Ride()
    step = SwitchStep(*head(7, area=area), SwitchKind.PREPARE, 1, OWN)

    ride.at(500.0, heard=[step, step, report(head(8, area=area))])

    assert ride.core.refusals == {"unknown area": 3}


def test_a_duplicate_address_is_detected_in_any_area() -> None:
    ride = Ride()

    ride.at(500.0, heard=[report(head(OWN, area=11, boot=9))])

    assert ride.core.refusals == {RefusedReason.WRONG_SOURCE.value: 1}
