"""All watched invariants of one run; each step updates only those that can change."""

from can_dbc.binding import timeout_s
from can_dbc.brake import BrakeCommand
from can_dbc.doors import DoorCommand
from can_dbc.traction import TractionCommand
from metro_hil.monitors.catalogue import WATCHED
from metro_hil.monitors.context import Context
from metro_hil.monitors.description import Spoken
from metro_hil.monitors.gauge import Alarm, Gauge
from metro_hil.monitors.place import LinePlaces
from metro_hil.monitors.watch_authority import AuthorityWatch
from metro_hil.monitors.watch_brake import DepartureWatch, EmergencyWatch, SilenceWatch
from metro_hil.monitors.watch_claims import ClaimWatch, DemandWatch
from metro_hil.monitors.watch_doors import DoorWatch
from metro_hil.monitors.watch_modes import ModeWatch
from metro_hil.monitors.watch_motion import MotionWatch
from metro_hil.monitors.watch_restrictions import RestrictionWatch
from metro_hil.monitors.watch_switches import SwitchWatch
from metro_hil.monitors.watch_zones import ZoneWatch
from plant_emulator.truth import NO_SWITCH_M, Truth
from zenoh_config.codec import unpack
from zenoh_config.messages import MovementAuthority, TrainOrders


class Invariants:
    """Updates only what can have changed, so a standing, locked train costs very little."""

    __slots__ = (
        "_authority",
        "_claims",
        "_demand",
        "_departure",
        "_doors",
        "_doors_busy",
        "_emergency",
        "_heard",
        "_modes",
        "_moving",
        "_restrictions",
        "_silence",
        "_spoken",
        "_switched",
        "_switches",
        "_wanted",
        "_zones",
        "alarm",
        "gauges",
        "motion",
    )

    def __init__(self, context: Context, spoken: Spoken, heard: Spoken, place: LinePlaces) -> None:
        """Create all watches.

        Args:
            spoken: contents of the frames that the controller sends.
            heard: contents of those that reach the bus, where the units receive them.
        """
        self.alarm = Alarm()
        self.gauges = {each.name: Gauge(each.name, self.alarm) for each in WATCHED}
        self._spoken, self._heard = spoken, heard
        gauge = self.gauges
        self.motion = MotionWatch(
            context,
            place,
            stopping=gauge["inv-01-stopping-distance"],
            authority_end=gauge["inv-02-authority-end"],
            civil_limit=gauge["inv-04-civil-limit"],
            rollback=gauge["inv-08-rollback"],
        )
        self._departure = DepartureWatch(
            place,
            locked=gauge["inv-33-departure-locked"],
            platform=gauge["inv-33-platform-doors"],
        )
        self._modes = ModeWatch(
            context,
            place,
            distance=gauge["inv-10-jog-distance"],
            jog_speed=gauge["inv-10-jog-speed"],
            attempts=gauge["inv-10-jog-attempts"],
            covered=gauge["inv-10-jog-covered"],
            up=gauge["inv-11-mode-up"],
            restricted=gauge["inv-12-restricted-speed"],
            wake_up=gauge["inv-18-wake-up"],
        )
        self._authority = AuthorityWatch(context, aged=gauge["inv-24-authority-age"])
        self._switches = SwitchWatch(
            context,
            locked=gauge["inv-23-switch-locked"],
            brakes=gauge["inv-23-switch-brake"],
        )
        self._restrictions = RestrictionWatch(context, place, kept=gauge["inv-04-restriction"])
        self._zones = ZoneWatch(
            context,
            traction_off=gauge["inv-41-neutral-section"],
            entered=gauge["inv-42-no-stop-zone"],
            stands=gauge["inv-43-evacuation-stop"],
        )
        self._emergency = EmergencyWatch(
            context,
            held=gauge["inv-05-emergency-held"],
            traction_off=gauge["inv-06-traction-off"],
            ignored=gauge["inv-07-demand-ignored"],
        )
        self._silence = SilenceWatch(
            context,
            brake_timeout_s=timeout_s(BrakeCommand),
            traction_timeout_s=timeout_s(TractionCommand),
            doors_timeout_s=timeout_s(DoorCommand),
            brake=gauge["inv-34-brake-silence"],
            traction=gauge["inv-34-traction-silence"],
            doors=gauge["inv-34-door-silence"],
            inputs=gauge["inv-34-input-silence"],
        )
        self._claims, self._demand = self._listeners(context)
        self._doors = self._door_watch(context, place)
        self._moving = self._wanted = self._doors_busy = self._switched = False

    def _listeners(self, context: Context) -> tuple[ClaimWatch, DemandWatch]:
        gauge = self.gauges
        claims = ClaimWatch(
            context,
            curve=gauge["inv-03-emergency-at-curve"],
            interval=gauge["inv-13-position-interval"],
            narrowed=gauge["inv-14-narrowed-by-tag"],
            width=gauge["inv-16-localisation-limit"],
            overrun=gauge["inv-36-overrun"],
            refused=gauge["inv-15-refused-tag"],
            missed=gauge["inv-16-missed-tags"],
        )
        demand = DemandWatch(
            context,
            direction=gauge["inv-09-direction"],
            accel=gauge["inv-39-accel"],
            jerk=gauge["inv-39-jerk"],
        )
        return claims, demand

    def _door_watch(self, context: Context, place: LinePlaces) -> DoorWatch:
        gauge = self.gauges
        return DoorWatch(
            context,
            place,
            enabled_speed=gauge["inv-17-zero-speed"],
            speed=gauge["inv-30-door-speed"],
            place=gauge["inv-30-door-place"],
            platform=gauge["inv-30-door-platform"],
            side=gauge["inv-30-door-side"],
            enable=gauge["inv-31-door-enable"],
            traction=gauge["inv-32-door-traction"],
            holding=gauge["inv-32-door-holding"],
        )

    def radio(self, payload: bytes) -> None:
        """Take one radio message, as the controller receives it."""
        message = unpack(payload)
        if isinstance(message, MovementAuthority):
            self.authority(message)
        elif isinstance(message, TrainOrders):
            self._restrictions.heard(message)

    def authority(self, authority: MovementAuthority) -> None:
        """Take an authority on which the controller may act."""
        self._authority.heard(authority)
        if self._switched:
            self._switches.heard(authority)

    def sample(self, truth: Truth, now_ns: int) -> None:
        """Take one step of the plant; the caller resets `news` of the frames."""
        spoken = self._spoken
        if self._switched or truth.unlocked_switch_m < NO_SWITCH_M:
            self._switched = True
            self._switches.sample(truth, now_ns, spoken)
        wanted = truth.emergency > 0.0
        if wanted is not self._wanted:
            self._wanted = wanted
            self.motion.emergency(now_ns, wanted)
            if not wanted:
                self._emergency.ended(truth, now_ns)
        if truth.speed_mps != 0.0:
            self._moving = True
            self.motion.sample(truth, now_ns, spoken.mode)
            self._departure.sample(truth, now_ns, spoken)
            self._modes.sample(truth, now_ns, spoken)
            self._zones.sample(truth, now_ns, spoken)
            self._authority.sample(truth, now_ns, spoken)
            if self._restrictions.busy:
                self._restrictions.sample(
                    truth, now_ns, guaranteed=self.motion.guaranteed(truth, now_ns)
                )
            if not wanted:
                self._emergency.without(truth, now_ns)
        elif self._moving:
            self._moving = False
            self._zones.stopped(truth, now_ns, spoken)
            self._departure.sample(truth, now_ns, spoken)
            self._modes.sample(truth, now_ns, spoken)
        if truth.tags_read != self._claims.tags:
            self._claims.tag_read(truth.tags_read, now_ns)
        if spoken.news:
            self._emergency.news(truth, now_ns, spoken)
            self._claims.news(truth, now_ns, spoken)
            self._demand.news(truth, now_ns, spoken)
            self._modes.news(truth, now_ns, spoken)
            self._zones.news(truth, now_ns, spoken)
        if wanted:
            self._emergency.sample(truth, now_ns, spoken)
        else:
            self._silence.released(truth, now_ns, self._heard)
        enabled = spoken.enable_left > 0.0 or spoken.enable_right > 0.0
        if enabled:
            self._doors.enabled(truth, now_ns, spoken)
        busy = truth.doors_locked == 0.0
        if busy or self._doors_busy:
            self._doors_busy = busy
            self._doors.sample(truth, now_ns, spoken)
            if truth.left_open or truth.right_open:
                # No command restores a lost lock on a closed door.
                self._silence.open(now_ns, self._heard)
