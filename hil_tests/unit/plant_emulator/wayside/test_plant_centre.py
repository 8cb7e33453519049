"""The operations centre and the platform doors: their messages to a train, and the conditions."""

import itertools
from dataclasses import replace
from functools import partial

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.ports import RadioMessage
from firmware_py.trackdb import LineMap, PlatformSide, StoppingPoint, load_line
from firmware_py.trackdb.version import database_version
from plant_emulator.wayside.centre import StandingOrders, joined
from plant_emulator.wayside.platform_doors import PlatformDoors
from plant_emulator.wayside.railway import Railway, subscriptions
from plant_emulator.world import STEP_NS
from zenoh_config import codec, keys
from zenoh_config.codec import unpack
from zenoh_config.messages import (
    RESTRICTIONS_MAX,
    MovementAuthority,
    PositionReport,
    RefusedReason,
    SpeedRestriction,
    TrainOrders,
    TrainStatus,
)
from zenoh_config.sequencing import OrdersGate

pack = partial(codec.pack, database=database_version(load_line("florence")))


LINE = load_line("florence")
REPORT_NS = 200_000_000
STATUS = TrainStatus(
    train=3,
    boot=12,
    sequence=1,
    stamp_ns=123,
    mode=4,
    supervision=1,
    cause=0,
    localised=True,
    standstill=True,
    front_m=3000.0,
    doors_locked=True,
    open_left=False,
    open_right=False,
    passenger_alarm=False,
    fire=False,
    obstacle=False,
    alarm_raised=False,
)
REPORT = PositionReport(3, 12, 1, 123, 2999.5, 3000.5, 2931.0, 0.0, True)
MOVED_ON = {"front_m": 3250.0, "standstill": False}


