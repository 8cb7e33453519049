"""Responses to alarms: the tests state each table a second time, independently of the source."""

from collections.abc import Mapping
from typing import Final

import pytest

from can_dbc.vobc import Cause
from vobc.atp.alarms import (
    DOOR_UNLOCKED,
    FIRE,
    NOTHING,
    PASSENGER_ALARM,
    AlarmGuardInputs,
    AlarmResponse,
)
from vobc.atp.place import PlatformWhereabouts

UNKNOWN, BETWEEN, ARRIVING = (
    PlatformWhereabouts.UNKNOWN,
    PlatformWhereabouts.BETWEEN,
    PlatformWhereabouts.ARRIVING,
)
NEAR, ALIGNED, PAST = (
    PlatformWhereabouts.NEAR,
    PlatformWhereabouts.ALIGNED,
    PlatformWhereabouts.PAST,
)

# Each response as: emergency brake, service brake at once, stop at the next station, stay there.
ON: Final = (Cause.NONE, False, True, False)
STAY: Final = (Cause.NONE, False, False, True)
COME_TO_STAY: Final = (Cause.NONE, False, True, True)
HERE: Final = (Cause.NONE, True, False, True)
CAUGHT: Final = (Cause.PASSENGER_ALARM, False, False, True)
OPEN: Final = (Cause.DOOR_UNLOCKED, False, False, False)


def as_tuple(answer: AlarmResponse) -> tuple[Cause, bool, bool, bool]:
    return answer.emergency, answer.stop_now, answer.stop_next, answer.stay


@pytest.mark.parametrize(
    ("table", "staying", "leaving"),
    [
        (
            PASSENGER_ALARM,
            {
                UNKNOWN: ON,
                BETWEEN: ON,
                ARRIVING: ON,
                NEAR: COME_TO_STAY,
                ALIGNED: COME_TO_STAY,
                PAST: STAY,
            },
            {ARRIVING: CAUGHT, NEAR: CAUGHT, ALIGNED: HERE, PAST: CAUGHT},
        ),
        (
            FIRE,
            {
                UNKNOWN: ON,
                BETWEEN: ON,
                ARRIVING: ON,
                NEAR: COME_TO_STAY,
                ALIGNED: COME_TO_STAY,
                PAST: ON,
            },
            {ARRIVING: ON, NEAR: ON, ALIGNED: HERE, PAST: ON},
        ),
        (
            DOOR_UNLOCKED,
            {UNKNOWN: OPEN, BETWEEN: ON, ARRIVING: ON, NEAR: ON, ALIGNED: ON, PAST: OPEN},
            {ARRIVING: OPEN, NEAR: OPEN, ALIGNED: OPEN, PAST: OPEN},
        ),
    ],
)
def test_every_place_of_a_staying_or_leaving_train_has_its_response(
    table: Mapping[AlarmGuardInputs, AlarmResponse],
    staying: Mapping[PlatformWhereabouts, tuple[Cause, bool, bool, bool]],
    leaving: Mapping[PlatformWhereabouts, tuple[Cause, bool, bool, bool]],
) -> None:
    """A train can only leave where there is a platform."""
    expected = {AlarmGuardInputs(where, False): answer for where, answer in staying.items()}
    expected |= {AlarmGuardInputs(where, True): answer for where, answer in leaving.items()}

    assert {situation: as_tuple(answer) for situation, answer in table.items()} == expected


def test_without_an_alarm_the_response_is_empty() -> None:
    assert as_tuple(NOTHING) == (Cause.NONE, False, False, False)
