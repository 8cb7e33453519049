"""Measures how much of a sweep's space was run: t-wise coverage, its gaps, margins by bin."""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import msgspec

from metro_hil.model.case import Case, CaseResult, Verdict

STRENGTH_MAX: Final = 3
GAPS_MAX: Final = 50
LEVELS_MAX: Final = 12
"""A factor with more numeric levels than this is divided into bins."""
BINS: Final = 5
CONCLUSIVE: Final = (Verdict.PASS, Verdict.FAIL)


class Axis(msgspec.Struct, frozen=True, kw_only=True):
    """The bins of one factor, in order."""

    key: str
    bins: tuple[str, ...]
    """Labels of the bins: a level, or a range `low..high`. A range holds its low end; the last also
    its high end."""
    edges: tuple[float, ...] | None
    """Borders of the bins of numbers, with both ends; None where each level is a bin."""


class Gap(msgspec.Struct, frozen=True, kw_only=True):
    """A combination of bins without a conclusive result."""

    bins: dict[str, str]
    ran: bool
    """Whether a case of the combination ran; if so, no case passed or failed."""


class Share(msgspec.Struct, frozen=True, kw_only=True):
    """Coverage of the combinations of `strength` factors' bins."""

    strength: int
    combinations: int
    run: int
    """Number of combinations with any result."""
    conclusive: int
    """Number of combinations with a pass or a fail."""
    gaps: tuple[Gap, ...]
    """The first GAPS_MAX combinations that are not conclusive."""
    gap_count: int

    @property
    def run_ratio(self) -> float:
        return self.run / self.combinations if self.combinations else 1.0

    @property
    def conclusive_ratio(self) -> float:
        return self.conclusive / self.combinations if self.combinations else 1.0


class Cell(msgspec.Struct, frozen=True, kw_only=True):
    """Results in one bin, or in two bins of different factors together."""

    bins: dict[str, str]
    cases: int
    conclusive: int
    failed: int
    margins: dict[str, float]
    """Least margin of each monitor, by the monitor's name."""
    worst: dict[str, str]
    """Id of the case with each least margin, by the monitor's name."""


class ScenarioCoverage(msgspec.Struct, frozen=True, kw_only=True):
    scenario: str
    cases: int
    axes: tuple[Axis, ...]
    shares: tuple[Share, ...]
    """Coverage by single factors, by pairs, and so on up to the requested strength."""
    singles: tuple[Cell, ...]
    """Results in each bin that was run."""
    pairs: tuple[Cell, ...]
    """Results in each pair of bins that was run, for heat maps."""


class Coverage(msgspec.Struct, frozen=True, kw_only=True):
    scenarios: tuple[ScenarioCoverage, ...]
    """Scenarios with factors, in the order of the cases."""


def coverage(
    cases: Sequence[Case], results: Sequence[CaseResult], strength: int = 2, *, bins: int = BINS
) -> Coverage:
    """Coverage of all scenarios with factors.

    The space consists of the values that occur in `cases`; a case without a result was not run.
    Points that a design omits on purpose therefore count as gaps.

    Args:
        strength: 1 to 3; lower strengths are reported as well.
        bins: number of bins, of equal width, for a factor with more than LEVELS_MAX numbers.
    """
    assert 1 <= strength <= STRENGTH_MAX
    assert bins >= 1
    by_id = {result.case_id: result for result in results}
    scenarios: dict[str, list[Case]] = {}
    for case in sorted(cases, key=lambda case: case.index):
        if case.factors:
            scenarios.setdefault(case.scenario, []).append(case)
    return Coverage(
        scenarios=tuple(
            _of_scenario(name, some, by_id, strength, bins) for name, some in scenarios.items()
        )
    )


def _of_scenario(
    name: str,
    cases: Sequence[Case],
    results: Mapping[str, CaseResult],
    strength: int,
    bins: int,
) -> ScenarioCoverage:
    keys = list(dict.fromkeys(key for case in cases for key in case.factors))
    axes = [axis_of(key, [case.factors.get(key) for case in cases], bins) for key in keys]
    finders = [_finder(axis) for axis in axes]
    places = [
        tuple(find(case.factors.get(key)) for key, find in zip(keys, finders, strict=True))
        for case in cases
    ]
    outcomes = [results.get(case.id) for case in cases]
    return ScenarioCoverage(
        scenario=name,
        cases=len(cases),
        axes=tuple(axes),
        shares=tuple(
            _share(axes, places, outcomes, number)
            for number in range(1, min(strength, len(axes)) + 1)
        ),
        singles=_cells(axes, places, outcomes, 1),
        pairs=_cells(axes, places, outcomes, 2),
    )


