"""What a passenger alarm, fire or a door that lost its lock ask of the train, by where it is."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

from can_dbc.vobc import Cause
from vobc.atp.place import PlatformWhereabouts


class AlarmGuardInputs(NamedTuple):
    """Where an alarm meets the train."""

    where: PlatformWhereabouts
    leaving: bool
    """It moves, and part of it is at a platform where it stood or whose stop it has passed."""


@dataclass(frozen=True, slots=True)
class AlarmResponse:
    emergency: Cause = Cause.NONE
    stop_now: bool = False
    stop_next: bool = False
    stay: bool = False
    """Not to depart, and where doors may open, they open and stay open."""


NOTHING: Final = AlarmResponse()
GO_ON: Final = AlarmResponse(stop_next=True)
"""Nobody can be helped between stations: the next one is served, whatever was planned."""
STAY: Final = AlarmResponse(stay=True)
STOP_AND_STAY: Final = AlarmResponse(stop_next=True, stay=True)
STOP_HERE: Final = AlarmResponse(stop_now=True, stay=True)
"""It has hardly moved: doors can open again where it comes to rest by the service brake."""
_PULLED_AWAY_FROM_PLATFORM: Final = AlarmResponse(emergency=Cause.PASSENGER_ALARM, stay=True)
"""Somebody may be caught in a door: nothing is quick enough."""
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
    # Nobody hangs in a door: better the next station than half a train in the tunnel.
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
"""For a train that moves. Traction is cut in any case; without it a train may roll to the next
station."""
