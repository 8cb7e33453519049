"""Events from outside the train: orders of the centre, signals, platforms, and alarms.

Orders are not faults. They are in the catalogue so that a scenario can give them at an instant or a
place like any other event.
"""

from dataclasses import dataclass

from plant_emulator.faults.declared_train import DoorsOf
from plant_emulator.faults.kinds import FaultPlace, Hazard, check_range, fault


@fault("cold_movement", FaultPlace.SENSOR, Hazard.MISLOCATED)
@dataclass(frozen=True, slots=True)
class ColdMoved:
    """The cold-movement detector reports that the train moved while the controller was off."""

    moved_m: float = 5.0
    """Distance from where the controller was switched off; the train itself is not moved."""
    monitored: bool = True
    """False: the detector cannot tell, because it did not monitor all the time."""

    def __post_init__(self) -> None:
        check_range(self, "moved_m", 0.0, 160.0)


@fault("ats_hold", FaultPlace.WAYSIDE, Hazard.LOST_SERVICE)
@dataclass(frozen=True, slots=True)
class AtsHold:
    """The centre orders the train not to depart from its present or next platform."""


@fault("ats_skip", FaultPlace.WAYSIDE, Hazard.LOST_SERVICE)
@dataclass(frozen=True, slots=True)
class AtsSkip:
    """The centre orders the train not to stop at the next station."""


@fault("ats_stop_next", FaultPlace.WAYSIDE, Hazard.LOST_SERVICE)
@dataclass(frozen=True, slots=True)
class AtsStopNext:
    """The centre orders the train to stop at the next station and to stay there."""


@fault("remote_emergency", FaultPlace.WAYSIDE, Hazard.LOST_SERVICE)
@dataclass(frozen=True, slots=True)
class RemoteEmergency:
    """The centre orders the emergency brake; the end of the order alone does not release it."""


@fault("remote_release", FaultPlace.WAYSIDE, Hazard.UNWANTED_MOTION)
@dataclass(frozen=True, slots=True)
class RemoteRelease:
    """The centre resets an emergency once, when this event begins."""


@fault("sleep", FaultPlace.WAYSIDE, Hazard.LOST_SERVICE)
@dataclass(frozen=True, slots=True)
class Sleep:
    """The centre sends the train to sleep and wakes it at the end."""


@fault("creep_order", FaultPlace.WAYSIDE, Hazard.UNWANTED_MOTION, Hazard.OVERSPEED)
@dataclass(frozen=True, slots=True)
class CreepOrder:
    """The centre permits a train without position or authority to creep."""


@fault("restricted_order", FaultPlace.WAYSIDE, Hazard.UNWANTED_MOTION, Hazard.OVERSPEED)
@dataclass(frozen=True, slots=True)
class RestrictedOrder:
    """The centre permits a person to drive on sight."""


@fault("temporary_restriction", FaultPlace.WAYSIDE, Hazard.OVERSPEED)
@dataclass(frozen=True, slots=True)
class TemporaryRestriction:
    """The centre imposes a temporary speed restriction."""

    start_m: float = 3200.0
    end_m: float = 3300.0
    limit_mps: float = 8.333333333333334

    def __post_init__(self) -> None:
        check_range(self, "start_m", -1.0e5, 1.0e5)
        check_range(self, "end_m", -1.0e5, 1.0e5)
        check_range(self, "limit_mps", 0.1, 50.0)


@fault("signal_stop", FaultPlace.WAYSIDE, Hazard.OVERRUN)
@dataclass(frozen=True, slots=True)
class SignalStop:
    """A signal shows stop: the authority of a train in front of it ends there.

    A train that has already passed the signal is not affected.
    """

    position_m: float = 450.0

    def __post_init__(self) -> None:
        check_range(self, "position_m", -1.0e5, 1.0e5)


@fault("authority_withdrawn", FaultPlace.WAYSIDE, Hazard.OVERRUN)
@dataclass(frozen=True, slots=True)
class AuthorityWithdrawn:
    """The authority is withdrawn to the train's present front."""