class Trackside:
    """A railway that gets a request every 200 ms and moves its doors in between."""

    def __init__(self, line: LineMap = LINE) -> None:
        self.railway = Railway(line, line.stations[-1])
        self.now_ns = 0
        self.sequence = 0

    def sent(self, key: str, message: TrainStatus | PositionReport) -> RadioMessage:
        """A message of a train with the track database of this side."""
        payload = codec.pack(message, database=self.railway.zone.database)
        return RadioMessage(self.now_ns, key, payload)

    def ask(self, **changes: object) -> TrainOrders | None:
        self.sequence += 1
        status = replace(STATUS, sequence=self.sequence, stamp_ns=self.now_ns, **changes)  # type: ignore[arg-type]
        heard = self.sent(keys.status("florence", 3), status)
        answers = self.railway.answers([heard], self.now_ns)
        for _ in range(REPORT_NS // STEP_NS):
            self.now_ns += STEP_NS
            self.railway.doors.step(self.now_ns)
        if not answers:
            return None
        [(key, payload)] = answers
        orders = unpack(payload)
        assert isinstance(orders, TrainOrders)
        assert keys.matches(keys.orders("florence", 3), key)
        return orders

    def orders(self, **changes: object) -> TrainOrders:
        orders = self.ask(**changes)
        assert orders is not None
        return orders

    def until_locked_s(self, **changes: object) -> float:
        """Time until the train is informed that the platform doors are locked."""
        began_ns = self.now_ns
        while not self.orders(**changes).platform_doors_locked:
            assert self.now_ns - began_ns < 60_000_000_000
        return (self.now_ns - began_ns) / 1e9

    def report(self, **changes: object) -> MovementAuthority:
        self.sequence += 1
        report = replace(REPORT, sequence=self.sequence, stamp_ns=self.now_ns, **changes)  # type: ignore[arg-type]
        heard = self.sent(keys.report("florence", 3), report)
        [(_, payload)] = self.railway.answers([heard], self.now_ns)
        authority = unpack(payload)
        assert isinstance(authority, MovementAuthority)
        return authority


def test_a_train_on_its_way_is_awake_and_free_of_orders() -> None:
    orders = Trackside().orders(**MOVED_ON)
    flags = (orders.hold, orders.skip_next, orders.stop_next, orders.emergency, orders.creep)
    assert orders.awake
    assert not any(flags)
    assert (orders.releases, orders.restrictions, orders.restricted) == (0, (), False)
    assert orders.platform_doors_locked


def test_the_trains_gate_accepts_every_answer() -> None:
    trackside, gate = Trackside(), OrdersGate(train=3, boot=12, max_age_ns=1_000_000_000)
    for _ in range(50):
        stamp_ns = trackside.now_ns
        assert gate.check(trackside.orders(), stamp_ns + 40_000_000) is None


@pytest.mark.parametrize(
    ("front_m", "right"),
    [(2919.99, False), (2920.0, True), (3000.0, True), (3015.0, True), (3015.01, False)],
)
def test_doors_are_authorised_at_a_platform_on_its_side_alone(front_m: float, right: bool) -> None:
    orders = Trackside().orders(front_m=front_m)
    assert (orders.doors_left, orders.doors_right) == (False, right)


def test_doors_are_authorised_on_the_left_at_a_platform_on_the_left() -> None:
    stations = tuple(replace(each, side=PlatformSide.LEFT) for each in LINE.stations)
    orders = Trackside(replace(LINE, stations=stations)).orders()
    assert (orders.doors_left, orders.doors_right) == (True, False)


def test_doors_are_authorised_on_both_sides_between_two_platforms() -> None:
    stations = tuple(replace(each, side=PlatformSide.BOTH) for each in LINE.stations)
    trackside = Trackside(replace(LINE, stations=stations))

    orders = trackside.orders()
    assert (orders.doors_left, orders.doors_right) == (True, True)
    for side in ("open_left", "open_right"):
        trackside.ask(**{side: True})
        assert not trackside.railway.doors.all_closed
        for _ in range(20):
            trackside.ask()
        assert trackside.railway.doors.all_closed


def test_of_two_platforms_in_reach_the_one_with_the_nearest_stop_counts() -> None:
    """II ends at 3005 m and counts until 3015 m; another platform begins at 3008 m."""
    two = replace(
        LINE.station("III"), stop_m=3060.0, platform_start_m=3008.0, side=PlatformSide.LEFT
    )
    stations = (*LINE.stations[:3], two, LINE.stations[4])
    trackside = Trackside(replace(LINE, stations=stations, tags=()))

    assert trackside.orders(front_m=3012.0).doors_right
    assert trackside.orders(front_m=3060.0).doors_left


def test_platform_doors_open_at_the_stopping_point_of_a_short_train() -> None:
    short = (StoppingPoint(train_length_max_m=80.0, stop_m=2970.0),)
    stations = tuple(
        replace(each, short_stops=short if each.name == "II" else ()) for each in LINE.stations
    )
    trackside = Trackside(replace(LINE, stations=stations))

    trackside.ask(front_m=2985.0, open_right=True)
    assert trackside.railway.doors.all_closed
    trackside.ask(front_m=2970.5, open_right=True)
    assert not trackside.railway.doors.all_closed


def test_a_train_that_does_not_know_where_it_is_gets_orders_but_no_doors() -> None:
    """The position in its status does not matter then."""
    trackside = Trackside()
    trackside.railway.centre.standing = StandingOrders(emergency=True, creep=True)
    orders = trackside.orders(localised=False, front_m=3000.0)
    assert orders.emergency
    assert orders.creep
    assert not orders.doors_left
    assert not orders.doors_right


def test_platform_doors_open_and_close_with_the_trains_and_before_them() -> None:
    """The train's own doors take 2.5 s to close; platform doors must not make it wait."""
    trackside = Trackside()
    for _ in range(15):
        orders = trackside.orders(open_right=True, doors_locked=False)
    assert not orders.platform_doors_locked
    assert trackside.railway.doors.open_ratio("II") == 1.0
    assert trackside.railway.doors.open_ratio("III") == 0.0

    assert trackside.until_locked_s(doors_locked=False) <= 2.2


@pytest.mark.parametrize(
    "changes",
    [
        {"open_left": True},
        {"open_right": True, "standstill": False},
        {"open_right": True, "localised": False},
        {"open_right": True, "front_m": 2998.9},
        {"open_right": True, "front_m": 3001.1},
    ],
)
def test_platform_doors_stay_shut(changes: dict[str, object]) -> None:
    trackside = Trackside()
    for _ in range(20):
        trackside.ask(**changes)
    assert trackside.railway.doors.all_closed


def test_platform_doors_close_when_the_train_falls_silent() -> None:
    trackside = Trackside()
    for _ in range(15):
        trackside.ask(open_right=True)
    for _ in range(300):
        trackside.now_ns += STEP_NS
        trackside.railway.doors.step(trackside.now_ns)
    assert trackside.railway.doors.all_closed


def test_an_obstacle_keeps_platform_doors_open_until_it_is_gone() -> None:
    trackside = Trackside()
    for _ in range(15):
        trackside.ask(open_right=True)
    trackside.railway.doors.obstructed = True
    for _ in range(50):
        assert not trackside.orders().platform_doors_locked
    trackside.railway.doors.obstructed = False
    assert trackside.until_locked_s() <= 6.0


def test_lost_proof_counts_at_a_platform_and_for_a_train_that_may_be_at_one() -> None:
    trackside = Trackside()
    trackside.railway.doors.lose_proof(True)
    assert trackside.railway.doors.all_closed
    assert not trackside.railway.doors.all_locked
    assert not trackside.orders().platform_doors_locked
    assert not trackside.orders(localised=False).platform_doors_locked
    assert trackside.orders(**MOVED_ON).platform_doors_locked
    trackside.railway.doors.lose_proof(False)
    assert trackside.orders().platform_doors_locked


def test_a_line_without_platform_doors_has_them_locked_whatever_happens() -> None:
    stations = tuple(replace(each, platform_doors=False) for each in LINE.stations)
    trackside = Trackside(replace(LINE, stations=stations))
    trackside.railway.doors.lose_proof(True)
    for _ in range(15):
        orders = trackside.orders(open_right=True)
    assert orders.platform_doors_locked
    assert trackside.railway.doors.all_locked


@given(st.lists(st.booleans(), max_size=60))
def test_platform_doors_are_somewhere_between_shut_and_open(demands: list[bool]) -> None:
    doors, station, now_ns = PlatformDoors(LINE), LINE.station("II"), 0
    for wanted in demands:
        before = doors.open_ratio("II")
        doors.ask(station, wanted=wanted, now_ns=now_ns)
        for _ in range(10):
            now_ns += STEP_NS
            doors.step(now_ns)
        after = doors.open_ratio("II")
        assert 0.0 <= after <= 1.0
        assert (after >= before) if wanted else (after <= before)
    for _ in range(400):
        now_ns += STEP_NS
        doors.step(now_ns)
    assert doors.all_locked


def test_a_silent_centre_answers_nothing_and_authorities_go_on() -> None:
    trackside = Trackside()
    trackside.railway.centre.silent = True
    assert trackside.ask() is None
    assert trackside.report().end_m == 4560.0


def test_an_invalid_status_is_counted() -> None:
    railway = Railway(LINE, LINE.station("III"))
    heard = [
        RadioMessage(0, keys.status("florence", 4), pack(STATUS)),
        RadioMessage(0, keys.status("florence", 3), pack(REPORT)),
        RadioMessage(0, keys.report("florence", 3), pack(STATUS)),
        RadioMessage(0, keys.status("florence", 3), b"noise"),
    ]
    assert railway.answers(heard, 0) == []
    assert railway.centre.refusals == {
        RefusedReason.WRONG_SOURCE: 1,
        RefusedReason.UNKNOWN_TYPE: 1,
        RefusedReason.TOO_SHORT: 1,
    }
    assert railway.zone.refusals == {RefusedReason.UNKNOWN_TYPE: 1}


def test_the_wayside_listens_to_reports_and_statuses() -> None:
    wanted = subscriptions("florence")
    for key in (keys.report("florence", 7), keys.status("florence", 7)):
        assert any(keys.matches(expression, key) for expression in wanted)


@given(
    st.lists(
        st.tuples(st.floats(0.0, 4000.0), st.floats(0.0, 500.0), st.floats(1.0, 20.0)),
        max_size=20,
    )
)
def test_restrictions_beyond_what_a_message_holds_are_joined_never_dropped(
    stretches: list[tuple[float, float, float]],
) -> None:
    restrictions = tuple(SpeedRestriction(at, at + long, mps) for at, long, mps in stretches)
    told = joined(restrictions)
    assert len(told) <= RESTRICTIONS_MAX
    for each in restrictions:
        covering = [t for t in told if t.start_m <= each.start_m and t.end_m >= each.end_m]
        assert min(t.limit_mps for t in covering) <= each.limit_mps
    if len(restrictions) <= RESTRICTIONS_MAX:
        assert told == restrictions


def test_ten_metres_behind_the_train_stay_reserved_for_it() -> None:
    trackside = Trackside()
    assert trackside.report().rear_m == 2921.0
    assert trackside.report(rear_min_m=2935.0).rear_m == 2925.0
    assert trackside.report(rear_min_m=2931.0).rear_m == 2925.0
    assert trackside.report(rear_min_m=-115.0, boot=13).rear_m == -120.0 + 0.0
    trackside.railway.zone.rear_protected = False
    assert trackside.report(boot=13).rear_m is None


@pytest.mark.parametrize(
    ("front_min_m", "end_m"), [(2990.0, 3100.0), (3099.9, 3100.0), (3100.0, 3400.0)]
)
def test_a_signal_stops_the_trains_before_it_alone(front_min_m: float, end_m: float) -> None:
    trackside = Trackside()
    trackside.railway.zone.show_stop([3400.0, 3100.0])
    given_m = trackside.report(front_min_m=front_min_m, front_max_m=front_min_m + 1.0).end_m
    assert given_m == end_m


def test_a_train_that_overruns_a_signal_at_stop_gets_no_longer_authority() -> None:
    trackside = Trackside()
    trackside.railway.zone.show_stop([3100.0])
    trackside.report()
    assert trackside.report(front_min_m=3101.0, front_max_m=3102.0).end_m == 3100.0
    trackside.railway.zone.show_stop([])
    assert trackside.report(front_min_m=3101.0, front_max_m=3102.0).end_m == 4560.0


def test_a_withdrawn_authority_ends_where_the_train_was_then() -> None:
    trackside = Trackside()
    trackside.report()
    trackside.railway.zone.withdraw(True)
    ends_m = [trackside.report(front_max_m=front_m).end_m for front_m in (3001.0, 3004.0, 3009.0)]
    assert ends_m == [3001.0, 3001.0, 3001.0]
    assert trackside.railway.zone.farthest_end_m == 4560.0
    trackside.railway.zone.withdraw(False)
    assert trackside.report(front_max_m=3010.0).end_m == 4560.0


def test_the_protected_rear_is_never_ahead_of_the_end() -> None:
    """The train has overrun by more than its length plus the free track behind it."""
    trackside = Trackside()
    trackside.railway.zone.show_stop([3100.0])
    trackside.report()
    authority = trackside.report(front_min_m=3200.0, front_max_m=3201.0, rear_min_m=3131.0)
    assert authority.rear_m == authority.end_m == 3100.0


def test_news_are_counted() -> None:
    trackside = Trackside()
    told = [trackside.railway.told]
    trackside.ask(**MOVED_ON)
    told.append(trackside.railway.told)
    for _ in range(100):
        trackside.railway.doors.step(trackside.now_ns)
    told.append(trackside.railway.told)
    trackside.railway.doors.lose_proof(True)
    trackside.railway.doors.step(trackside.now_ns)
    told.append(trackside.railway.told)
    assert [later - earlier for earlier, later in itertools.pairwise(told)] == [1, 0, 1]


def test_a_train_with_another_survey_gets_orders_that_name_this_one_and_ignore_its_place() -> None:
    railway = Railway(LINE, LINE.stations[-1])
    here = railway.zone.database
    status = codec.pack(replace(STATUS, open_right=True), database=here ^ 1)

    heard = RadioMessage(0, keys.status("florence", 3), status)
    [(_, payload)] = railway.answers([heard], 0)

    orders = unpack(payload, database=here)
    assert isinstance(orders, TrainOrders)
    assert not orders.doors_right
    assert railway.centre.refusals[RefusedReason.OTHER_DATABASE] == 1


def test_a_train_with_another_survey_gets_no_authority() -> None:
    railway = Railway(LINE, LINE.stations[-1])
    report = codec.pack(REPORT, database=railway.zone.database ^ 1)

    heard = RadioMessage(0, keys.report("florence", 3), report)

    assert railway.answers([heard], 0) == []
    assert railway.zone.refusals[RefusedReason.OTHER_DATABASE] == 1


def test_an_authority_repeats_the_version_of_the_vital_parameters() -> None:
    assert Trackside().report(parameters=77).parameters == 77
