"""Every decision is an event with kind, cause and sources; a cycle without a change has none."""

import itertools
from dataclasses import fields, replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from can_dbc.alarms import TrainAlarms
from can_dbc.brake import BrakeStatus
from can_dbc.vobc import (
    Cause,
    EventKind,
    Inhibit,
    Missing,
    OperatingMode,
    Supervision,
    Withheld,
)
from hil_tests.unit.vobc.atp.heard_rig import DESK
from vobc.events import controller_ends, events_between, memory_lost
from vobc.events.causes import CAUSE_SOURCES
from vobc.vocabulary import (
    NEVER_S,
    SAFE_OUTPUT,
    Authority,
    BrakeFinding,
    Ceiling,
    CycleInput,
    CycleOutput,
    Event,
    Interval,
    Motion,
    Orders,
    RefusedTag,
    Restriction,
    Source,
    TagRefusal,
)

READY_BRAKE = BrakeStatus(0.0, 0.0, False, False, True, True)
ORDERS = Orders(
    awake=True, hold=False, skip_next=False, stop_next=False, emergency=False, releases=2,
    creep=False, restricted=False, doors_left=False, doors_right=True, platform_doors_locked=True,
)  # fmt: skip
AUTHORITY = Authority(end_m=3500.0, term=1, sequence=7, rear_m=2900.0)
SEEN = CycleInput(
    now_ns=1_000_000_000, dt_s=0.05, overruns=0, tacho=None, tacho_age_s=0.01, tacho_samples=(),
    doppler=None, doppler_age_s=0.02, imu=None, imu_age_s=0.02, traction=None,
    traction_age_s=0.03, brake=None, brake_age_s=0.17, doors=None, doors_age_s=NEVER_S, desk=DESK,
    desk_age_s=0.05, tag_reader=None, tag_reader_age_s=0.1, supply=None, supply_age_s=0.1,
    load=None, load_age_s=0.1, tags=(), authority=AUTHORITY, authority_age_s=0.4,
    alarms=TrainAlarms(no_obstacle=True, no_fire=True), alarms_age_s=0.05, orders=ORDERS,
    orders_age_s=0.3,
)  # fmt: skip
MOTION = Motion(
    Interval(99.0, 100.0, 101.5), Interval(19.8, 20.0, 20.31), 0.1, 50.0, False, False, True,
    False, (), wheel_diameter_m=0.85,
)  # fmt: skip
STANDING = replace(MOTION, speed_mps=Interval(0.0, 0.0, 0.0), standing=True, standstill=True)
CEILING = Ceiling(18.0, 19.0, 20.0, 20.28, 214.31)
RUNNING: CycleOutput = replace(
    SAFE_OUTPUT,
    supervision=Supervision.NOMINAL,
    mode=OperatingMode.AUTHORISED,
    motion=MOTION,
    ceiling=CEILING,
    emergency_released=True,
    cause="",
)
OF_SUPERVISION = (
    EventKind.SUPERVISION,
    EventKind.EMERGENCY_APPLIED,
    EventKind.EMERGENCY_RELEASED,
    EventKind.SERVICE_BRAKE,
)
OF_MODE = (
    EventKind.MODE,
    EventKind.WOKEN,
    EventKind.PUT_TO_SLEEP,
    EventKind.JOG_BEGAN,
    EventKind.JOG_ENDED,
)


def events_of(
    before: CycleOutput = RUNNING,
    seen: CycleInput = SEEN,
    seen_before: CycleInput | None = SEEN,
    **changes: Any,
) -> list[Event]:
    """The events of a step from `before` to the same output with these changes."""
    return list(events_between(before, seen, replace(before, **changes), seen_before))


def only(events: list[Event]) -> Event:
    (event,) = events
    return event


