"""Second computation of the emergency limit, by the energy of the train at the targets ahead.

`CeilingMap` computes backwards, from each target to the highest present speed. `EnergyCheck`
computes forwards from the present speed, in the form of [Lin]. It takes the kinetic energy, adds
the work of traction in t1 and of the gradient, and subtracts the work of the brake. It compares the
result with the energy allowed at the target. The two share only settings and track database, so a
mistake in one does not hide in the other. `Replicas` checks that they agree.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from firmware_py.trackdb import LineMap
from vobc.atp.config import AtpConfig
from vobc.vocabulary import Interval, Restriction

WEIGHT_N_PER_KG: Final = 9.81
"""Weight per mass. On a gradient, the force along the track is this times height per length."""


class _Phase(NamedTuple):
    """Part of the worst motion: force on the train and duration."""

    push_n_per_kg: float
    """Force per mass along the track, without the gradient."""
    lasts_s: float


@dataclass(frozen=True, slots=True)
class _Target:
    """A place ahead and the kinetic energy permitted there."""

    at_m: float
    energy_j_per_kg: float


class _Fall(NamedTuple):
    """A downhill section and its force."""

    start_m: float
    end_m: float
    pull_n_per_kg: float


class EnergyCheck:
    """Whether the train would have too much energy at a target ahead after the worst reaction now.

    The motion follows the safe braking model as `profile` defines it. It starts at the foremost
    front of the interval. Each downhill section acts from when this front reaches it until the
    hindmost rear leaves it. Of several, the steepest one acts.
    """

    def __init__(
        self, config: AtpConfig, line: LineMap, *, train_length_m: float, cycle_s: float
    ) -> None:
        self._length_m = train_length_m
        self._step_m = config.interval_step_m
        self._margin_mps = config.emergency_margin_mps
        # One cycle until the speed is sampled, plus the cycles that may be missed in a row.
        looks_late_s = sum([cycle_s] * (config.overruns_max + 1))
        t1_s = config.sensing_s + looks_late_s + config.traction_cut_s
        self._phases = (
            _Phase(config.runaway_mps2, t1_s),
            _Phase(0.0, config.brake_build_up_s),
            _Phase(-config.guaranteed_decel_mps2, math.inf),
        )
        self._falls = tuple(
            _Fall(g.start_m, g.end_m, -g.gradient_permille * WEIGHT_N_PER_KG / 1000.0)
            for g in line.gradients
            if g.gradient_permille < 0.0
        )
        # The first and the last limit of a line also hold beyond its ends.
        starts_m = [-math.inf, *(section.start_m for section in line.speed_sections[1:])]
        ends_m = [*starts_m[1:], math.inf]
        limits_mps = [section.limit_mps for section in line.speed_sections]
        self._civil = tuple(
            Restriction(*section) for section in zip(starts_m, ends_m, limits_mps, strict=True)
        )

    def exceeded(
        self,
        front_m: Interval,
        speed_high_mps: float,
        authority_end_m: float,
        restrictions: Sequence[Restriction] = (),
    ) -> bool:
        """Whether the emergency brake is needed now.

        A place or speed that is not finite needs the brake.

        Args:
            front_m: interval of the front. Targets ahead count from its high end.
            speed_high_mps: upper bound. A train that runs backwards counts as standing.
            authority_end_m: the front must not reach it.
            restrictions: temporary ones, in any order. They count like civil limits.
        """
        if not (math.isfinite(front_m.high - front_m.low) and math.isfinite(speed_high_mps)):
            return True
        if not front_m.high < authority_end_m:
            return True
        speed_mps = max(0.0, speed_high_mps)
        rear_m = front_m.low - self._length_m
        targets = [_Target(authority_end_m, 0.0)]
        for limits in (self._civil, restrictions):
            for limit in limits:
                tolerated_mps = limit.limit_mps + self._margin_mps
                if speed_mps < tolerated_mps or limit.end_m <= rear_m:
                    continue
                targets.append(_Target(limit.start_m, 0.5 * tolerated_mps * tolerated_mps))
        targets.sort(key=lambda target: target.at_m)
        return self._arrives_with_too_much(front_m, 0.5 * speed_mps * speed_mps, targets)

    def _arrives_with_too_much(
        self, front_m: Interval, energy_j_per_kg: float, targets: Sequence[_Target]
    ) -> bool:
        """Follow the energy from target to target until it is too high at one, or is used up.

        A limit that already applies lies behind the front, so the present energy counts. At the end
        of authority, which is one of the targets, any energy is too much.
        """
        steps = math.ceil((front_m.high - front_m.low) / self._step_m)
        covered_m = self._length_m + steps * self._step_m
        at_m, phase, spent_s = front_m.high, 0, 0.0
        ahead = iter(targets)
        target = next(ahead)
        while at_m < target.at_m or energy_j_per_kg < target.energy_j_per_kg:
            if at_m >= target.at_m:
                target = next(ahead)
                continue
            pull_n_per_kg, until_m = self._pull(at_m, covered_m)
            push_n_per_kg, lasts_s = self._phases[phase]
            force_n_per_kg = push_n_per_kg + pull_n_per_kg
            room_m = min(until_m, target.at_m) - at_m
            way_m = _way_m(energy_j_per_kg, force_n_per_kg, lasts_s - spent_s)
            if way_m >= room_m:
                before_mps = math.sqrt(2.0 * energy_j_per_kg)
                energy_j_per_kg = max(0.0, energy_j_per_kg + force_n_per_kg * room_m)
                mean_mps = 0.5 * (before_mps + math.sqrt(2.0 * energy_j_per_kg))
                spent_s += room_m / mean_mps
                at_m = min(until_m, target.at_m)
            elif lasts_s == math.inf:
                return False
            else:
                energy_j_per_kg += force_n_per_kg * way_m
                at_m, phase, spent_s = at_m + way_m, phase + 1, 0.0
        return True

    def _pull(self, at_m: float, covered_m: float) -> tuple[float, float]:
        """The greatest downhill force on a train with its front here, and the place where it may
        change.
        """
        greatest_n_per_kg, until_m = 0.0, math.inf
        for fall in self._falls:
            if fall.start_m > at_m:
                return greatest_n_per_kg, min(until_m, fall.start_m)
            clear_m = fall.end_m + covered_m
            if clear_m > at_m:
                until_m = min(until_m, clear_m)
                greatest_n_per_kg = max(greatest_n_per_kg, fall.pull_n_per_kg)
        return greatest_n_per_kg, until_m


def _way_m(energy_j_per_kg: float, force_n_per_kg: float, time_s: float) -> float:
    """Distance of a train in a time. If the time is infinite: distance until its energy is
    used up.
    """
    if time_s == math.inf:
        return -energy_j_per_kg / force_n_per_kg if force_n_per_kg < 0.0 else math.inf
    return (math.sqrt(2.0 * energy_j_per_kg) + 0.5 * force_n_per_kg * time_s) * time_s


class Replicas:
    """Compares the two computations in each cycle and counts how long they differ."""

    def __init__(self, config: AtpConfig, check: EnergyCheck) -> None:
        self._band_mps = config.replica_band_mps
        self._cycles_max = config.replica_cycles_max
        self._check = check
        self._differed = 0
        self.exceeded = False
        """Result of the energy check in the last cycle. Either computation may brake the train."""

    def agree(
        self,
        emergency_mps: float,
        front_m: Interval,
        speed_high_mps: float,
        authority_end_m: float,
        restrictions: Sequence[Restriction] = (),
    ) -> bool:
        """Compare once a cycle. False after more differing cycles in a row than are tolerated.

        They differ if one finds the limit exceeded while the other finds the train below it by more
        than the band. Reaching a limit counts as exceeding it.

        Args:
            emergency_mps: emergency limit of the ceiling. The other arguments are the inputs of
                both.
        """
        speed_mps = max(0.0, speed_high_mps)
        exceeds = self._check.exceeded
        self.exceeded = exceeds(front_m, speed_mps, authority_end_m, restrictions)
        above_mps = speed_mps + self._band_mps
        if self.exceeded:
            differ = not above_mps >= emergency_mps
        else:
            differ = not speed_mps < emergency_mps and not exceeds(
                front_m, above_mps, authority_end_m, restrictions
            )
        self._differed = self._differed + 1 if differ else 0
        return self._differed <= self._cycles_max
