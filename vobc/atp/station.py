"""What protection demands at and around platforms: doors, departure, alarms, missed stops."""

from dataclasses import dataclass

from can_dbc.vobc import Cause, Inhibit, Withheld
from firmware_py.trackdb import LineMap
from vobc.atp.config import AtpConfig
from vobc.atp.doors import SHUT, DoorEnable, enabled_doors, platform_at
from vobc.atp.inputs import BRAKE, ODOMETER, TRACTION
from vobc.vocabulary import CycleInput, Motion


@dataclass(frozen=True, slots=True)
class StationVerdict:
    """What stations and passengers ask of the movement in one cycle."""

    doors: DoorEnable = SHUT
    withheld: Withheld = Withheld.NONE
    """Why no side is enabled."""
    inhibits: Inhibit = Inhibit.NONE
    """Why the train must not set off."""
    emergency: Cause = Cause.NONE
    """The emergency brake is needed, and why."""
    stop_now: bool = False
    stop_next: bool = False
    keep_doors_open: bool = False
    jog_back_m: float = 0.0
    """How far back a jog may go; 0 when it may not."""
    jog_permitted: bool = False
    alarm_raised: bool = False
    door_bypass: bool = False
    jog_attempts: int = 0
    """Made at this stop."""
    self_release: bool = False
    """The emergency brake of an overshoot may release itself at standstill: a jog mends it."""


class StationGuard:
    """Remembers what a platform asks of the train: overshoot, attempts, alarms."""

    def __init__(self, config: AtpConfig, line: LineMap, *, train_length_m: float) -> None:
        self._config = config
        self._line = line
        self._length_m = train_length_m

    def step(
        self, seen: CycleInput, motion: Motion, *, gone: int, emergency: bool, may_move: bool
    ) -> StationVerdict:
        """Decide once.

        Args:
            gone: what is not heard, as flags of `Missing`.
            emergency: the emergency brake was latched when the cycle began.
            may_move: supervision permits movement (NOMINAL, WARNING or SERVICE).
        """
        return StationVerdict(doors=self._doors(seen, motion, gone, emergency=emergency))

    def _doors(self, seen: CycleInput, motion: Motion, gone: int, *, emergency: bool) -> DoorEnable:
        if not motion.standstill or not motion.localised:
            return SHUT
        config, brake, traction = self._config, seen.brake, seen.traction
        return enabled_doors(
            standstill=not gone & ODOMETER,
            platform=platform_at(
                self._line.stations,
                motion.front_m,
                window_m=config.door_window_m + config.door_declared_m,
            ),
            holding_applied=brake is not None and brake.holding_applied and not gone & BRAKE,
            traction_cut=traction is not None and traction.traction_cut and not gone & TRACTION,
            emergency=emergency,
        )