def test_a_cycle_without_a_change_has_no_event() -> None:
    later = replace(SEEN, now_ns=2_000_000_000, authority=replace(AUTHORITY, sequence=8))
    further = replace(MOTION, front_m=Interval(101.0, 102.0, 103.5), travel_m=52.0)

    assert events_of() == []
    assert events_of(seen=later, motion=further, ceiling=replace(CEILING, permitted_mps=17.0)) == []


def test_the_first_cycle_reports_the_initial_state() -> None:
    events = list(events_between(None, SEEN, replace(SAFE_OUTPUT, cause="waits for desk")))

    assert [event.kind for event in events] == [EventKind.SUPERVISION, EventKind.MODE]
    assert "waits for desk" in events[0].words


@pytest.mark.parametrize(("old", "new"), [*itertools.permutations(Supervision, 2)])
def test_each_change_of_supervision_is_exactly_one_event(
    old: Supervision, new: Supervision
) -> None:
    before = replace(RUNNING, supervision=old)

    event = only(events_of(before, supervision=new))

    expected = {
        new is Supervision.EMERGENCY: EventKind.EMERGENCY_APPLIED,
        old is Supervision.EMERGENCY: EventKind.EMERGENCY_RELEASED,
    }.get(True)
    if expected is None:
        service = new is Supervision.SERVICE
        expected = EventKind.SERVICE_BRAKE if service else EventKind.SUPERVISION
    assert event.kind is expected
    assert event.kind in OF_SUPERVISION


@pytest.mark.parametrize(("old", "new"), [*itertools.permutations(OperatingMode, 2)])
def test_each_change_of_mode_is_exactly_one_event(old: OperatingMode, new: OperatingMode) -> None:
    event = only(events_of(replace(RUNNING, mode=old), mode=new))

    expected = EventKind.MODE
    if new is OperatingMode.JOG:
        expected = EventKind.JOG_BEGAN
    if new is OperatingMode.ASLEEP:
        expected = EventKind.PUT_TO_SLEEP
    if old is OperatingMode.ASLEEP:
        expected = EventKind.WOKEN
    if old is OperatingMode.JOG:
        expected = EventKind.JOG_ENDED
    assert event.kind is expected
    assert event.kind in OF_MODE


def test_an_overspeed_event_holds_the_deciding_numbers() -> None:
    event = only(
        events_of(
            supervision=Supervision.EMERGENCY, emergency_cause=Cause.OVERSPEED, cause="overspeed"
        )
    )

    assert event.kind is EventKind.EMERGENCY_APPLIED
    assert event.words.startswith(
        "emergency brake: speed 20.31 m/s reached the emergency limit of 20.28 m/s, 214.3 m before"
        " the end of authority"
    )
    assert event.number == Cause.OVERSPEED
    assert event.sources[:2] == (Source.TACHO, Source.AUTHORITY)


@pytest.mark.parametrize("cause", list(Cause))
@pytest.mark.parametrize("blind", [False, True])
def test_every_emergency_event_holds_its_cause_number_and_sources(
    cause: Cause, blind: bool
) -> None:
    nothing: dict[str, Any] = {"motion": None, "ceiling": None} if blind else {}
    seen = replace(SEEN, authority=None, brake=None) if blind else SEEN

    event = only(
        events_of(
            seen=seen,
            seen_before=None,
            supervision=Supervision.EMERGENCY,
            emergency_cause=cause,
            cause="as protection puts it",
            **nothing,
        )
    )

    assert (event.kind, event.number) == (EventKind.EMERGENCY_APPLIED, cause)
    assert event.sources == CAUSE_SOURCES[cause]
    assert len(event.words) > len("emergency brake: ")
    assert "None" not in event.words


def test_another_cause_while_the_brake_is_on_is_an_event_of_its_own() -> None:
    braking = replace(
        RUNNING, supervision=Supervision.EMERGENCY, emergency_cause=Cause.BUTTON, cause="button"
    )

    event = only(events_of(braking, emergency_cause=Cause.REMOTE, cause="ordered by the centre"))

    assert (event.kind, event.number) == (EventKind.EMERGENCY_APPLIED, Cause.REMOTE)
    assert "stays on, now for another cause: ordered by the centre" in event.words


