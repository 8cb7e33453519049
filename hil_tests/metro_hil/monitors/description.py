"""The contents of the controller's frames and of its inputs on the bus, as plain numbers.

Only frames that pass every check of the wire contract count: CRC, alive counter, inverted twin.
"""

from collections.abc import Callable
from typing import Any, Final

from can_dbc.binding import Frame, binding_of, can_id
from can_dbc.brake import BrakeCommand, BrakeStatus
from can_dbc.cab import Desk
from can_dbc.codec import Decoder
from can_dbc.doors import DoorCars, DoorCommand
from can_dbc.nodes import Direction
from can_dbc.odometer import ColdMovement, Tacho
from can_dbc.rejection import Rejected
from can_dbc.traction import TractionCommand, TractionStatus
from can_dbc.trailer import opener
from can_dbc.vobc import (
    EventKind,
    VobcEvent,
    VobcMode,
    VobcMotion,
    VobcPosition,
    VobcStatus,
    VobcTarget,
)

DECODED: Final[tuple[type[Frame], ...]] = (
    BrakeCommand,
    TractionCommand,
    DoorCommand,
    DoorCars,
    VobcStatus,
    VobcMotion,
    VobcPosition,
    VobcTarget,
    VobcMode,
    VobcEvent,
    Desk,
    ColdMovement,
)
CONTROLLER_IDS: Final = Decoder(
    [
        BrakeCommand,
        TractionCommand,
        DoorCommand,
        DoorCars,
        VobcStatus,
        VobcMotion,
        VobcPosition,
        VobcTarget,
        VobcMode,
        VobcEvent,
    ]
).ids
"""Identifiers of the frames that the controller sends."""
STAMPED: Final[tuple[type[Frame], ...]] = (Tacho, BrakeStatus, TractionStatus)
"""Frames of which only the instant of the last valid one counts."""
NEVER_NS: Final = -(1 << 62)
UNMONITORED_M: Final = 1.0e6
"""Movement of a train that was not monitored: unknown, so larger than any limit."""
SIGNS: Final = {Direction.NEUTRAL: 0.0, Direction.FORWARD: 1.0, Direction.REVERSE: -1.0}


