"""All signals of one instant as attributes; only the groups in use are filled."""

from collections.abc import Collection

from metro_hil.monitors.description import Spoken
from metro_hil.monitors.place import LinePlaces
from metro_hil.monitors.vocabulary import SIGNALS, Origin
from metro_hil.monitors.watch_motion import MotionWatch
from plant_emulator.truth import NO_SWITCH_M, Truth

S_PER_NS = 1.0e-9
BUS_NAMES = frozenset(signal.name for signal in SIGNALS if signal.origin is Origin.BUS)
LINE_NAMES = frozenset(signal.name for signal in SIGNALS if signal.origin is Origin.LINE)
WAYSIDE_NAMES = frozenset(
    (
        "authority_now_m",
        "authority_rear_m",
        "doors_authorised_left",
        "doors_authorised_right",
        "fire",
        "obstacle",
        "order_awake",
        "order_creep",
        "order_emergency",
        "order_hold",
        "order_releases",
        "order_restricted",
        "order_skip_next",
        "order_stop_next",
        "platform_doors_locked",
        "platform_doors_open",
        "temporary_limit_mps",
    )
)
"""Signals of the truth that few formulas use."""


class Signals:
    """Signals that user expressions read; `vocabulary.SIGNALS` explains each of them."""

    __slots__ = (
        "_foremost_m",
        "_motion",
        "_needs_bus",
        "_needs_line",
        "_needs_stopping",
        "_needs_wayside",
        "_place",
        "_position_ns",
        "_spoken",
        "accel_mps2",
        "adhesion_ratio",
        "alarm_raised",
        "ato_phase",
        "authority_end_m",
        "authority_now_m",
        "authority_rear_m",
        "brake_age_s",
        "brake_n",
        "ceiling_mps",
        "civil_limit_mps",
        "claimed_front_m",
        "claimed_speed_mps",
        "claimed_to_authority_m",
        "claimed_to_stop_m",
        "cycle_slips",
        "departure_inhibits",
        "desk_age_s",
        "direction",
        "door_bypass_pressed",
        "doors_age_s",
        "doors_authorised_left",
        "doors_authorised_right",
        "doors_locked",
        "doors_withheld",
        "drive_n",
        "emergency",
        "emergency_cause",
        "emergency_commanded",
        "emergency_limit_mps",
        "emergency_mps2",
        "enable_left",
        "enable_right",
        "fire",
        "force_commanded_n",
        "front_m",
        "gradient_permille",
        "holding",
        "holding_commanded",
        "jog_attempts",
        "left_cars",
        "left_open",
        "localised",
        "missing",
        "mode",
        "mode_age_s",
        "motion_age_s",
        "obstacle",
        "odometer_error_m",
        "open_left_commanded",
        "open_right_commanded",
        "order_awake",
        "order_creep",
        "order_emergency",
        "order_hold",
        "order_releases",
        "order_restricted",
        "order_skip_next",
        "order_stop_next",
        "platform_doors_locked",
        "platform_doors_open",
        "platform_left",
        "position_age_s",
        "position_error_m",
        "rear_m",
        "replicas_agree",
        "reset_pressed",
        "restricted_pressed",
        "right_cars",
        "right_open",
        "rollback_m",
        "service_decel_mps2",
        "slip_detected",
        "speed_mps",
        "standing",
        "status_age_s",
        "stop_error_m",
        "stopping_m",
        "supervision",
        "t_s",
        "tags_read",
        "target_age_s",
        "temporary_limit_mps",
        "to_authority_m",
        "to_stop_m",
        "traction_age_s",
        "traction_cut",
        "traction_permitted",
        "uncertainty_m",
        "unlocked_switch_m",
        "voltage_v",
        "work_us",
    )

    def __init__(
        self, spoken: Spoken, place: LinePlaces, motion: MotionWatch, names: Collection[str]
    ) -> None:
        """`names` are the signals in use; only their groups will be filled."""
        self._spoken, self._place, self._motion = spoken, place, motion
        wanted = frozenset(names)
        self._needs_bus = not wanted.isdisjoint(BUS_NAMES)
        self._needs_line = not wanted.isdisjoint(LINE_NAMES)
        self._needs_wayside = not wanted.isdisjoint(WAYSIDE_NAMES)
        self._needs_stopping = "stopping_m" in wanted
        self._foremost_m = -1.0e9
        self._position_ns = spoken.position_ns
        self._clear()
        self._fill_bus()

    def _clear(self) -> None:
        self.t_s = 0.0
        self.front_m = 0.0
        self.rear_m = 0.0
        self.speed_mps = 0.0
        self.accel_mps2 = 0.0
        self.drive_n = 0.0
        self.brake_n = 0.0
        self.gradient_permille = 0.0
        self.adhesion_ratio = 0.0
        self.emergency = 0.0
        self.emergency_mps2 = 0.0
        self.holding = 0.0
        self.doors_locked = 0.0
        self.left_open = 0.0
        self.right_open = 0.0
        self.left_cars = 0.0
        self.right_cars = 0.0
        self.voltage_v = 0.0
        self.odometer_error_m = 0.0
        self.tags_read = 0.0
        self.authority_end_m = 0.0
        self.to_stop_m = 0.0
        self.traction_cut = 0.0
        self.unlocked_switch_m = NO_SWITCH_M
        self.claimed_front_m = 0.0
        self.uncertainty_m = 0.0
        self.position_age_s = 0.0
        self.supervision = 0.0
        self.ato_phase = 0.0
        self.missing = 0.0
        self.localised = 0.0
        self.slip_detected = 0.0
        self.cycle_slips = 0.0
        self.work_us = 0.0
        self.status_age_s = 0.0
        self.claimed_speed_mps = 0.0
        self.ceiling_mps = 0.0
        self.emergency_limit_mps = 0.0
        self.motion_age_s = 0.0
        self.claimed_to_stop_m = 0.0
        self.claimed_to_authority_m = 0.0
        self.target_age_s = 0.0
        self.service_decel_mps2 = 0.0
        self.emergency_commanded = 0.0
        self.holding_commanded = 0.0
        self.brake_age_s = 0.0
        self.force_commanded_n = 0.0
        self._clear_rest()

    def _clear_rest(self) -> None:
        self.direction = 0.0
        self.traction_permitted = 0.0
        self.traction_age_s = 0.0
        self.enable_left = 0.0
        self.enable_right = 0.0
        self.open_left_commanded = 0.0
        self.open_right_commanded = 0.0
        self.doors_age_s = 0.0
        self.reset_pressed = 0.0
        self.desk_age_s = 0.0
        self.civil_limit_mps = 0.0
        self.to_authority_m = 0.0
        self.stop_error_m = 0.0
        self.platform_left = 0.0
        self.standing = 0.0
        self.stopping_m = 0.0
        self.rollback_m = 0.0
        self.position_error_m = 0.0
        self.mode_age_s = 0.0
        self.authority_now_m = 0.0
        self.authority_rear_m = 0.0
        self.temporary_limit_mps = 0.0
        self.fire = 0.0
        self.obstacle = 0.0
        self.platform_doors_locked = 0.0
        self.platform_doors_open = 0.0
        self.doors_authorised_left = 0.0
        self.doors_authorised_right = 0.0
        self.order_awake = 0.0
        self.order_hold = 0.0
        self.order_skip_next = 0.0
        self.order_stop_next = 0.0
        self.order_emergency = 0.0
        self.order_releases = 0.0
        self.order_creep = 0.0
        self.order_restricted = 0.0
        self.restricted_pressed = 0.0
        self.door_bypass_pressed = 0.0
        self.mode = 0.0
        self.emergency_cause = 0.0
        self.departure_inhibits = 0.0
        self.doors_withheld = 0.0
        self.jog_attempts = 0.0
        self.replicas_agree = 0.0
        self.alarm_raised = 0.0

    def fill(self, truth: Truth, now_ns: int) -> None:
        """Take one step of the plant."""
        self.t_s = truth.t_s
        self.front_m = truth.front_m
        self.rear_m = truth.rear_m
        self.speed_mps = truth.speed_mps
        self.accel_mps2 = truth.accel_mps2
        self.drive_n = truth.drive_n
        self.brake_n = truth.brake_n
        self.gradient_permille = truth.gradient_permille
        self.adhesion_ratio = truth.adhesion_ratio
        self.emergency = truth.emergency
        self.emergency_mps2 = truth.emergency_mps2
        self.holding = truth.holding
        self.doors_locked = truth.doors_locked
        self.left_open = truth.left_open
        self.right_open = truth.right_open
        self.left_cars = truth.left_cars
        self.right_cars = truth.right_cars
        self.voltage_v = truth.voltage_v
        self.odometer_error_m = truth.odometer_error_m
        self.tags_read = truth.tags_read
        self.authority_end_m = truth.authority_end_m
        self.to_stop_m = truth.to_stop_m
        self.civil_limit_mps = truth.civil_limit_mps
        self.traction_cut = truth.traction_cut
        self.unlocked_switch_m = truth.unlocked_switch_m
        if self._needs_wayside:
            self._fill_wayside(truth)
        if self._needs_bus:
            self._fill_ages(now_ns)
            if self._spoken.news:
                self._fill_bus()
        if self._needs_line:
            self._fill_line(truth, now_ns)

    def _fill_wayside(self, truth: Truth) -> None:
        self.authority_now_m = truth.authority_now_m
        self.authority_rear_m = truth.authority_rear_m
        self.temporary_limit_mps = truth.temporary_limit_mps
        self.fire = truth.fire
        self.obstacle = truth.obstacle
        self.platform_doors_locked = truth.platform_doors_locked
        self.platform_doors_open = truth.platform_doors_open
        self.doors_authorised_left = truth.doors_authorised_left
        self.doors_authorised_right = truth.doors_authorised_right
        self.order_awake = truth.order_awake
        self.order_hold = truth.order_hold
        self.order_skip_next = truth.order_skip_next
        self.order_stop_next = truth.order_stop_next
        self.order_emergency = truth.order_emergency
        self.order_releases = truth.order_releases
        self.order_creep = truth.order_creep
        self.order_restricted = truth.order_restricted

    def _fill_ages(self, now_ns: int) -> None:
        spoken = self._spoken
        self.position_age_s = (now_ns - spoken.position_ns) * S_PER_NS
        self.status_age_s = (now_ns - spoken.status_ns) * S_PER_NS
        self.motion_age_s = (now_ns - spoken.motion_ns) * S_PER_NS
        self.target_age_s = (now_ns - spoken.target_ns) * S_PER_NS
        self.brake_age_s = (now_ns - spoken.brake_ns) * S_PER_NS
        self.traction_age_s = (now_ns - spoken.traction_ns) * S_PER_NS
        self.doors_age_s = (now_ns - spoken.doors_ns) * S_PER_NS
        self.desk_age_s = (now_ns - spoken.desk_ns) * S_PER_NS
        self.mode_age_s = (now_ns - spoken.mode_ns) * S_PER_NS

    def _fill_bus(self) -> None:
        spoken = self._spoken
        self.claimed_front_m = spoken.claimed_front_m
        self.uncertainty_m = spoken.uncertainty_m
        self.supervision = spoken.supervision
        self.ato_phase = spoken.ato_phase
        self.missing = spoken.missing
        self.localised = spoken.localised
        self.slip_detected = spoken.slip_detected
        self.cycle_slips = spoken.cycle_slips
        self.work_us = spoken.work_us
        self.claimed_speed_mps = spoken.claimed_speed_mps
        self.ceiling_mps = spoken.ceiling_mps
        self.emergency_limit_mps = spoken.emergency_limit_mps
        self.claimed_to_stop_m = spoken.claimed_to_stop_m
        self.claimed_to_authority_m = spoken.claimed_to_authority_m
        self.service_decel_mps2 = spoken.service_decel_mps2
        self.emergency_commanded = spoken.emergency_commanded
        self.holding_commanded = spoken.holding_commanded
        self.force_commanded_n = spoken.force_commanded_n
        self.direction = spoken.direction
        self.traction_permitted = spoken.traction_permitted
        self.enable_left = spoken.enable_left
        self.enable_right = spoken.enable_right
        self.open_left_commanded = spoken.open_left_commanded
        self.open_right_commanded = spoken.open_right_commanded
        self.reset_pressed = spoken.reset_pressed
        self.restricted_pressed = spoken.restricted_pressed
        self.door_bypass_pressed = spoken.door_bypass_pressed
        self.mode = spoken.mode
        self.emergency_cause = spoken.emergency_cause
        self.departure_inhibits = spoken.departure_inhibits
        self.doors_withheld = spoken.doors_withheld
        self.jog_attempts = spoken.jog_attempts
        self.replicas_agree = spoken.replicas_agree
        self.alarm_raised = spoken.alarm_raised

    def _fill_line(self, truth: Truth, now_ns: int) -> None:
        place, spoken, front_m = self._place, self._spoken, truth.front_m
        self.to_authority_m = truth.authority_end_m - front_m
        self.stop_error_m = place.stop_error_m(front_m)
        self.platform_left = 1.0 if place.side(front_m) >= 0.0 else 0.0
        self.standing = 1.0 if truth.speed_mps == 0.0 else 0.0
        if front_m > self._foremost_m:
            self._foremost_m = front_m
        self.rollback_m = self._foremost_m - front_m
        if self._needs_stopping:
            moves = truth.speed_mps > 0.0
            self.stopping_m = self._motion.stopping_m(truth, now_ns) if moves else 0.0
        if spoken.position_ns != self._position_ns:
            self._position_ns = spoken.position_ns
            then_m = front_m - truth.speed_mps * ((now_ns - spoken.position_ns) * S_PER_NS)
            self.position_error_m = spoken.claimed_front_m - then_m