@pytest.mark.parametrize(
    ("seen", "seen_before", "words", "source"),
    [
        (replace(SEEN, desk=replace(DESK, reset_requested=True)), SEEN, "at the desk", Source.DESK),
        (
            replace(SEEN, orders=replace(ORDERS, releases=3)),
            replace(SEEN, orders=ORDERS),
            "by reset 3 of the centre",
            Source.ORDERS,
        ),
        (SEEN, SEEN, "by itself at standstill", Source.TACHO),
        (replace(SEEN, desk=None, orders=None), None, "by itself", Source.TACHO),
    ],
)
def test_a_release_event_names_its_origin(
    seen: CycleInput, seen_before: CycleInput | None, words: str, source: Source
) -> None:
    braking = replace(
        RUNNING, supervision=Supervision.EMERGENCY, emergency_cause=Cause.BUTTON, cause="button"
    )

    events = events_of(
        braking,
        seen,
        seen_before,
        supervision=Supervision.NO_AUTHORITY,
        emergency_cause=Cause.NONE,
        cause="",
    )

    assert events[0].kind is EventKind.EMERGENCY_RELEASED
    assert words in events[0].words
    assert "its cause was: button" in events[0].words
    assert events[0].sources == (source,)
    assert events[0].number == Cause.BUTTON


@pytest.mark.parametrize("flag", [flag for flag in Missing if flag])
def test_each_loss_and_return_of_an_input_is_an_event(flag: Missing) -> None:
    lost = events_of(missing=flag)
    back = events_of(replace(RUNNING, missing=flag), missing=Missing.NOTHING)

    if flag is Missing.LOCALISATION:
        assert lost == back == []
        return
    assert (only(lost).kind, only(back).kind) == (EventKind.INPUT_LOST, EventKind.INPUT_BACK)
    assert only(lost).number == only(back).number == flag
    assert only(lost).sources == only(back).sources != ()


def test_the_event_of_a_silent_input_holds_its_age() -> None:
    words = only(events_of(missing=Missing.BRAKE)).words
    never = only(events_of(missing=Missing.DOORS)).words

    assert words == "brake unit lost: last received 0.17 s ago"
    assert never == "door unit lost: never received"


def test_a_unit_that_answers_but_is_not_ready_is_reported_as_such() -> None:
    unready = replace(READY_BRAKE, ready=False)
    begun = replace(SEEN, brake=READY_BRAKE)
    first = events_between(
        RUNNING, replace(SEEN, brake=unready), RUNNING, replace(SEEN, brake=None)
    )
    later = events_between(
        RUNNING, replace(begun, brake=unready), replace(RUNNING, missing=Missing.BRAKE), begun
    )

    for event in (only(list(first)), only(list(later))):
        assert event.kind is EventKind.INPUT_LOST
        assert event.words == "brake unit reports that it is not ready"
    assert not events_between(RUNNING, begun, RUNNING, replace(SEEN, brake=None))


@pytest.mark.parametrize(
    ("change", "kind", "number", "words"),
    [
        ({"accepted_tag_ids": (204,)}, EventKind.TAG_ACCEPTED, 204, "between 99.00 m and 101.50 m"),
        (
            {"refused_tags": (RefusedTag(301, TagRefusal.OUTSIDE_WINDOW, -20.0),)},
            EventKind.TAG_REJECTED,
            301,
            "tag 301 refused: outside of its expectation window, off by -20.00 m",
        ),
        ({"missed_tags": 1}, EventKind.TAG_MISSED, 1, "1 missed in a row"),
        (
            {"localised": False, "lost_cause": "two tags missed"},
            EventKind.LOCALISATION_LOST,
            0,
            "two tags missed",
        ),
        ({"slip": True}, EventKind.SLIP_BEGAN, 0, "between 19.80 m/s and 20.31 m/s"),
        ({"wheel_diameter_m": 0.8502}, EventKind.WHEEL_CALIBRATED, 0, "850.2 mm, it was 850.0 mm"),
    ],
)
def test_every_finding_of_odometry_is_an_event(
    change: dict[str, Any], kind: EventKind, number: int, words: str
) -> None:
    event = only(events_of(motion=replace(MOTION, **change)))

    assert (event.kind, event.number) == (kind, number)
    assert words in event.words