@fault("wrong_map", FaultPlace.WAYSIDE, Hazard.OVERRUN)
@dataclass(frozen=True, slots=True)
class WrongMap:
    """The zone controller has another map: all its authorities end this much further along."""

    shift_m: float = 10000.0

    def __post_init__(self) -> None:
        check_range(self, "shift_m", -1.0e5, 1.0e5)


@fault("switch_lost", FaultPlace.WAYSIDE, Hazard.LOST_SERVICE)
@dataclass(frozen=True, slots=True)
class SwitchLost:
    """The detection of a switch reports no end position; the switch itself does not move."""

    switch: str = "W1"


@fault("switch_stray", FaultPlace.WAYSIDE, Hazard.OVERRUN)
@dataclass(frozen=True, slots=True)
class SwitchStray:
    """A switch moves to its other end position although it is locked, and back at the end."""

    switch: str = "W1"


@fault("switch_stuck", FaultPlace.WAYSIDE, Hazard.LOST_SERVICE)
@dataclass(frozen=True, slots=True)
class SwitchStuck:
    """A switch does not move, so it may lie wrong for the route of the train."""

    switch: str = "W1"


@fault("route_set", FaultPlace.WAYSIDE, Hazard.LOST_SERVICE)
@dataclass(frozen=True, slots=True)
class RouteSet:
    """The signaller sets a route by hand once nothing conflicts, and cancels it at the end.

    The interlocking refuses the train every route that conflicts with it meanwhile.
    """

    route: str = "back"


@fault("track_closed", FaultPlace.WAYSIDE, Hazard.LOST_SERVICE)
@dataclass(frozen=True, slots=True)
class TrackClosed:
    """The signaller closes a track for work: no route leads into it until the end.

    A train on the track is not affected.
    """

    track: str = "stem"


@fault("rear_unprotected", FaultPlace.WAYSIDE, Hazard.UNWANTED_MOTION)
@dataclass(frozen=True, slots=True)
class RearUnprotected:
    """Authorities do not protect the track behind the train."""


@fault("other_database", FaultPlace.WAYSIDE, Hazard.OVERRUN, Hazard.MISLOCATED)
@dataclass(frozen=True, slots=True)
class OtherDatabase:
    """The wayside works with another survey of the line than the train."""


@fault("centre_silent", FaultPlace.WAYSIDE, Hazard.LOST_SERVICE, Hazard.DOOR_DANGER)
@dataclass(frozen=True, slots=True)
class CentreSilent:
    """The centre sends no more orders; authorities continue."""


@fault("doors_not_authorised", FaultPlace.WAYSIDE, Hazard.LOST_SERVICE)
@dataclass(frozen=True, slots=True)
class DoorsNotAuthorised:
    """The centre does not authorise doors to open."""

    side: DoorsOf = DoorsOf.BOTH


@fault("wrong_side_authorised", FaultPlace.WAYSIDE, Hazard.DOOR_DANGER)
@dataclass(frozen=True, slots=True)
class WrongSideAuthorised:
    """The centre authorises doors on the side without a platform, and not on the platform's
    side.
    """


@fault("platform_doors_unlocked", FaultPlace.WAYSIDE, Hazard.DOOR_DANGER, Hazard.LOST_SERVICE)
@dataclass(frozen=True, slots=True)
class PlatformDoorsUnlocked:
    """Platform doors are not proven locked; the doors themselves do not move."""


@fault("platform_door_obstacle", FaultPlace.WAYSIDE, Hazard.DOOR_DANGER, Hazard.LOST_SERVICE)
@dataclass(frozen=True, slots=True)
class PlatformDoorObstacle:
    """Platform doors meet an obstacle at every closing."""


@fault("obstacle", FaultPlace.ALARMS, Hazard.UNWANTED_MOTION, Hazard.LOST_SERVICE)
@dataclass(frozen=True, slots=True)
class Obstacle:
    """The deflector in front of the first axle has touched an obstacle."""


@fault("fire", FaultPlace.ALARMS, Hazard.LOST_SERVICE)
@dataclass(frozen=True, slots=True)
class Fire:
    """A smoke or fire detector of the train has tripped."""
