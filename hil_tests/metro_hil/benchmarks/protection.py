"""Measures the cost of ATP in a cycle, and the error of its braking curves."""

import random
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final
from unittest.mock import patch

from firmware_py.clock.clock import WallClock
from firmware_py.trackdb import LineMap, load_line
from metro_hil.benchmarks.bench import Figure, run_measures
from metro_hil.benchmarks.curve_crossings import crossings
from metro_hil.metrics.worst_motion import (
    CONFIG,
    CYCLE_S,
    WorstCase,
    ceilings,
    declared_reach_m,
    fastest_by_halving,
    intervals,
    line_of,
    sections,
    worst_stop_m,
)
from metro_hil.model.mission import plan_journey
from metro_hil.model.run_options import parse
from metro_hil.run.lockstep import run_lockstep
from vobc.atp.energy_check import EnergyCheck, Replicas
from vobc.atp.protection import Protection, ProtectionVerdict
from vobc.vocabulary import Interval, Restriction

SEED: Final = 1
LENGTH_M: Final = 68.59
CYCLE_BAR_US: Final = 300.0
LINES: Final = 1000
ERROR_BAR_RATIO: Final = 0.01
ROUNDING_RATIO: Final = 1e-11
"""The integration adds a thousand roundings of 1e-16 each, and meets edges within 1e-12 s."""
LAZY_BAR_RATIO: Final = 0.02
STEP_M: Final = 0.5
AHEAD_M: Final = 320.0
"""Distance from the train to the end of authority: near enough for braking curves to be
computed."""
WIDTHS_M: Final = (0.2, 2.0, 8.0, 20.0)
SLOW: Final = Restriction(2400.0, 2600.0, 8.0)
LEVEL_DISTANCES_M: Final = (15.0, 40.0, 100.0, 200.0, 320.0, 450.0)
NS_PER_US: Final = 1000.0
MS_PER_S: Final = 1000.0