def test_the_end_of_a_finding_of_odometry_is_an_event() -> None:
    lost = replace(RUNNING, motion=replace(MOTION, localised=False, slip=True, missed_tags=2))

    events = events_of(lost, motion=replace(MOTION, accepted_tag_ids=(204,)))

    assert [event.kind for event in events] == [
        EventKind.LOCALISATION_FOUND,
        EventKind.TAG_ACCEPTED,
        EventKind.SLIP_ENDED,
    ]


def test_a_refined_wheel_measurement_is_no_event() -> None:
    assert events_of(motion=replace(MOTION, wheel_diameter_m=0.85 + 0.9e-4)) == []
    assert len(events_of(motion=replace(MOTION, wheel_diameter_m=0.85 + 1.1e-4))) == 1


@pytest.mark.parametrize(
    ("cars", "words"),
    [(0b1111, "cars 1 to 4"), (0b10, "car 2"), (0b11, "cars 1 and 2"), (0b1011, "cars 1, 2 and 4")],
)
def test_the_event_names_the_cars_whose_doors_are_enabled(cars: int, words: str) -> None:
    standing = replace(RUNNING, motion=STANDING)

    enabled = only(events_of(standing, enable_right=True, door_cars=cars))
    more = only(events_of(replace(standing, enable_right=True), enable_right=True, door_cars=cars))

    assert f"doors enabled on the right in {words}" in enabled.words
    assert more.words == enabled.words


def test_door_enabling_and_the_reasons_against_it_are_events() -> None:
    standing = replace(RUNNING, motion=STANDING)

    enabled = only(events_of(standing, enable_right=True))
    gone = only(events_of(replace(standing, enable_right=True), enable_right=False))
    withheld = only(events_of(standing, doors_withheld=Withheld.MISALIGNED | Withheld.NOT_HELD))

    assert (enabled.kind, enabled.number) == (EventKind.DOORS_ENABLED, 2)
    assert "on the right" in enabled.words
    assert gone.kind is EventKind.DOORS_WITHHELD
    assert withheld.words.startswith("no door is enabled: misaligned, not held")
    assert withheld.sources == (Source.TACHO, Source.BRAKE)


def test_doors_withheld_away_from_a_platform_are_no_event() -> None:
    standing = replace(RUNNING, motion=STANDING)

    assert events_of(standing, doors_withheld=Withheld.NO_PLATFORM | Withheld.NOT_HELD) == []
    assert events_of(doors_withheld=Withheld.MOVING) == []


def test_departure_inhibits_are_reported_at_standstill_only() -> None:
    standing = replace(RUNNING, motion=STANDING)
    held = replace(standing, departure_inhibits=Inhibit.HOLD)

    inhibited = only(events_of(standing, departure_inhibits=Inhibit.HOLD | Inhibit.DOORS))
    permitted = only(events_of(held, departure_inhibits=Inhibit.NONE))

    assert inhibited.words == "departure is not permitted: doors, hold"
    assert inhibited.number == Inhibit.HOLD | Inhibit.DOORS
    assert inhibited.sources == (Source.DOORS, Source.ORDERS)
    assert permitted.kind is EventKind.DEPARTURE_PERMITTED
    assert events_of(departure_inhibits=Inhibit.HOLD) == []


