"""Demands of protection at platforms: doors, departure, alarms, missed stops."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from can_dbc.doors import ALL_CARS
from can_dbc.vobc import Cause, Inhibit, Withheld
from firmware_py.trackdb import LineMap, Station
from vobc.atp import alarms
from vobc.atp.alarms import AlarmGuardInputs, AlarmResponse
from vobc.atp.config import AtpConfig
from vobc.atp.departure import NOT_AGAINST_JOG, DepartureTerms, inhibits
from vobc.atp.doors import (
    DoorEnable,
    DoorTerms,
    car_spans,
    cars_beside,
    enabled_doors,
    withheld,
)
from vobc.atp.inputs import AUTHORITY, BRAKE, ODOMETER, TRACTION
from vobc.atp.jog import MOVED_M, JogFacts, JogGuard, JogVerdict
from vobc.atp.place import UNKNOWN, PlatformPlace, PlatformWhereabouts, place_of
from vobc.atp.received import StationInputs, listen
from vobc.vocabulary import CycleInput, Interval, Motion

_AGAINST_JOG: Final = ~int(NOT_AGAINST_JOG)
NO_JOG: Final = JogVerdict()


@dataclass(frozen=True, slots=True)
class StationVerdict:
    """Requirements of stations and passengers on the movement in one cycle."""

    doors: DoorEnable
    door_cars: int
    """Cars to which enabled doors are limited, as a result of `cars_beside`."""
    withheld: Withheld
    """Reasons why no side is enabled."""
    inhibits: Inhibit
    """Reasons why the train must not depart."""
    emergency: Cause
    """Cause of a required emergency brake."""
    stop_now: bool
    stop_next: bool
    keep_doors_open: bool
    jog_back_m: float
    """Distance that a jog may go back. 0: not permitted."""
    jog_permitted: bool
    jog_to_tag: bool
    """A permitted jog helps by reading a tag ahead."""
    alarm_raised: bool
    door_bypass: bool
    jog_attempts: int
    """Jogs made at this stop."""
    self_release: bool
    """The emergency brake of an overshoot may release itself at standstill, because a jog corrects
    it."""


class _Answers(NamedTuple):
    """Reactions to the faults on board, the most important one first."""

    lock: AlarmResponse
    passenger_alarm: AlarmResponse
    fire: AlarmResponse


@dataclass(frozen=True, slots=True)
class _Found:
    """All findings of a cycle that form the verdict."""

    heard: StationInputs
    place: PlatformPlace
    cars: int
    """Cars beside the platform, as a result of `cars_beside`. All, except at a stopping point."""
    standing: bool
    answers: _Answers
    alarm: bool
    """Passenger alarm or fire. It lasts until it has ended and the train has stood at a platform.
    """
    inhibiting: Inhibit
    reasons: Withheld
    jog: JogVerdict
    jog_free: bool
    """Only the rules of the stop itself restrict a jog."""


class StationGuard:
    """State at platforms: where the train stood, alarms, attempts."""

    def __init__(
        self,
        config: AtpConfig,
        line: LineMap,
        *,
        train_length_m: float,
        car_lengths_m: Sequence[float] = (),
    ) -> None:
        """`car_lengths_m`: of a train whose door unit opens single cars, from the front."""
        self._config = config
        self._line = line
        self._length_m = train_length_m
        self._spans = car_spans(car_lengths_m)
        self._stood_at: Station | None = None
        """The platform at which the train last stood."""
        self._stood_m: float | None = None
        """Distance by pulses where it last stood. None: it has not stood yet."""
        self._stood_front_m: Interval | None = None
        """Interval of its front there."""
        self._slipped = False
        """Wheels have slipped or slid since then."""
        self._passenger_alarm = False
        self._fire = False
        self._jogs = JogGuard()

    def step(
        self,
        inputs: CycleInput,
        motion: Motion,
        *,
        gone: int,
        emergency: bool,
        may_move: bool,
        stopping_at_m: float | None = None,
    ) -> StationVerdict:
        """Decide once per cycle.

        Args:
            gone: silent inputs, as flags of `Missing`.
            emergency: the emergency brake was latched when the cycle began.
            may_move: supervision permits movement (NOMINAL, WARNING or SERVICE).
            stopping_at_m: the stopping point of operation in the cycle before. None: no stop. Only
                jogs and overshoots depend on it, so a wrong one costs a stop, never safety.
        """
        heard = listen(inputs, self._config, gone)
        place = self._place(motion)
        cars = self._cars_beside(place, motion)
        moved_m = self._moved_m(motion, place)
        moving = not motion.standing and abs(moved_m) > MOVED_M
        answers = self._answers(heard, place, motion, moving=moving)
        inhibiting = Inhibit.NONE
        if not moving:
            authority_ahead = _authority_ahead(inputs, motion, gone)
            inhibiting = inhibits(
                _departure_terms(
                    heard,
                    place,
                    answers,
                    authority_ahead=authority_ahead,
                    emergency=emergency,
                )
            )
        jog = self._jog(inputs, motion, gone, moved_m, stopping_at_m)
        found = _Found(
            heard=heard,
            place=place,
            cars=cars,
            standing=motion.standing,
            answers=answers,
            alarm=self._passenger_alarm or self._fire,
            inhibiting=inhibiting,
            reasons=withheld(
                _door_terms(inputs, motion, gone, place, cars, heard, emergency=emergency)
            ),
            jog=jog,
            jog_free=may_move and not emergency and not int(inhibiting) & _AGAINST_JOG,
        )
        return _verdict(found)

    def _place(self, motion: Motion) -> PlatformPlace:
        if not motion.localised:
            return UNKNOWN
        return place_of(
            self._line.stations,
            motion.front_m,
            train_length_m=self._length_m,
            window_m=self._config.door_window_m,
        )

    def _cars_beside(self, place: PlatformPlace, motion: Motion) -> int:
        """Away from a stopping point no door is enabled, and the platform is not compared."""
        if place.station is None or place.where is not PlatformWhereabouts.ALIGNED:
            return ALL_CARS
        return cars_beside(
            place.station, motion.front_m, train_length_m=self._length_m, spans=self._spans
        )

    def _moved_m(self, motion: Motion, place: PlatformPlace) -> float:
        """Distance since the train last stood. It is infinite for a train that has not stood
        yet.
        """
        if _rests(motion):
            self._stood_m, self._stood_at = motion.travel_m, place.station
            self._stood_front_m, self._slipped = motion.front_m, False
        self._slipped = self._slipped or motion.slip
        return math.inf if self._stood_m is None else motion.travel_m - self._stood_m

    def _most_moved_m(self, motion: Motion, moved_m: float) -> float:
        """Upper bound of the distance. After slip only the position bounds are reliable."""
        stood_m, front_m = self._stood_front_m, motion.front_m
        if stood_m is None or not self._slipped:
            return abs(moved_m)
        return max(abs(moved_m), front_m.high - stood_m.low, stood_m.high - front_m.low)

    def _answers(
        self, heard: StationInputs, place: PlatformPlace, motion: Motion, *, moving: bool
    ) -> _Answers:
        """Update alarms and unlocked doors.

        An alarm lasts until it has ended and the train has stood at a platform. A lost door lock
        lasts until the lock is back.
        """
        over = _rests(motion) and place.station is not None
        self._passenger_alarm = heard.passenger_alarm or (self._passenger_alarm and not over)
        self._fire = heard.fire or (self._fire and not over)
        stood_here = place.station is not None and place.station is self._stood_at
        leaving = moving and (stood_here or place.where is PlatformWhereabouts.PAST)
        situation = AlarmGuardInputs(place.where, leaving)
        unlocked = moving and not heard.doors_locked and not heard.door_bypass
        return _Answers(
            alarms.DOOR_UNLOCKED[situation] if unlocked else alarms.NOTHING,
            alarms.PASSENGER_ALARM[situation] if self._passenger_alarm else alarms.NOTHING,
            alarms.FIRE[situation] if self._fire else alarms.NOTHING,
        )

    def _jog(
        self,
        inputs: CycleInput,
        motion: Motion,
        gone: int,
        moved_m: float,
        stop_m: float | None,
    ) -> JogVerdict:
        if not self._jogs.heads_for(stop_m if motion.localised else None):
            return NO_JOG
        assert stop_m is not None
        front_m, authority = motion.front_m, None if gone & AUTHORITY else inputs.authority
        back_room_m = -math.inf
        if authority is not None and authority.rear_m is not None:
            back_room_m = front_m.low - self._length_m - authority.rear_m
        facts = JogFacts(
            limits=self._config,
            low_m=front_m.low - stop_m,
            best_m=front_m.best - stop_m,
            high_m=front_m.high - stop_m,
            standstill=_rests(motion),
            moved_m=moved_m,
            most_moved_m=self._most_moved_m(motion, moved_m),
            speed_high_mps=max(motion.speed_mps.high, -motion.speed_mps.low),
            back_room_m=back_room_m,
            attempts=self._jogs.attempts,
            tag_m=motion.next_tag_m - stop_m,
        )
        return self._jogs.step(facts, standing=motion.standing)


def _verdict(found: _Found) -> StationVerdict:
    heard, answers, jog = found.heard, found.answers, found.jog
    side = None if found.place.station is None else found.place.station.side
    return StationVerdict(
        doors=enabled_doors(found.reasons, side, DoorEnable(heard.doors_left, heard.doors_right)),
        door_cars=found.cars,
        withheld=found.reasons if found.standing and side is not None else Withheld.NONE,
        inhibits=found.inhibiting,
        emergency=_first(
            Cause.OBSTACLE if heard.obstacle else Cause.NONE,
            *(answer.emergency for answer in answers),
            jog.emergency,
        ),
        stop_now=jog.used_up or any(answer.stop_now for answer in answers),
        stop_next=heard.stop_next
        or any(
            # A train that already stands where it must stay has made that stop.
            answer.stop_next and not (answer.stay and found.standing)
            for answer in answers
        ),
        keep_doors_open=any(answer.stay for answer in answers),
        jog_back_m=jog.back_m if found.jog_free else 0.0,
        jog_permitted=jog.permitted and found.jog_free,
        jog_to_tag=jog.to_tag,
        alarm_raised=heard.obstacle or found.alarm or jog.used_up or jog.out_of_reach,
        door_bypass=heard.door_bypass and not (heard.doors_locked and heard.platform_doors_locked),
        jog_attempts=jog.attempts,
        self_release=jog.self_release,
    )


def _first(*causes: Cause) -> Cause:
    return next((cause for cause in causes if cause), Cause.NONE)


def _rests(motion: Motion) -> bool:
    """Standstill is proven and there is no pulse.

    The speed of a creeping train may seem zero for long.
    """
    return motion.standstill and motion.standing


def _authority_ahead(inputs: CycleInput, motion: Motion, gone: int) -> bool:
    authority = None if gone & AUTHORITY else inputs.authority
    return authority is not None and authority.end_m > motion.front_m.high


def _departure_terms(
    heard: StationInputs,
    place: PlatformPlace,
    answers: _Answers,
    *,
    authority_ahead: bool,
    emergency: bool,
) -> DepartureTerms:
    # An order to stay is for a platform. A train short of its stop has not reached it yet.
    to_stay = place.where not in (PlatformWhereabouts.BETWEEN, PlatformWhereabouts.ARRIVING)
    doors_elsewhere = place.where is PlatformWhereabouts.BETWEEN and not heard.centre
    return DepartureTerms(
        doors_locked=heard.doors_locked or heard.door_bypass,
        platform_doors_locked=(heard.platform_doors_locked or heard.door_bypass or doors_elsewhere),
        authority_ahead=authority_ahead,
        not_held=not (heard.hold and to_stay),
        no_passenger_alarm=not answers.passenger_alarm.stay,
        no_fire=not answers.fire.stay,
        no_obstacle=heard.no_obstacle,
        awake=heard.awake or not heard.centre,
        no_emergency=not emergency and not heard.centre_emergency,
        centre_heard=heard.centre,
    )


def _door_terms(
    inputs: CycleInput,
    motion: Motion,
    gone: int,
    place: PlatformPlace,
    cars: int,
    heard: StationInputs,
    *,
    emergency: bool,
) -> DoorTerms:
    station, brake, traction = place.station, inputs.brake, inputs.traction
    side = None if station is None else station.side
    return DoorTerms(
        standstill=motion.standstill and not gone & ODOMETER,
        localised=motion.localised,
        near_platform=station is not None,
        aligned=place.where is PlatformWhereabouts.ALIGNED,
        beside_platform=cars != 0,
        holding_applied=brake is not None and brake.holding_applied and not gone & BRAKE,
        traction_cut=traction is not None and traction.traction_cut and not gone & TRACTION,
        no_emergency=not emergency,
        authorised=side is not None
        and ((side.left and heard.doors_left) or (side.right and heard.doors_right)),
        centre_heard=heard.centre,
    )
