"""True state of the train at one instant, for monitors, conditions of faults and the feed."""

import struct
from bisect import bisect_right
from collections.abc import Mapping
from typing import Final

from can_dbc.binding import Frame
from can_dbc.doors import DoorState
from can_dbc.vobc import AtoPhase, OperatingMode, Supervision, VobcMode, VobcStatus
from plant_emulator.wayside.railway import Railway
from plant_emulator.world import World
from zenoh_config.messages import SpeedRestriction

NS_PER_S: Final = 1_000_000_000
NO_SWITCH_M: Final = 1.0e6
PASSED_M: Final = 20.0
"""Distance behind a stopping point beyond which the next stop becomes the target, m."""
SIGNALS: Final[tuple[str, ...]] = (
    "accel_mps2",
    "adhesion_ratio",
    "authority_end_m",
    "authority_now_m",
    "authority_rear_m",
    "brake_n",
    "civil_limit_mps",
    "doors_authorised_left",
    "doors_authorised_right",
    "doors_locked",
    "drive_n",
    "emergency",
    "emergency_mps2",
    "fire",
    "front_m",
    "gradient_permille",
    "holding",
    "left_cars",
    "left_open",
    "obstacle",
    "odometer_error_m",
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
    "rear_m",
    "right_cars",
    "right_open",
    "speed_mps",
    "t_s",
    "tags_read",
    "temporary_limit_mps",
    "to_stop_m",
    "traction_cut",
    "unlocked_switch_m",
    "voltage_v",
)
"""Signals that conditions and monitors can use, in the order of a packed sample."""
REPORTED: Final[Mapping[str, Mapping[str, float]]] = {
    name: {each.name.lower(): float(each) for each in kind}
    for name, kind in (
        ("supervision", Supervision),
        ("ato_phase", AtoPhase),
        ("mode", OperatingMode),
    )
}
"""Signals that the controller reports on the bus, with the names of their values. Only conditions
of faults use them: monitors read the bus themselves."""
REPORTS: Final[tuple[type[Frame], ...]] = (VobcStatus, VobcMode)
"""Frames of the controller that carry them."""


