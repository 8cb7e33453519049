"""Situations by chance: a line, a train on it, its authority and its temporary restrictions."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from firmware_py.trackdb import GradientSection, LineMap, SpeedSection, Station
from vobc.config import VobcConfig, load_config
from vobc.vocabulary import Interval, Restriction

PARAMETERS: Final = ("florence4", "hefei6", "nanakuma4", "typeB4")
STEEPEST_PERMILLE: Final = 60.0
LENGTHS_M: Final = (1.0, 400.0)
"""Shortest and longest train."""
PIECES_M: Final = (1.0, 200.0)
"""Shortest and longest section of one limit or gradient."""
STARTS_M: Final = (-900.0, 3000.0)
LINE_M: Final = 1200.0
LIMITS_MPS: Final = (1.0, 33.0)
WIDTHS_M: Final = (0.0, 40.0)
"""Narrowest and widest interval of the front."""
POINTS_ONE_IN: Final = 4
"""One situation in so many has an interval of width 0.

Protection rounds a width up to whole steps. What it adds would hide a length that is too short.
"""
REARS_ONE_IN: Final = 4
"""In one situation in so many the rear is about to leave the lowest limit under the train."""
REAR_M: Final = 1.0
"""Greatest distance of such a rear from the end of the limit."""
RESTRICTIONS_MAX: Final = 4
ENDS_M: Final = (-5.0, 1500.0)
"""Least and greatest distance from the foremost front to the end of authority."""
STATION_M: Final = 5.0

Piece = tuple[float, float, float]
"""Start, end and value."""


@dataclass(frozen=True, slots=True)
class AttackSituation:
    """A train at one instant, as the protection sees it."""

    config: VobcConfig
    line: LineMap
    length_m: float
    front_m: Interval
    authority_end_m: float
    restrictions: tuple[Restriction, ...]

    def text(self) -> str:
        """The values that describe the situation, for the report of a violation."""
        front = self.front_m
        return (
            f"train of {self.length_m:.2f} m, front {front.low:.3f} to {front.high:.3f} m, "
            f"authority to {self.authority_end_m:.3f} m, {len(self.restrictions)} restrictions, "
            f"{len(self.line.speed_sections)} limits, {len(self.line.gradients)} gradients"
        )


def situation(seed: int) -> AttackSituation:
    """The situation of a seed."""
    chance = np.random.default_rng(seed)
    config = load_config(PARAMETERS[int(chance.integers(0, len(PARAMETERS)))])
    start_m = float(chance.uniform(*STARTS_M))
    line = _line(chance, start_m)
    high_m = start_m + float(chance.uniform(0.0, LINE_M))
    is_point = chance.integers(0, POINTS_ONE_IN) == 0
    low_m = high_m if is_point else high_m - _logarithmic(chance, *WIDTHS_M)
    lengths_m = _lengths_to_leave_m(line, high_m, low_m)
    if lengths_m and chance.integers(0, REARS_ONE_IN) == 0:
        length_m = lengths_m[int(chance.integers(0, len(lengths_m)))]
        length_m += float(chance.uniform(0.0, REAR_M))
    else:
        length_m = _logarithmic(chance, *LENGTHS_M)
    return AttackSituation(
        config=config,
        line=line,
        length_m=length_m,
        front_m=Interval(low_m, 0.5 * (low_m + high_m), high_m),
        authority_end_m=high_m + _logarithmic(chance, *ENDS_M),
        restrictions=tuple(
            _restriction(chance, high_m) for _ in range(int(chance.integers(0, RESTRICTIONS_MAX)))
        ),
    )


def _lengths_to_leave_m(line: LineMap, high_m: float, low_m: float) -> list[float]:
    """Lengths whose rear is at the end of a limit that is lower than all limits ahead of it."""
    lengths_m, least_mps = [], math.inf
    for section in reversed(line.speed_sections):
        if section.start_m > high_m or section.limit_mps >= least_mps:
            continue
        least_mps = section.limit_mps
        length_m = low_m - section.end_m
        if LENGTHS_M[0] <= length_m <= LENGTHS_M[1] - REAR_M:
            lengths_m.append(length_m)
    return lengths_m


def _line(chance: np.random.Generator, start_m: float) -> LineMap:
    """A line whose limits and gradients change every few metres, or every few hundred."""
    limits = _pieces(chance, start_m, LIMITS_MPS)
    falls = _pieces(chance, start_m, (-STEEPEST_PERMILLE, STEEPEST_PERMILLE))
    end_m = start_m + LINE_M
    # Half of the lines have gaps, which are level.
    gaps = chance.integers(0, 2) == 0
    gradients = [each for each in falls if not gaps or chance.integers(0, 2) == 0]
    return LineMap(
        "by chance",
        start_m,
        end_m,
        (Station("A", start_m + STATION_M, start_m, start_m + 2.0 * STATION_M),),
        tuple(SpeedSection(*each) for each in limits),
        tuple(GradientSection(*each) for each in gradients),
    )


def _pieces(
    chance: np.random.Generator, start_m: float, values: tuple[float, float]
) -> list[Piece]:
    """Sections from end to end of the line, with lengths of one order of magnitude."""
    longest_m = _logarithmic(chance, *PIECES_M)
    end_m, at_m = start_m + LINE_M, start_m
    found: list[Piece] = []
    while at_m < end_m:
        to_m = min(end_m, at_m + float(chance.uniform(PIECES_M[0], max(longest_m, 2.0))))
        found.append((at_m, to_m, float(chance.uniform(*values))))
        at_m = to_m
    return found


def _restriction(chance: np.random.Generator, front_m: float) -> Restriction:
    start_m = front_m + float(chance.uniform(-300.0, 900.0))
    return Restriction(
        start_m, start_m + _logarithmic(chance, *PIECES_M), float(chance.uniform(*LIMITS_MPS))
    )


def _logarithmic(chance: np.random.Generator, least: float, most: float) -> float:
    """A number of any order of magnitude between the two; bounds may be zero or less."""
    return least - 1.0 + float(np.exp(chance.uniform(0.0, np.log(most - least + 1.0))))