def axis_of(key: str, values: Sequence[Any], bins: int) -> Axis:
    """The bins of one factor, from the values it takes."""
    unique = list({_label(value): value for value in values}.values())
    numbers = [value for value in unique if _is_number(value)]
    if len(numbers) < len(unique) or len(unique) <= LEVELS_MAX:
        ordered = sorted(unique) if len(numbers) == len(unique) else unique
        return Axis(key=key, bins=tuple(map(_label, ordered)), edges=None)
    low, high = min(numbers), max(numbers)
    edges = tuple(low + (high - low) * place / bins for place in range(bins + 1))
    labels = tuple(f"{start:.6g}..{end:.6g}" for start, end in itertools.pairwise(edges))
    return Axis(key=key, bins=labels, edges=edges)


def _finder(axis: Axis) -> Callable[[Any], int]:
    """Function that gives the number of a value's bin."""
    edges = axis.edges
    if edges is None:
        index = {label: place for place, label in enumerate(axis.bins)}
        return lambda value: index[_label(value)]
    low, width, last = edges[0], edges[1] - edges[0], len(axis.bins) - 1
    return lambda value: max(0, min(int((value - low) / width), last))


def _share(
    axes: Sequence[Axis],
    places: Sequence[tuple[int, ...]],
    outcomes: Sequence[CaseResult | None],
    strength: int,
) -> Share:
    total = run = conclusive = gap_count = 0
    gaps: list[Gap] = []
    for chosen in itertools.combinations(range(len(axes)), strength):
        seen: set[tuple[int, ...]] = set()
        concluded: set[tuple[int, ...]] = set()
        for place, outcome in zip(places, outcomes, strict=True):
            if outcome is not None:
                spot = tuple(place[axis] for axis in chosen)
                seen.add(spot)
                if outcome.verdict in CONCLUSIVE:
                    concluded.add(spot)
        sizes = [len(axes[axis].bins) for axis in chosen]
        size = math.prod(sizes)
        total, run, conclusive = total + size, run + len(seen), conclusive + len(concluded)
        gap_count += size - len(concluded)
        if len(concluded) == size or len(gaps) >= GAPS_MAX:
            continue
        for spot in itertools.product(*map(range, sizes)):
            if spot not in concluded:
                gaps.append(Gap(bins=_named(axes, chosen, spot), ran=spot in seen))
                if len(gaps) == GAPS_MAX:
                    break
    return Share(
        strength=strength,
        combinations=total,
        run=run,
        conclusive=conclusive,
        gaps=tuple(gaps),
        gap_count=gap_count,
    )


def _cells(
    axes: Sequence[Axis],
    places: Sequence[tuple[int, ...]],
    outcomes: Sequence[CaseResult | None],
    strength: int,
) -> tuple[Cell, ...]:
    """All combinations of bins that were run, with the least margins in them."""
    cells: list[Cell] = []
    for chosen in itertools.combinations(range(len(axes)), strength):
        groups: dict[tuple[int, ...], list[CaseResult]] = {}
        for place, outcome in zip(places, outcomes, strict=True):
            if outcome is not None:
                groups.setdefault(tuple(place[axis] for axis in chosen), []).append(outcome)
        cells += [_cell(_named(axes, chosen, spot), some) for spot, some in sorted(groups.items())]
    return tuple(cells)


def _cell(bins: dict[str, str], results: Sequence[CaseResult]) -> Cell:
    margins: dict[str, float] = {}
    worst: dict[str, str] = {}
    for result in results:
        for monitor in result.monitors:
            margin = monitor.margin
            if margin is not None and margin < margins.get(monitor.name, math.inf):
                margins[monitor.name] = margin
                worst[monitor.name] = result.case_id
    return Cell(
        bins=bins,
        cases=len(results),
        conclusive=sum(result.verdict in CONCLUSIVE for result in results),
        failed=sum(result.verdict is Verdict.FAIL for result in results),
        margins=margins,
        worst=worst,
    )


def _named(axes: Sequence[Axis], chosen: Sequence[int], spot: Sequence[int]) -> dict[str, str]:
    return {
        axes[axis].key: axes[axis].bins[place] for axis, place in zip(chosen, spot, strict=True)
    }


def _label(value: Any) -> str:
    if isinstance(value, str):
        return value
    return f"{value:.12g}" if _is_number(value) else msgspec.json.encode(value).decode()


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
