"""What protection takes from the inputs at stations: each input by itself, and silence."""

import math
from dataclasses import fields, replace
from typing import Any, Final

import pytest

from can_dbc.alarms import TrainAlarms
from can_dbc.doors import DoorState, DoorStatus
from can_dbc.vobc import Missing
from hil_tests.unit.vobc.atp.heard_rig import DESK, NO_ORDERS, SILENCE
from vobc.atp.received import StationInputs, listen
from vobc.config import load_config

CONFIG: Final = load_config("florence4").atp
ORDERS: Final = NO_ORDERS
UNLOCKED: Final = DoorStatus(False, DoorState.LOCKED, DoorState.LOCKED, True)
CALM: Final = replace(
    SILENCE,
    doors=UNLOCKED,
    doors_age_s=0.0,
    desk=DESK,
    desk_age_s=0.0,
    alarms=TrainAlarms(True, True),
    alarms_age_s=0.0,
    orders=ORDERS,
    orders_age_s=0.0,
)
NOTHING: Final = StationInputs(*(False,) * len(fields(StationInputs)))


def ordered(**orders: Any) -> dict[str, Any]:
    return {"orders": replace(ORDERS, **orders)}


@pytest.mark.parametrize(
    ("said", "understood"),
    [
        ({}, {}),
        (ordered(doors_left=True), {"doors_left": True}),
        (ordered(doors_right=True), {"doors_right": True}),
        (ordered(platform_doors_locked=True), {"platform_doors_locked": True}),
        (ordered(awake=True), {"awake": True}),
        (ordered(hold=True), {"hold": True}),
        (ordered(stop_next=True), {"stop_next": True}),
        (ordered(emergency=True), {"centre_emergency": True}),
        (ordered(skip_next=True, creep=True, restricted=True), {}),
        ({"doors": replace(UNLOCKED, closed_and_locked=True)}, {"doors_locked": True}),
        ({"desk": replace(DESK, door_bypass_requested=True)}, {"door_bypass": True}),
        ({"desk": replace(DESK, no_passenger_alarm=False)}, {"passenger_alarm": True}),
        ({"alarms": TrainAlarms(no_obstacle=True, no_fire=False)}, {"fire": True}),
        (
            {"alarms": TrainAlarms(no_obstacle=False, no_fire=True)},
            {"obstacle": True, "no_obstacle": False},
        ),
    ],
)
def test_each_input_field_sets_one_term(said: dict[str, Any], understood: dict[str, bool]) -> None:
    calm = replace(NOTHING, centre=True, no_obstacle=True)

    assert listen(replace(CALM, **said), CONFIG, 0) == replace(calm, **understood)


ALL_SAID: Final = replace(
    CALM,
    orders=replace(
        ORDERS,
        awake=True,
        hold=True,
        stop_next=True,
        emergency=True,
        doors_left=True,
        doors_right=True,
        platform_doors_locked=True,
    ),
    doors=replace(UNLOCKED, closed_and_locked=True),
    desk=replace(DESK, door_bypass_requested=True, no_passenger_alarm=False),
    alarms=TrainAlarms(no_obstacle=False, no_fire=False),
)
ALL_HEARD: Final = replace(StationInputs(*(True,) * len(fields(StationInputs))), no_obstacle=False)
NO_CENTRE: Final = dict.fromkeys(
    (
        "centre",
        "doors_left",
        "doors_right",
        "platform_doors_locked",
        "awake",
        "hold",
        "stop_next",
        "centre_emergency",
    ),
    False,
)
NO_ALARMS: Final = {"fire": False, "obstacle": False}
NO_DESK: Final = {"door_bypass": False, "passenger_alarm": False}
LATE: Final = 1.000001
"""Factor by which an input is older than its maximum age."""


@pytest.mark.parametrize(
    ("silent", "gone", "lost"),
    [
        ({}, 0, {}),
        ({"orders": None}, 0, NO_CENTRE),
        ({"orders_age_s": CONFIG.orders_age_max_s}, 0, {}),
        ({"orders_age_s": CONFIG.orders_age_max_s * LATE}, 0, NO_CENTRE),
        ({"orders_age_s": math.nan}, 0, NO_CENTRE),
        ({"alarms": None}, 0, NO_ALARMS),
        ({"alarms_age_s": CONFIG.timeouts.alarms_s}, 0, {}),
        ({"alarms_age_s": CONFIG.timeouts.alarms_s * LATE}, 0, NO_ALARMS),
        ({"alarms_age_s": math.nan}, 0, NO_ALARMS),
        ({"desk": None}, 0, NO_DESK),
        ({}, int(Missing.DESK), NO_DESK),
        ({"doors": None}, 0, {"doors_locked": False}),
        ({}, int(Missing.DOORS), {"doors_locked": False}),
        ({}, ~int(Missing.DESK | Missing.DOORS), {}),
    ],
)
def test_a_silent_input_sets_no_term(
    silent: dict[str, Any], gone: int, lost: dict[str, bool]
) -> None:
    assert listen(replace(ALL_SAID, **silent), CONFIG, gone) == replace(ALL_HEARD, **lost)


def test_silent_detectors_do_not_report_a_clear_track() -> None:
    assert not listen(SILENCE, CONFIG, 0).no_obstacle
    assert listen(SILENCE, CONFIG, 0) == NOTHING
