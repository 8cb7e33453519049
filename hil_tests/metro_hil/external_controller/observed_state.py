"""State of an external controller, derived from its frames in the terms of the shipped one."""

import math
from dataclasses import replace

from can_dbc.codec import Decoder
from can_dbc.vobc import VobcMotion, VobcPosition, VobcStatus
from vobc.vocabulary import SAFE_OUTPUT, CycleOutput, Interval, Motion

UNKNOWN = Interval(-math.inf, 0.0, math.inf)
NOWHERE = Motion(
    front_m=Interval(-math.inf, -math.inf, math.inf),
    speed_mps=UNKNOWN,
    accel_mps2=0.0,
    travel_m=0.0,
    standing=False,
    standstill=False,
    localised=False,
    slip=False,
    accepted_tag_ids=(),
)


class ObservedState:
    """Follows VOBC_STATUS, VOBC_POSITION and VOBC_MOTION, none of which a controller must send."""

    def __init__(self) -> None:
        self._decoder = Decoder([VobcStatus, VobcPosition, VobcMotion])
        self.output: CycleOutput = replace(SAFE_OUTPUT, cause="")
        """State until now; parts that no frame carries are those of the safe output."""

    def frame(self, now_ns: int, can_id: int, data: bytes) -> None:
        if can_id not in self._decoder.ids:
            return
        said = self._decoder.decode(can_id, data, now_ns)
        motion = self.output.motion or NOWHERE
        if isinstance(said, VobcStatus):
            self.output = replace(
                self.output,
                supervision=said.supervision,
                ato_phase=said.ato_phase,
                missing=said.missing,
                motion=replace(motion, localised=said.localised, slip=said.slip_detected),
            )
        elif isinstance(said, VobcPosition):
            low_m, high_m = said.front_m - said.uncertainty_m, said.front_m + said.uncertainty_m
            front_m = Interval(low_m, said.front_m, high_m)
            self.output = replace(self.output, motion=replace(motion, front_m=front_m))
        elif isinstance(said, VobcMotion):
            speed_mps = replace(motion.speed_mps, best=said.speed_mps)
            self.output = replace(self.output, motion=replace(motion, speed_mps=speed_mps))