def test_departure_inhibits_are_reported_at_rest_even_if_they_did_not_change() -> None:
    held = replace(RUNNING, departure_inhibits=Inhibit.HOLD | Inhibit.DOORS)

    event = only(events_of(held, motion=STANDING))

    assert event.kind is EventKind.DEPARTURE_INHIBITED
    assert event.words == "departure is not permitted: doors, hold"
    assert events_of(RUNNING, motion=STANDING) == []
    assert events_of(replace(held, motion=STANDING)) == []


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        (
            {"supervision": Supervision.EMERGENCY, "emergency_cause": Cause.REMOTE},
            " after the emergency brake (remote)",
        ),
        ({"missing": Missing.AUTHORITY | Missing.DESK}, " for lack of desk, authority"),
        ({}, ""),
    ],
)
def test_the_end_of_a_movement_names_its_reason(changes: dict[str, Any], reason: str) -> None:
    before = replace(RUNNING, **changes)

    event = only(events_of(before, mode=OperatingMode.STANDBY))

    assert event.words.startswith(f"mode goes from authorised to standby{reason}, at ")


def test_order_events_tell_new_from_withdrawn_orders() -> None:
    now = replace(ORDERS, hold=True, releases=ORDERS.releases + 1)
    first = only(events_of(seen=replace(SEEN, orders=now)))
    then = only(events_of(seen=SEEN, seen_before=replace(SEEN, orders=now)))

    assert first.words == f"the centre orders: hold at the platform, reset {now.releases}"
    assert "hold ended" in then.words


def test_an_alarm_event_names_its_origin() -> None:
    pulled = replace(SEEN, desk=replace(DESK, no_passenger_alarm=False))
    burning = replace(SEEN, alarms=TrainAlarms(no_obstacle=False, no_fire=False))

    assert "passenger alarm" in only(events_of(seen=pulled, alarm_raised=True)).words
    both = only(events_of(seen=burning, alarm_raised=True))
    assert "fire, obstacle" in both.words
    assert both.sources == (Source.ALARMS,)
    assert "cannot correct its stop" in only(events_of(alarm_raised=True)).words
    raised = replace(RUNNING, alarm_raised=True)
    assert only(events_of(raised, alarm_raised=False)).kind is EventKind.ALARM_CLEARED


def test_every_use_of_the_door_bypass_is_an_event() -> None:
    on = only(events_of(door_bypass=True))
    off = only(events_of(replace(RUNNING, door_bypass=True), door_bypass=False))

    assert (on.kind, on.number, off.kind, off.number) == (
        EventKind.DOOR_BYPASS, 1, EventKind.DOOR_BYPASS, 0,
    )  # fmt: skip


def test_disagreements_overruns_and_jogs_are_events() -> None:
    assert only(events_of(replicas_agree=False)).kind is EventKind.REPLICAS_DISAGREE
    missed = only(events_of(seen=replace(SEEN, overruns=2, dt_s=0.15)))
    assert (missed.kind, missed.number) == (EventKind.OVERRUN, 2)
    assert missed.words == "2 control cycles were missed: 0.150 s since the last one"
    jog = only(events_of(jog_attempts=1, mode=OperatingMode.JOG))
    assert (jog.kind, jog.number) == (EventKind.JOG_BEGAN, 1)


@pytest.mark.parametrize(
    ("now", "words"),
    [
        (replace(AUTHORITY, end_m=3200.0), "to 3200.00 m"),
        (replace(AUTHORITY, term=2), "term 2"),
        (replace(AUTHORITY, rear_m=None), "term 1, sequence 7"),
        (replace(AUTHORITY, rear_m=2950.0), None),
        (replace(AUTHORITY, sequence=9), None),
    ],
)
def test_an_authority_is_an_event_when_its_extent_changes(
    now: Authority, words: str | None
) -> None:
    events = events_of(seen=replace(SEEN, authority=now))

    if words is None:
        assert events == []
    else:
        assert only(events).kind is EventKind.AUTHORITY_CHANGED
        assert words in only(events).words


