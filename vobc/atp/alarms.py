"""Reaction to a passenger alarm, a fire or an unlocked door, depending on the train's place."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

from can_dbc.vobc import Cause
from vobc.atp.place import PlatformWhereabouts


class AlarmGuardInputs(NamedTuple):
    """Place and movement of the train when the alarm occurs."""

    where: PlatformWhereabouts
    leaving: bool
    """The train moves, and part of it is at a platform where it stood or whose stop it has passed.
    """


@dataclass(frozen=True, slots=True)
class AlarmResponse:
    emergency: Cause = Cause.NONE
    stop_now: bool = False
    stop_next: bool = False
    stay: bool = False
    """Do not depart. Doors that may open are opened and kept open."""


NOTHING: Final = AlarmResponse()
GO_ON: Final = AlarmResponse(stop_next=True)
"""Help is impossible between stations. The train stops at the next station, whatever was planned.
"""
STAY: Final = AlarmResponse(stay=True)
STOP_AND_STAY: Final = AlarmResponse(stop_next=True, stay=True)
STOP_HERE: Final = AlarmResponse(stop_now=True, stay=True)
"""The train has hardly moved. It stops with the service brake where its doors can open again."""
_PULLED_AWAY_FROM_PLATFORM: Final = AlarmResponse(emergency=Cause.PASSENGER_ALARM, stay=True)
"""A person may be caught in a door, so only the emergency brake is fast enough."""
_UNLOCKED: Final = AlarmResponse(emergency=Cause.DOOR_UNLOCKED)

_W = PlatformWhereabouts

PASSENGER_ALARM: Final[Mapping[AlarmGuardInputs, AlarmResponse]] = {
    AlarmGuardInputs(_W.UNKNOWN, False): GO_ON,
    AlarmGuardInputs(_W.BETWEEN, False): GO_ON,
    AlarmGuardInputs(_W.ARRIVING, False): GO_ON,
    AlarmGuardInputs(_W.ARRIVING, True): _PULLED_AWAY_FROM_PLATFORM,
    AlarmGuardInputs(_W.NEAR, False): STOP_AND_STAY,
    AlarmGuardInputs(_W.NEAR, True): _PULLED_AWAY_FROM_PLATFORM,
    AlarmGuardInputs(_W.ALIGNED, False): STOP_AND_STAY,
    AlarmGuardInputs(_W.ALIGNED, True): STOP_HERE,
    AlarmGuardInputs(_W.PAST, False): STAY,
    AlarmGuardInputs(_W.PAST, True): _PULLED_AWAY_FROM_PLATFORM,
}
FIRE: Final[Mapping[AlarmGuardInputs, AlarmResponse]] = {
    **PASSENGER_ALARM,
    # No person is caught in a door. Stopping at the next station is better than half a train in the
    # tunnel.
    AlarmGuardInputs(_W.ARRIVING, True): GO_ON,
    AlarmGuardInputs(_W.NEAR, True): GO_ON,
    AlarmGuardInputs(_W.PAST, False): GO_ON,
    AlarmGuardInputs(_W.PAST, True): GO_ON,
}
DOOR_UNLOCKED: Final[Mapping[AlarmGuardInputs, AlarmResponse]] = {
    AlarmGuardInputs(_W.UNKNOWN, False): _UNLOCKED,
    AlarmGuardInputs(_W.BETWEEN, False): GO_ON,
    AlarmGuardInputs(_W.ARRIVING, False): GO_ON,
    AlarmGuardInputs(_W.ARRIVING, True): _UNLOCKED,
    AlarmGuardInputs(_W.NEAR, False): GO_ON,
    AlarmGuardInputs(_W.NEAR, True): _UNLOCKED,
    AlarmGuardInputs(_W.ALIGNED, False): GO_ON,
    AlarmGuardInputs(_W.ALIGNED, True): _UNLOCKED,
    AlarmGuardInputs(_W.PAST, False): _UNLOCKED,
    AlarmGuardInputs(_W.PAST, True): _UNLOCKED,
}
"""Reactions of a moving train. Traction is cut in any case, and without it the train may roll to
the next station."""