class Spoken:
    """Contents of the last valid frame of each kind; at first the most restrictive contents."""

    __slots__ = (
        "_decode",
        "_openers",
        "_sides_enabled",
        "_single_enabled",
        "_takers",
        "accepted_ns",
        "alarm_raised",
        "ato_phase",
        "brake_ns",
        "brake_status_ns",
        "ceiling_mps",
        "claimed_front_m",
        "claimed_speed_mps",
        "claimed_to_authority_m",
        "claimed_to_stop_m",
        "cold_moved_m",
        "cold_ns",
        "cycle_slips",
        "departure_inhibits",
        "desk_ns",
        "direction",
        "door_bypass_pressed",
        "door_bypassed",
        "doors_ns",
        "doors_withheld",
        "emergency_cause",
        "emergency_commanded",
        "emergency_limit_mps",
        "enable_left",
        "enable_right",
        "force_commanded_n",
        "holding_commanded",
        "jog_attempts",
        "localised",
        "missed_tags",
        "missing",
        "mode",
        "mode_ns",
        "motion_ns",
        "news",
        "open_left_commanded",
        "open_right_commanded",
        "position_ns",
        "refused_ns",
        "replicas_agree",
        "reset_pressed",
        "restricted_pressed",
        "service_decel_mps2",
        "slip_detected",
        "speed_reach_mps",
        "status_ns",
        "supervision",
        "tacho_ns",
        "target_ns",
        "traction_ns",
        "traction_permitted",
        "traction_status_ns",
        "uncertainty_m",
        "wanted_ids",
        "work_us",
    )

    def __init__(self, start_ns: int = 0) -> None:
        decoder = Decoder(DECODED)
        self._decode = decoder.decode
        self._openers: dict[int, tuple[int, Callable[[bytes], int]]] = {
            can_id(kind): (number, opener(binding_of(kind).message))
            for number, kind in enumerate(STAMPED)
        }
        self.wanted_ids: frozenset[int] = decoder.ids | frozenset(self._openers)
        """Identifiers of the frames that `frame` takes; all others change nothing."""
        self._takers: dict[type, Callable[[Any, int], None]] = {
            BrakeCommand: self._take_brake,
            TractionCommand: self._take_traction,
            DoorCommand: self._take_doors,
            DoorCars: self._take_door_cars,
            VobcStatus: self._take_status,
            VobcMotion: self._take_motion,
            VobcPosition: self._take_position,
            VobcTarget: self._take_target,
            VobcMode: self._take_mode,
            VobcEvent: self._take_event,
            Desk: self._take_desk,
            ColdMovement: self._take_cold,
        }
        self.news = False
        """Whether a frame other than the stamped ones has arrived since the reader reset this
        flag."""
        self._claim_nothing()
        self._command_nothing()
        # A frame that never arrived is as old as the run.
        self.brake_ns = self.traction_ns = self.doors_ns = start_ns
        self.status_ns = self.motion_ns = self.position_ns = self.target_ns = start_ns
        self.mode_ns = start_ns
        # Events that have not happened yet.
        self.accepted_ns = self.refused_ns = self.cold_ns = NEVER_NS
        self.cold_moved_m = 0.0
        self.missed_tags = 0.0
        """Tags missed in a row, as the controller reports them."""
        self.desk_ns = self.tacho_ns = self.brake_status_ns = self.traction_status_ns = start_ns

    def _claim_nothing(self) -> None:
        self.claimed_front_m = 0.0
        self.uncertainty_m = 655.35
        self.supervision = 0.0
        self.ato_phase = 0.0
        self.missing = 255.0
        self.localised = 0.0
        self.slip_detected = 0.0
        self.cycle_slips = 0.0
        self.work_us = 0.0
        self.claimed_speed_mps = 0.0
        self.ceiling_mps = 0.0
        self.emergency_limit_mps = 0.0
        self.claimed_to_stop_m = 0.0
        self.claimed_to_authority_m = 0.0
        self.mode = 0.0
        self.emergency_cause = 0.0
        self.departure_inhibits = 0.0
        self.doors_withheld = 0.0
        self.jog_attempts = 0.0
        self.replicas_agree = 1.0
        self.alarm_raised = self.speed_reach_mps = 0.0

    def _command_nothing(self) -> None:
        self.service_decel_mps2 = 0.0
        self.emergency_commanded = 1.0
        self.holding_commanded = 1.0
        self.force_commanded_n = 0.0
        self.direction = 0.0
        self.traction_permitted = 0.0
        self.enable_left = 0.0
        self.enable_right = 0.0
        self._sides_enabled = self._single_enabled = (False, False)
        self.open_left_commanded = 0.0
        self.open_right_commanded = 0.0
        self.reset_pressed = 0.0
        self.restricted_pressed = 0.0
        self.door_bypass_pressed = self.door_bypassed = 0.0

    def frame(self, stamp_ns: int, can_id: int, data: bytes) -> None:
        """Take one frame at the end of its transmission; its identifier is one of `wanted_ids`."""
        stamped = self._openers.get(can_id)
        if stamped is not None:
            number, opened = stamped
            if opened(data) < 0:
                return
            if number == 0:
                self.tacho_ns = stamp_ns
            elif number == 1:
                self.brake_status_ns = stamp_ns
            else:
                self.traction_status_ns = stamp_ns
            return
        heard = self._decode(can_id, data, stamp_ns)
        if heard is None or isinstance(heard, Rejected):
            return
        self._takers[heard.__class__](heard, stamp_ns)
        self.news = True

    def _take_brake(self, said: BrakeCommand, stamp_ns: int) -> None:
        self.brake_ns = stamp_ns
        self.service_decel_mps2 = said.service_decel_mps2
        self.emergency_commanded = 0.0 if said.emergency_released else 1.0
        self.holding_commanded = 0.0 if said.holding_released else 1.0

    def _take_traction(self, said: TractionCommand, stamp_ns: int) -> None:
        self.traction_ns = stamp_ns
        self.force_commanded_n = said.force_n
        self.direction = SIGNS[said.direction]
        self.traction_permitted = 1.0 if said.traction_permitted else 0.0

    def _take_doors(self, said: DoorCommand, stamp_ns: int) -> None:
        self.doors_ns = stamp_ns
        self._sides_enabled = (said.enable_left, said.enable_right)
        self._enable()
        self.open_left_commanded = 1.0 if said.open_left else 0.0
        self.open_right_commanded = 1.0 if said.open_right else 0.0

    def _take_door_cars(self, said: DoorCars, stamp_ns: int) -> None:
        self._single_enabled = (said.left_cars != 0, said.right_cars != 0)
        self._enable()

    def _enable(self) -> None:
        """Either frame enables a side, whole or in single cars."""
        (left, right), (left_cars, right_cars) = self._sides_enabled, self._single_enabled
        self.enable_left = 1.0 if left or left_cars else 0.0
        self.enable_right = 1.0 if right or right_cars else 0.0

    def _take_status(self, said: VobcStatus, stamp_ns: int) -> None:
        self.status_ns = stamp_ns
        self.supervision = float(said.supervision.value)
        self.ato_phase = float(said.ato_phase.value)
        self.missing = float(said.missing.value)
        self.localised = 1.0 if said.localised else 0.0
        self.slip_detected = 1.0 if said.slip_detected else 0.0
        self.cycle_slips = float(said.cycle_slips)
        self.work_us = said.work_us

    def _take_motion(self, said: VobcMotion, stamp_ns: int) -> None:
        self.motion_ns = stamp_ns
        self.claimed_speed_mps = said.speed_mps
        self.ceiling_mps = said.ceiling_mps
        self.emergency_limit_mps = said.emergency_mps

    def _take_position(self, said: VobcPosition, stamp_ns: int) -> None:
        self.position_ns = stamp_ns
        self.claimed_front_m = said.front_m
        self.uncertainty_m = said.uncertainty_m

    def _take_target(self, said: VobcTarget, stamp_ns: int) -> None:
        self.target_ns = stamp_ns
        self.claimed_to_stop_m = said.distance_to_stop_m
        self.claimed_to_authority_m = said.distance_to_authority_m

    def _take_desk(self, said: Desk, stamp_ns: int) -> None:
        self.desk_ns = stamp_ns
        self.reset_pressed = 1.0 if said.reset_requested else 0.0
        self.restricted_pressed = 1.0 if said.restricted_requested else 0.0
        self.door_bypass_pressed = 1.0 if said.door_bypass_requested else 0.0

    def _take_mode(self, said: VobcMode, stamp_ns: int) -> None:
        self.mode_ns = stamp_ns
        self.mode = float(said.mode.value)
        self.emergency_cause = float(said.cause.value)
        self.departure_inhibits = float(said.departure_inhibits.value)
        self.doors_withheld = float(said.doors_withheld.value)
        self.jog_attempts = float(said.jog_attempts)
        self.replicas_agree = 1.0 if said.replicas_agree else 0.0
        self.alarm_raised = 1.0 if said.alarm_raised else 0.0
        self.speed_reach_mps = said.speed_reach_mps

    def _take_event(self, said: VobcEvent, stamp_ns: int) -> None:
        if said.event is EventKind.TAG_ACCEPTED:
            self.accepted_ns = stamp_ns
            self.missed_tags = 0.0
        elif said.event is EventKind.TAG_REJECTED:
            self.refused_ns = stamp_ns
        elif said.event is EventKind.TAG_MISSED:
            self.missed_tags += 1.0
        elif said.event is EventKind.DOOR_BYPASS:
            self.door_bypassed = 1.0 if said.cause else 0.0

    def _take_cold(self, said: ColdMovement, stamp_ns: int) -> None:
        """Take only the first one: it reports the time before the controller started."""
        if self.cold_ns == NEVER_NS:
            self.cold_ns = stamp_ns
            self.cold_moved_m = said.moved_m if said.monitored else UNMONITORED_M
