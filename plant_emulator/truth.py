"""What is true of the train at one instant, for monitors, conditions of faults and the feed."""

import struct
from typing import TYPE_CHECKING, Final

from can_dbc.doors import DoorState

if TYPE_CHECKING:
    from plant_emulator.world import World

NS_PER_S: Final = 1_000_000_000


class Truth:
    """One sample, filled anew by `read`; its attributes are signals of conditions and monitors."""

    __slots__ = (
        "accel_mps2",
        "adhesion_ratio",
        "authority_end_m",
        "brake_n",
        "doors_locked",
        "drive_n",
        "emergency",
        "emergency_mps2",
        "front_m",
        "gradient_permille",
        "holding",
        "left_open",
        "odometer_error_m",
        "rear_m",
        "right_open",
        "speed_mps",
        "t_s",
        "tags_read",
        "to_stop_m",
        "voltage_v",
    )

    def __init__(self) -> None:
        self.t_s = 0.0
        """Since the start of the run."""
        self.front_m = 0.0
        """Chainage of the front coupler."""
        self.rear_m = 0.0
        self.speed_mps = 0.0
        """Of the whole train, signed; exactly zero at standstill."""
        self.accel_mps2 = 0.0
        self.drive_n = 0.0
        """Tractive effort at the rail, signed."""
        self.brake_n = 0.0
        """Brake force at the rail, never negative."""
        self.gradient_permille = 0.0
        """Mean under the train."""
        self.adhesion_ratio = 0.0
        self.emergency = 0.0
        """1 while the brake unit wants the emergency brake."""
        self.emergency_mps2 = 0.0
        """What the emergency brake gives."""
        self.holding = 0.0
        """1 while the holding brake gives anything."""
        self.doors_locked = 1.0
        self.left_open = 0.0
        """1 from unlocking to locking."""
        self.right_open = 0.0
        self.voltage_v = 0.0
        self.odometer_error_m = 0.0
        self.tags_read = 0.0
        self.authority_end_m = 0.0
        """Farthest end of all authorities given; before the first, the train's front at start."""
        self.to_stop_m = 0.0
        """To the next stopping point ahead by the line's map; that of the last once behind it."""

    def read(self, world: "World", start_ns: int, authority_end_m: float) -> None:
        consist, brake, doors = world.consist, world.brake, world.doors
        front_m = consist.car_fronts_m[0]
        self.t_s = (world.now_ns - start_ns) / NS_PER_S
        self.front_m = front_m
        self.rear_m = front_m - world.train.length_m
        self.speed_mps = consist.speed_mps
        self.accel_mps2 = consist.accel_mps2
        self.drive_n = world.drive_n
        self.brake_n = world.brake_n
        self.gradient_permille = world.gradient_permille
        self.adhesion_ratio = world.adhesion_ratio
        self.emergency = 1.0 if brake.emergency_wanted else 0.0
        self.emergency_mps2 = brake.emergency_mps2
        self.holding = 1.0 if brake.holding_mps2 > 0.0 else 0.0
        self.doors_locked = 1.0 if doors.locked else 0.0
        self.left_open = 0.0 if doors.left.state is DoorState.LOCKED else 1.0
        self.right_open = 0.0 if doors.right.state is DoorState.LOCKED else 1.0
        self.voltage_v = world.power.voltage_v
        self.odometer_error_m = world.odometer_error_m
        self.tags_read = float(world.tag_reader.tags_read)
        self.authority_end_m = authority_end_m
        stations = world.line.stations
        ahead = (station.stop_m for station in stations if station.stop_m >= front_m - PASSED_M)
        self.to_stop_m = next(ahead, stations[-1].stop_m) - front_m

    def pack(self) -> bytes:
        return _RECORD.pack(*(getattr(self, name) for name in SIGNALS))

    def unpack(self, data: bytes) -> None:
        """Raises struct.error for anything but what `pack` made."""
        for name, value in zip(SIGNALS, _RECORD.unpack(data), strict=True):
            setattr(self, name, value)


PASSED_M: Final = 20.0
"""So far behind a stopping point a train is taken to have missed it and to go for the next."""
SIGNALS: Final[tuple[str, ...]] = tuple(Truth.__slots__)
_RECORD: Final = struct.Struct(f"<{len(SIGNALS)}d")
