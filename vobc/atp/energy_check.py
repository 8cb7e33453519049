"""The second computation of the emergency limit: the train's energy, followed to what lies ahead.

`CeilingMap` reckons backwards, from each target to the highest speed here. `EnergyCheck` reckons
forwards, from the speed there is, in the form of seed 000: kinetic energy now, plus the work of
traction in t1 and of the fall, minus the work of the brake, against the energy allowed at the
target. The two share settings and the track database and nothing else, so that a mistake in one
does not also hide in the other. `Replicas` watches that they say the same.
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

from firmware_py.trackdb import LineMap
from vobc.atp.config import AtpConfig
from vobc.vocabulary import Interval, Restriction

WEIGHT_N_PER_KG: Final = 9.81
EVERYWHERE: Final = -math.inf


class _Phase(NamedTuple):
    """A part of the worst motion: what the train does by itself, and for how long."""

    push_n_per_kg: float
    """Force per mass along the track, the fall apart."""
    lasts_s: float


class _Target(NamedTuple):
    """A place ahead and the kinetic energy that may be left there."""

    at_m: float
    energy_j_per_kg: float


class EnergyCheck:
    """Whether the train would have too much energy left at something ahead if all went wrong now."""

    def __init__(
        self, config: AtpConfig, line: LineMap, *, train_length_m: float, cycle_s: float
    ) -> None:
        self._line = line
        self._length_m = train_length_m
        self._step_m = config.interval_step_m
        self._margin_mps = config.emergency_margin_mps
        # t1: one cycle until the speed is looked at, one until the command is out.
        t1_s = config.sensing_s + cycle_s + cycle_s + config.traction_cut_s
        self._phases = (
            _Phase(config.runaway_mps2, t1_s),
            _Phase(0.0, config.brake_build_up_s),
            _Phase(-config.guaranteed_decel_mps2, math.inf),
        )

    def exceeded(
        self,
        front_m: Interval,
        speed_high_mps: float,
        authority_end_m: float,
        restrictions: Sequence[Restriction] = (),
    ) -> bool:
        """Whether the emergency brake is needed now.

        Args:
            front_m: the front lies somewhere in it; ahead counts from its high end.
            speed_high_mps: upper bound; a train that runs backwards counts as standing.
            authority_end_m: nothing may be left of the energy there.
            restrictions: temporary ones, in any order; they count like civil limits.

        A number that is not finite needs the brake.
        """
        speed_mps = max(0.0, speed_high_mps)
        finite = math.isfinite(front_m.high - front_m.low) and math.isfinite(speed_high_mps)
        if not finite or not front_m.high < authority_end_m:
            return True
        rear_m = front_m.low - self._length_m
        targets = [_Target(authority_end_m, 0.0)]
        for start_m, end_m, limit_mps in self._limits(restrictions):
            if speed_mps < limit_mps + self._margin_mps or end_m <= rear_m:
                continue
            if start_m <= front_m.high:
                return True
            targets.append(_Target(start_m, 0.5 * (limit_mps + self._margin_mps) ** 2))
        return self._arrives_too_fast(front_m, speed_mps, sorted(targets))

    def _limits(self, restrictions: Sequence[Restriction]) -> list[tuple[float, float, float]]:
        """Start, end and limit of all that limits the speed; the line's own first."""
        civil = [(s.start_m, s.end_m, s.limit_mps) for s in self._line.speed_sections]
        civil[-1] = (civil[-1][0], math.inf, civil[-1][2])
        return civil + [(r.start_m, r.end_m, r.limit_mps) for r in restrictions]

    def _arrives_too_fast(
        self, front_m: Interval, speed_mps: float, targets: Sequence[_Target]
    ) -> bool:
        return False


class Replicas:
    """Compares the two computations in each cycle and remembers for how long they differed."""

    def __init__(self, config: AtpConfig, check: EnergyCheck) -> None:
        self._band_mps = config.replica_band_mps
        self._cycles_max = config.replica_cycles_max
        self._check = check
        self._differed = 0
        self.exceeded = False
        """What the energy check said in the last cycle."""

    def agree(
        self,
        emergency_mps: float,
        front_m: Interval,
        speed_high_mps: float,
        authority_end_m: float,
        restrictions: Sequence[Restriction] = (),
    ) -> bool:
        """Once a cycle. False as soon as they differed in more cycles than are forgiven.

        They differ when one says that the limit is exceeded while by the other the train is clear
        of it by more than the band. `emergency_mps` is that of the ceiling; the rest is what both
        were made from. Reaching a limit is exceeding it.
        """
        return True