class Truth:
    """One sample of the true state.

    `read` refills it; its attributes are the signals of conditions and monitors.
    """

    __slots__ = (
        "_edges_m",
        "_high_m",
        "_length_m",
        "_low_gradient_permille",
        "_low_m",
        "_restrictions",
        "_slope_permille_per_m",
        "_stop_m",
        "_world",
        *SIGNALS,
        *REPORTED,
    )

    def __init__(self) -> None:
        self.t_s = 0.0
        """Time since the start of the run, s."""
        self.front_m = 0.0
        """Chainage of the front coupler, m."""
        self.rear_m = 0.0
        self.speed_mps = 0.0
        """Speed of the whole train, signed; exactly zero at standstill."""
        self.accel_mps2 = 0.0
        self.drive_n = 0.0
        """Tractive effort at the rail, signed, N."""
        self.brake_n = 0.0
        """Brake force at the rail, never negative, N."""
        self.gradient_permille = 0.0
        """Mean gradient under the train."""
        self.adhesion_ratio = 0.0
        self.emergency = 0.0
        """1 while the brake unit demands the emergency brake."""
        self.emergency_mps2 = 0.0
        """Deceleration that the emergency brake gives at present."""
        self.holding = 0.0
        """1 while the holding brake exerts any force."""
        self.civil_limit_mps = 0.0
        """Lowest civil limit under the train."""
        self.doors_locked = 1.0
        """1 while the train line through all door locks is closed."""
        self.left_open = 0.0
        """1 from unlocking to locking of the left doors."""
        self.right_open = 0.0
        self.left_cars = 0.0
        """Cars whose left doors are not locked: the sum of 1 for the front car, 2 for the second, 4
        for the third, and so on."""
        self.right_cars = 0.0
        self.voltage_v = 0.0
        self.odometer_error_m = 0.0
        self.tags_read = 0.0
        self.authority_end_m = 0.0
        """Farthest end of all authorities sent so far; before the first one, the train's front at
        the start."""
        self.authority_now_m = 0.0
        """End of the newest authority; before the first one, the train's front at the start."""
        self.authority_rear_m = 0.0
        """Rear limit of the newest authority. Without such a limit it is the place that the rear
        has surely passed."""
        self.temporary_limit_mps = 0.0
        """Lowest temporary speed restriction under the train; without a restriction, the civil
        limit."""
        self.fire = 0.0
        """1 while any fire detector of the train has tripped."""
        self.obstacle = 0.0
        """1 while an obstacle touches the deflector."""
        self.to_stop_m = 0.0
        """Distance to the next stopping point of the line's map, m. Behind the last stopping point
        it is negative."""
        self.traction_cut = 1.0
        """1 while the traction contactor is open."""
        self.unlocked_switch_m = NO_SWITCH_M
        """Chainage of the first switch ahead or below the train that is not locked in the end
        position that its path needs; 1000 km without one."""
        self.supervision = self.ato_phase = self.mode = 0.0
        self._world: World | None = None
        # Values that depend on the place alone are cached for a range [low, high) of the front.
        # Within it the mean gradient under the train is linear in the place.
        self._edges_m: list[float] = []
        self._restrictions: tuple[SpeedRestriction, ...] = ()
        self._nothing_ordered()
        self._low_m = self._high_m = self._length_m = 0.0
        self._stop_m = 0.0
        self._low_gradient_permille = self._slope_permille_per_m = 0.0

    def _nothing_ordered(self) -> None:
        """Set the order signals of a train at rest, which hold until the control centre sends its
        first orders.
        """
        self.order_awake = 1.0
        self.order_creep = 0.0
        self.order_emergency = 0.0
        self.order_hold = 0.0
        self.order_releases = 0.0
        """Number of emergency resets by the control centre so far."""
        self.order_restricted = 0.0
        self.order_skip_next = 0.0
        self.order_stop_next = 0.0
        self.doors_authorised_left = 0.0
        self.doors_authorised_right = 0.0
        self.platform_doors_locked = 1.0
        """1 while all platform doors are closed and proven locked, and where there are no platform
        doors."""
        self.platform_doors_open = 0.0
        """1 while any platform door is not closed."""

    def read(self, world: World, start_ns: int, authority_end_m: float) -> None:
        consist, brake, doors = world.consist, world.brake, world.doors
        front_m = consist.car_fronts_m[0]
        if (
            world is not self._world
            or world.length_m != self._length_m
            or not self._low_m <= front_m < self._high_m
        ):
            self._enter(world, front_m)
        self.t_s = (world.now_ns - start_ns) / NS_PER_S
        self.front_m = front_m
        self.rear_m = front_m - world.length_m
        self.speed_mps = consist.speed_mps
        self.accel_mps2 = consist.accel_mps2
        self.drive_n = world.drive_n
        self.brake_n = world.brake_n
        gone_m = front_m - self._low_m
        self.gradient_permille = self._low_gradient_permille + self._slope_permille_per_m * gone_m
        self.adhesion_ratio = world.adhesion_ratio
        self.emergency = 1.0 if brake.emergency_wanted else 0.0
        self.emergency_mps2 = brake.emergency_mps2 * brake.working_ratio
        self.holding = 1.0 if brake.holding_mps2 > 0.0 else 0.0
        self.doors_locked = 1.0 if doors.locked else 0.0
        self.left_open = 0.0 if doors.left.state is LOCKED else 1.0
        self.right_open = 0.0 if doors.right.state is LOCKED else 1.0
        self.left_cars = float(doors.left.cars)
        self.right_cars = float(doors.right.cars)
        self.voltage_v = world.power.voltage_v
        self.traction_cut = 1.0 if world.traction.traction_cut else 0.0
        self.odometer_error_m = world.odometer_error_m
        self.tags_read = float(world.tag_reader.tags_read)
        self.authority_end_m = authority_end_m
        self.to_stop_m = self._stop_m - front_m
        alarms = world.alarms
        self.fire = 0.0 if alarms.no_fire else 1.0
        self.obstacle = 0.0 if alarms.no_obstacle else 1.0
        if self._restrictions:
            self.temporary_limit_mps = self._restricted_mps(front_m)
        else:
            self.temporary_limit_mps = self.civil_limit_mps
        if world.told:
            for name, value in world.told.items():
                setattr(self, name, value)

    def _restricted_mps(self, front_m: float) -> float:
        least_mps = self.civil_limit_mps
        for each in self._restrictions:
            if each.start_m <= front_m and self.rear_m <= each.end_m:
                least_mps = min(least_mps, each.limit_mps)
        return least_mps

    def report(self, frame: Frame) -> None:
        """Take one of REPORTS as the train's nodes received it."""
        if isinstance(frame, VobcStatus):
            self.supervision, self.ato_phase = float(frame.supervision), float(frame.ato_phase)
        elif isinstance(frame, VobcMode):
            self.mode = float(frame.mode)

    def hear(self, railway: Railway, start_m: float) -> None:
        """Update the signals that show the latest wayside messages and the platform doors.

        Args:
            start_m: chainage of the front at the start.
        """
        end_m, orders = railway.latest_end_m, railway.centre.latest
        self.authority_now_m = start_m if end_m is None else end_m
        self.authority_rear_m = railway.latest_rear_m
        self.platform_doors_open = 0.0 if railway.doors.all_closed else 1.0
        self.platform_doors_locked = 1.0 if railway.doors.all_locked else 0.0
        if orders is None:
            return
        for name, order in _ORDERS:
            setattr(self, name, float(getattr(orders, order)))
        self._restrictions = orders.restrictions

    def _enter(self, world: World, front_m: float) -> None:
        """Cache the values of the range that the front has entered."""
        line, length_m = world.line, world.length_m
        if world is not self._world or length_m != self._length_m:
            self._world, self._length_m = world, length_m
            self._edges_m = _edges_m(world)
        edges_m = self._edges_m
        index = min(max(1, bisect_right(edges_m, front_m)), len(edges_m) - 1)
        low_m, high_m = edges_m[index - 1], edges_m[index]
        self._low_m, self._high_m = low_m, high_m
        low_permille, high_permille = (
            line.mean_gradient_permille(at_m - length_m, at_m) for at_m in (low_m, high_m)
        )
        self._low_gradient_permille = low_permille
        self._slope_permille_per_m = (high_permille - low_permille) / (high_m - low_m)
        middle_m = 0.5 * (low_m + high_m)
        self.civil_limit_mps = line.least_limit_mps(middle_m - length_m, middle_m)
        stops_m = [station.stop_m for station in line.stations]
        ahead = bisect_right(stops_m, middle_m - PASSED_M)
        self._stop_m = stops_m[min(ahead, len(stops_m) - 1)]

    def pack(self) -> bytes:
        return _RECORD.pack(*(getattr(self, name) for name in SIGNALS))

    def unpack(self, data: bytes) -> None:
        """Restore a sample from the bytes of `pack`. Raises struct.error for any other bytes."""
        for name, value in zip(SIGNALS, _RECORD.unpack(data), strict=True):
            setattr(self, name, value)


def _edges_m(world: World) -> list[float]:
    """Sorted chainages of the front at which a value that depends on the place alone changes."""
    line, length_m = world.line, world.length_m
    changes_m = {edge_m for each in line.gradients for edge_m in (each.start_m, each.end_m)}
    changes_m |= {edge_m for each in line.speed_sections for edge_m in (each.start_m, each.end_m)}
    fronts_m = {station.stop_m + PASSED_M for station in line.stations}
    fronts_m |= changes_m | {edge_m + length_m for edge_m in changes_m}
    return sorted(fronts_m | {line.start_m - FAR_M, line.end_m + FAR_M})


_ORDERS: Final = (
    *((f"order_{name}", name) for name in ("awake", "creep", "emergency", "hold", "restricted")),
    *((f"order_{name}", name) for name in ("skip_next", "stop_next", "releases")),
    ("doors_authorised_left", "doors_left"),
    ("doors_authorised_right", "doors_right"),
)
"""Each order signal with the field of the orders that it shows."""
FAR_M: Final = 1.0e5
"""Distance beyond both ends of the line that the cached ranges cover, m. No train runs that far."""
LOCKED: Final = DoorState.LOCKED
_RECORD: Final = struct.Struct(f"<{len(SIGNALS)}d")