def cost_of_a_cycle() -> list[Figure]:
    """Measure ceiling, energy check and their comparison along two lines at the permitted speed."""
    costs_us = sorted(
        cost_us for name in ("florence", None) for cost_us in _costs_us(_line_of_that_name(name))
    )
    p50_us, p99_us = costs_us[len(costs_us) // 2], costs_us[len(costs_us) * 99 // 100]
    return [
        Figure(
            "ceiling and its replica, a cycle",
            f"p50 {p50_us:.1f} µs, p99 {p99_us:.1f} µs of {len(costs_us)}",
            f"p99 < {CYCLE_BAR_US:.0f} µs",
            p99_us < CYCLE_BAR_US,
        )
    ]


def _line_of_that_name(name: str | None) -> LineMap:
    """Return the shipped line, or one with a change of gradient every 60 m."""
    if name is not None:
        return load_line(name)
    rng = random.Random(SEED)
    return line_of(sections((0.0, 60.0, rng.uniform(-40.0, 40.0)) for _ in range(90)))


def _costs_us(line: LineMap) -> Iterator[float]:
    clock = WallClock()
    ceiling_map = ceilings(line, length_m=LENGTH_M)
    check = EnergyCheck(CONFIG, line, train_length_m=LENGTH_M, cycle_s=CYCLE_S)
    replicas = Replicas(CONFIG, check)
    speed_mps, front_m = 0.0, line.start_m + LENGTH_M
    while front_m < line.end_m - AHEAD_M:
        for width_m in WIDTHS_M:
            front = Interval(front_m - 0.5 * width_m, front_m, front_m + 0.5 * width_m)
            end_m = front_m + AHEAD_M
            begun_ns = clock.now_ns()
            ceiling = ceiling_map.at(front, end_m, (SLOW,))
            replicas.agree(ceiling.emergency_mps, front, speed_mps, end_m, (SLOW,))
            yield (clock.now_ns() - begun_ns) / NS_PER_US
            speed_mps = ceiling.permitted_mps
        front_m += STEP_M


def error_of_distances() -> list[Figure]:
    """Compare the integrated worst motion from the emergency limit with the distance to go."""
    rng = random.Random(SEED)
    errors_ratio = [error for _ in range(LINES) for error in _error_ratio(rng)]
    longer, shorter = max(errors_ratio), -min(errors_ratio)
    never = shorter <= ROUNDING_RATIO
    return [
        Figure(
            "braking distance against integration",
            f"{100.0 * longer:.5f} % longer at most, "
            f"{'never' if never else f'{100.0 * shorter:.5f} %'} shorter, of {LINES} random "
            "lines",
            f"≤ {100.0 * ERROR_BAR_RATIO:.0f} % longer, never shorter",
            longer <= ERROR_BAR_RATIO and never,
        )
    ]


def _error_ratio(rng: random.Random) -> Iterator[float]:
    """Yield the relative excess of ATP's braking distance; nothing without a limit."""
    line = line_of(
        sections(
            (rng.choice((0.0, 0.0, 3.0, 120.0)), rng.uniform(5.0, 400.0), rng.uniform(-40.0, 40.0))
            for _ in range(rng.randint(0, 12))
        ),
        ((0.0, 6000.0, 60.0),),
    )
    length_m, to_end_m = rng.uniform(18.0, 160.0), rng.uniform(20.0, 600.0)
    front = intervals(rng.uniform(50.0, 2500.0), rng.uniform(0.0, 12.0), rng.uniform(0.0, 12.0))
    ceiling = ceilings(line, length_m=length_m).at(front, front.high + to_end_m)
    if ceiling.emergency_mps > 0.0:
        needed_m = worst_stop_m(
            line,
            WorstCase.of(CONFIG),
            front.high,
            ceiling.emergency_mps,
            reach_m=declared_reach_m(front, length_m),
        )
        yield (to_end_m - needed_m) / needed_m


def laziness() -> list[Figure]:
    """Compare the permitted speed on level track with the best that still keeps all leads."""
    line = line_of((), ((0.0, 6000.0, 60.0),))
    lead_s = CONFIG.service_lead_s + CONFIG.warning_lead_s + CONFIG.permitted_lead_s
    lazy_ratio = []
    for to_end_m in LEVEL_DISTANCES_M:

        def way_m(speed_mps: float) -> float:
            case = WorstCase.of(CONFIG)
            return worst_stop_m(line, case, 0.0, speed_mps, reach_m=LENGTH_M, lead_s=lead_s)

        best_mps = fastest_by_halving(to_end_m, way_m)
        ceiling = ceilings(line, length_m=LENGTH_M).at(intervals(0.0, 0.0, 0.0), to_end_m)
        lazy_ratio.append(max(0.0, 1.0 - ceiling.permitted_mps / best_mps))
    return [
        Figure(
            "permitted speed below the best possible",
            f"{100.0 * max(lazy_ratio):.2f} % at most, level, {len(lazy_ratio)} distances",
            f"≤ {100.0 * LAZY_BAR_RATIO:.0f} %",
            max(lazy_ratio) <= LAZY_BAR_RATIO,
        )
    ]


def cost_of_a_step() -> list[Figure]:
    """Measure all of ATP in every cycle of a run along the whole line, in virtual time."""
    clock, costs_us = WallClock(), list[float]()
    step = Protection.step

    def timed(self: Protection, *images: Any, **more: Any) -> ProtectionVerdict:
        begun_ns = clock.now_ns()
        verdict = step(self, *images, **more)
        costs_us.append((clock.now_ns() - begun_ns) / NS_PER_US)
        return verdict

    options = parse(["run", "--lockstep"])
    with patch.object(Protection, "step", timed):
        run_lockstep(options, plan_journey(options), None)
    costs_us.sort()
    p50_us, p99_us = costs_us[len(costs_us) // 2], costs_us[len(costs_us) * 99 // 100]
    return [
        Figure(
            "all of protection, a cycle",
            f"p50 {p50_us:.0f} µs, p99 {p99_us:.0f} µs of {len(costs_us)}",
            f"p99 < {CYCLE_BAR_US:.0f} µs",
            p99_us < CYCLE_BAR_US,
        )
    ]


def delay_of_the_command() -> list[Figure]:
    """Measure the time from the cycle in which the speed may reach its curve to the frame."""
    found = list(crossings())
    delay_ms = MS_PER_S * max(each.commanded_s - each.bound_s for each in found)
    first = sum(each.commanded_s < each.truth_s for each in found)
    return [
        Figure(
            "emergency command after its curve is reached",
            f"{delay_ms:.2f} ms at most, of {len(found)} runs; in {first} before the true speed "
            "reached that limit",
            f"≤ {MS_PER_S * CYCLE_S:.0f} ms, a cycle",
            delay_ms <= MS_PER_S * CYCLE_S,
        )
    ]


MEASURES: Final[dict[str, Callable[[], list[Figure]]]] = {
    "cycle": cost_of_a_cycle,
    "step": cost_of_a_step,
    "command": delay_of_the_command,
    "distances": error_of_distances,
    "laziness": laziness,
}


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table; exit code 1 if a bar is missed."""
    return run_measures(MEASURES, "python -m metro_hil.benchmarks.protection", str(__doc__), argv)


if __name__ == "__main__":
    sys.exit(main())