@pytest.mark.parametrize("name", [field.name for field in fields(Orders)])
def test_every_change_of_an_order_is_an_event(name: str) -> None:
    old = getattr(ORDERS, name)
    new: Any = (Restriction(10.0, 20.0, 8.25),)
    if name != "restrictions":
        new = 3 if name == "releases" else not old

    event = only(events_of(seen=replace(SEEN, orders=replace(ORDERS, **{name: new}))))

    assert event.kind is EventKind.ORDERS_CHANGED
    assert event.words.count(",") == 0
    if name == "restrictions":
        assert "8.25 m/s from 10.0 m to 20.0 m" in event.words


def test_repeated_orders_are_no_event() -> None:
    assert events_of(seen=replace(SEEN, orders=replace(ORDERS))) == []


def test_events_outside_the_cycles_have_their_texts() -> None:
    assert memory_lost().kind is EventKind.MEMORY_LOST
    assert controller_ends().kind is EventKind.SUPERVISION


outputs = st.builds(
    replace,
    st.just(RUNNING),
    supervision=st.sampled_from(Supervision),
    mode=st.sampled_from(OperatingMode),
    emergency_cause=st.sampled_from(Cause),
    missing=st.integers(0, 511).map(Missing),
    departure_inhibits=st.integers(0, 1023).map(Inhibit),
    doors_withheld=st.integers(0, 1023).map(Withheld),
    enable_left=st.booleans(),
    enable_right=st.booleans(),
    alarm_raised=st.booleans(),
    door_bypass=st.booleans(),
    replicas_agree=st.booleans(),
    jog_attempts=st.integers(0, 3),
    motion=st.sampled_from((None, MOTION, STANDING, replace(MOTION, localised=False, slip=True))),
    ceiling=st.sampled_from((None, CEILING)),
)
inputs = st.builds(
    replace,
    st.just(SEEN),
    overruns=st.integers(0, 5),
    desk=st.sampled_from((None, DESK)),
    authority=st.sampled_from((None, AUTHORITY, replace(AUTHORITY, end_m=1.0))),
    orders=st.sampled_from((None, ORDERS, replace(ORDERS, hold=True))),
    alarms=st.sampled_from((None, TrainAlarms(False, False))),
)


@given(st.none() | outputs, inputs, outputs, st.none() | inputs)
def test_any_two_cycles_give_encodable_events(
    before: CycleOutput | None,
    seen: CycleInput,
    output: CycleOutput,
    seen_before: CycleInput | None,
) -> None:
    events = events_between(before, seen, output, seen_before)

    for event in events:
        assert event.words
        assert "None" not in event.words
        assert event.number >= 0
        assert len(set(event.sources)) == len(event.sources)
    kinds = [event.kind for event in events]
    assert sum(kind in OF_SUPERVISION for kind in kinds) <= 1
    if before is not None and before.supervision is not output.supervision:
        assert kinds[0] in OF_SUPERVISION, "the weightiest first"


@pytest.mark.parametrize(
    ("found", "kind", "number", "words"),
    [
        (
            BrakeFinding(True, 3.0, -0.2),
            EventKind.BRAKE_LATE,
            3000,
            "acts 3.00 s after its command",
        ),
        (BrakeFinding(False, 0.6, -0.2), EventKind.BRAKE_WEAK, 80, "gives 80 % of the demanded"),
        (BrakeFinding(False, 0.6, -0.3), EventKind.BRAKE_WEAK, 70, "gives 70 % or less of"),
    ],
)
def test_a_finding_about_the_brake_is_one_event(
    found: BrakeFinding, kind: EventKind, number: int, words: str
) -> None:
    before = replace(SAFE_OUTPUT, motion=MOTION)

    (event,) = events_between(before, SEEN, replace(before, brake_finding=found))
    again = events_between(replace(before, brake_finding=found), SEEN, before)

    assert (event.kind, event.number) == (kind, number)
    assert words in event.words
    assert not again
