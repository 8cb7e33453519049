"""Table 4 of [Lin] by simulation: each law with the same dwells, compared pair by pair."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, Protocol

import numpy as np

from metro_hil.energy.line.kernel import RUNS
from metro_hil.energy.line.model import (
    HOLD_AND_COAST,
    TRADITIONAL,
    Law,
    LineTrain,
    Supply,
    Timetable,
)
from metro_hil.energy.line.regimes import LegRuns, least_traction
from metro_hil.energy.line.simulate import LapResults, dwells_of, simulate
from metro_hil.energy.line.synchronise import TimetableSearch

SEEDS: Final = tuple(range(1, 11))
LAPS: Final = 2
PERCENT: Final = 100.0
CONFIDENCE: Final = 0.95
BUDGET: Final = 150


@dataclass(frozen=True, slots=True)
class PrintedColumn:
    """One column of the paper's table."""

    law: str
    overall_kwh: float
    actual_kwh: float
    use_ratio: float
    timing_ratio: float


PRINTED: Final = (
    PrintedColumn("traditional", 2056.01, 1607.49, 0.2740, 1.0),
    PrintedColumn("green 1/0", 1967.46, 1529.45, 0.2727, 1.0),
    PrintedColumn("green .786/.214", 1988.82, 1462.15, 0.3172, 1.0),
    PrintedColumn("green .5/.5", 1966.8, 1412.72, 0.3350, 0.95),
)
LAPS_A_YEAR: Final = 15.0 * 3600.0 / 1260.0 * 365.0
"""Laps in a year with 15 h a day and a lap of seven trains every 21 min."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """A mean with its confidence interval."""

    mean_ratio: float
    half_ratio: float | None
    """Half of the interval; None for a single seed, which says nothing about the spread."""

    @property
    def text(self) -> str:
        """Return mean and interval in per cent."""
        mean = f"{PERCENT * self.mean_ratio:+.2f} %"
        if self.half_ratio is None:
            return f"{mean}, one seed"
        return f"{mean} ± {PERCENT * self.half_ratio:.2f}"


@dataclass(frozen=True, slots=True)
class TableFourRow:
    name: str
    outcomes: tuple[LapResults, ...]
    """Results by seed."""
    change: Estimate
    """Relative change of the actual energy against the traditional law with the same dwells."""

    def mean(self, of: Callable[[LapResults], float]) -> float:
        return float(np.mean([of(outcome) for outcome in self.outcomes]))

    @property
    def runs(self) -> int:
        return sum(int(outcome.books[RUNS]) for outcome in self.outcomes)


@dataclass(frozen=True, slots=True)
class TableFour:
    supply: Supply
    rows: tuple[TableFourRow, ...]
    synchronised: Timetable
    constant_v: float
    seeds: tuple[int, ...]


def green(alpha_ratio: float, beta_ratio: float, **changes: object) -> Law:
    name = f"green {alpha_ratio:g}/{beta_ratio:g}"
    law = Law(name, alpha_ratio=alpha_ratio, beta_ratio=beta_ratio)
    return replace(law, **changes)  # type: ignore[arg-type]


def table_four(
    supply: Supply,
    *,
    train: LineTrain | None = None,
    seeds: Sequence[int] = SEEDS,
    laps: int = LAPS,
    budget: int = BUDGET,
    synchronised: Timetable | None = None,
    told: Callable[[str], None] = lambda words: None,
) -> TableFour:
    """Compute all rows for one supply; `told` receives the current step as text."""
    train = train or LineTrain()
    base = Timetable()
    dwells = [dwells_of(seed, laps + 2) for seed in seeds]

    def outcomes(timetable: Timetable, law: Law) -> tuple[LapResults, ...]:
        told(f"{supply.name}: {law.name}")
        return tuple(simulate(train, supply, timetable, law, one, laps=laps) for one in dwells)

    traditional = outcomes(base, TRADITIONAL)
    constant_v = mean_voltage_v(train, supply, base)
    calm = least_traction(LegRuns(train), base)
    if synchronised is None:
        told(f"{supply.name}: looking for the synchronised timetable")
        synchronised = TimetableSearch(train, supply, base, seed=1, budget=budget).run().timetable
    plans: list[tuple[str, Timetable, Law]] = [
        ("green 1/0", base, green(1.0, 0.0)),
        ("green .786/.214", base, green(0.786, 0.214)),
        ("  voltage constant", base, green(0.786, 0.214, constant_v=constant_v)),
        ("  sign reversed", base, green(0.786, 0.214, reversed_sign=True)),
        ("green .5/.5", base, green(0.5, 0.5)),
        ("  voltage constant", base, green(0.5, 0.5, constant_v=constant_v)),
        ("green .5/.5, (7) as printed", base, green(0.5, 0.5, literal_time=True)),
        ("hold and coast", calm, HOLD_AND_COAST),
        ("synchronised timetable", synchronised, HOLD_AND_COAST),
    ]
    rows = [TableFourRow("traditional", traditional, Estimate(0.0, 0.0))]
    for name, timetable, law in plans:
        found = outcomes(timetable, law)
        rows.append(TableFourRow(name, found, paired(traditional, found)))
    return TableFour(supply, tuple(rows), synchronised, constant_v, tuple(seeds))


def mean_voltage_v(train: LineTrain, supply: Supply, timetable: Timetable) -> float:
    """Return the mean train voltage over a lap of the traditional law, for the ablation."""
    record = simulate(train, supply, timetable, TRADITIONAL, dwells_of(0, 3), record_s=1.0).record
    assert record is not None
    return round(float(np.mean(record.voltage_v[len(record.voltage_v) // 2 :])), 1)


class Metered(Protocol):
    """Results with an energy."""

    @property
    def actual_kwh(self) -> float: ...


def paired(base: Sequence[Metered], other: Sequence[Metered]) -> Estimate:
    """Return the relative change of the actual energy, seed by seed, with Student's interval."""
    changes = np.array(
        [b.actual_kwh / a.actual_kwh - 1.0 for a, b in zip(base, other, strict=True)]
    )
    if len(changes) < 2:
        return Estimate(float(changes[0]), None)
    from scipy.stats import t

    spread = float(np.std(changes, ddof=1)) / float(np.sqrt(len(changes)))
    half = float(t.ppf(0.5 + CONFIDENCE / 2.0, len(changes) - 1)) * spread
    return Estimate(float(np.mean(changes)), half)


def share_at_least(hits: int, tries: int) -> float:
    """Return the one-sided lower bound of a share after Clopper and Pearson."""
    if hits == 0:
        return 0.0
    from scipy.stats import beta

    return float(beta.ppf(1.0 - CONFIDENCE, hits, tries - hits + 1))
