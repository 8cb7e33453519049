"""Figures of a control law over some cases: stops with their confidence, time, comfort."""

import re
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Final

import msgspec

from firmware_py.settings import SettingsError
from metro_hil.model.case import Case, CaseResult
from metro_hil.report.estimates import ConfidenceInterval, cluster_mean_with_interval, pass_share
from vobc.config import load_config

LAW: Final = "ato.strategy"
DEFAULT_LAW: Final = "predictive"
STOP_ERROR: Final = re.compile(r"stop_.+_error_m")
STOP_BOUND: Final = re.compile(r"stop_.+_bound_m")
OVER_FASTEST: Final = re.compile("over_fastest_total_ratio")
RUN: Final = re.compile("run_time_s")
TOLERANCE_M: Final = 0.10
"""Stopping tolerance of [Allotta 2013], table 1."""
COMFORT: Final = (
    "commanded_accel_max_mps2",
    "commanded_jerk_max_mps3",
    "felt_accel_max_mps2",
    "felt_jerk_1s_mps3",
    "felt_jerk_2hz_mps3",
)
ALSO: Final = ("jerk_max_mps3", "notch_changes_max_count", "en12299_index_ratio")
"""Measures whose greatest values documents publish besides comfort."""
PROBE: Final = re.compile("|".join((STOP_ERROR.pattern, RUN.pattern, *COMFORT, *ALSO)))
"""Measures that a repeated case gives digit by digit, as long as published figures hold."""

Pairs = Sequence[tuple[Case, CaseResult | None]]
RESULTS: Final = "law_results.json"
"""File of this package with the published figures of each law and scenario."""


class LawFigures(msgspec.Struct, frozen=True, kw_only=True):
    """Figures of one law over some cases; None where no case gives a value."""

    cases: int
    lacking: int
    """Number of cases without a result."""
    stops: int
    """Number of stops in the timetables of the cases with a result."""
    missed: int
    """Number of stations near which the train never stood."""
    mean_m: float | None
    """Mean of |stop error|."""
    mean_low_m: float | None
    mean_high_m: float | None
    """95 % interval of the mean by bootstrap over seeds, because the stops of one run, and the runs
    of one seed, depend on each other."""
    worst_m: float | None
    """Stop error of greatest magnitude, positive beyond the stopping point."""
    within_ratio: float | None
    """Share of stops within 10 cm; a missed one counts as outside."""
    within_low_ratio: float | None
    """Lower bound of that share by Clopper–Pearson, two-sided 95 %; it counts each seed once."""
    run_s: float | None
    """Mean duration of a run, including dwells and jogs."""
    comfort: dict[str, float | None]
    """Greatest value over all cases, by measure."""
    bound_m: float | None = None
    """Mean over the stops of the bound that the controller has of its position error there."""
    over_ratio: float | None = None
    """Mean excess of the running times over the shortest possible ones, see
    `metrics.fastest_run`."""
    load_means_m: dict[str, float] = {}
    """Mean of |stop error| by load, where the loads of the cases differ."""


class Probe(msgspec.Struct, frozen=True, kw_only=True):
    """One measured case with its results, to be repeated later as a check."""

    case_id: str
    measures: dict[str, float | None]


class ScenarioFigures(msgspec.Struct, frozen=True, kw_only=True):
    """Figures of one law in one scenario of a campaign that was run."""

    campaign: str
    title: str
    figures: LawFigures
    sources: str = ""
    """Hash of the measured sources; empty if unknown."""
    probes: tuple[Probe, ...] = ()
    """The first case, and the one with the worst stop."""


Results = dict[str, dict[str, ScenarioFigures]]
"""Figures by law and by scenario."""


def law_of(case: Case) -> str:
    """The control law that drives the train of a case: the case's own, or that of its
    parameters."""
    told = case.setup.believed.get(LAW)
    return _law_of_parameters(case.setup.params) if told is None else str(told)


@cache
def _law_of_parameters(name: str) -> str:
    """Law of a shipped parameter file; a file of the user is not available when results are
    read."""
    try:
        return load_config(name).ato.strategy
    except SettingsError:
        return DEFAULT_LAW


def by_law(pairs: Pairs) -> dict[str, Pairs]:
    """Pairs by law, in the order in which the campaign names the laws."""
    laws: dict[str, list[tuple[Case, CaseResult | None]]] = {}
    for case, result in pairs:
        laws.setdefault(law_of(case), []).append((case, result))
    return dict(laws)


def figures_of(pairs: Pairs) -> LawFigures:
    """Figures over all these cases together."""
    stops = [at_m for _, result in pairs if result is not None for at_m in stops_m(result)]
    known = [at_m for at_m in stops if at_m is not None]
    mean = mean_error_m(pairs)
    within = sum(abs(at_m) <= TOLERANCE_M for at_m in known)
    seeds = len({case.seed for case, result in pairs if result is not None})
    # Stops of one seed say little more than one stop, so they count as one.
    share = pass_share(seeds * within // len(stops), seeds) if stops else None
    runs_s, bounds_m = _measured(pairs, RUN), _measured(pairs, STOP_BOUND)
    over = _measured(pairs, OVER_FASTEST)
    return LawFigures(
        cases=len(pairs),
        lacking=sum(result is None for _, result in pairs),
        stops=len(stops),
        missed=len(stops) - len(known),
        mean_m=None if mean is None else mean.best,
        mean_low_m=None if mean is None else mean.low,
        mean_high_m=None if mean is None else mean.high,
        worst_m=max(known, key=abs, default=None),
        within_ratio=within / len(stops) if stops else None,
        within_low_ratio=None if share is None else share.low,
        run_s=sum(runs_s) / len(runs_s) if runs_s else None,
        comfort={
            name: max(_measured(pairs, re.compile(name)), default=None)
            for name in (*COMFORT, *ALSO)
        },
        bound_m=sum(bounds_m) / len(bounds_m) if bounds_m else None,
        over_ratio=sum(over) / len(over) if over else None,
        load_means_m=_load_means_m(pairs),
    )


def _load_means_m(pairs: Pairs) -> dict[str, float]:
    """Mean |stop error| by load; empty if all cases have one load."""
    errors_m: dict[float, list[float]] = {}
    for case, result in pairs:
        known = [abs(at_m) for at_m in (stops_m(result) if result else []) if at_m is not None]
        if case.setup.load_ratio is not None:
            errors_m.setdefault(case.setup.load_ratio, []).extend(known)
    means_m = {f"{load:g}": sum(own) / len(own) for load, own in sorted(errors_m.items()) if own}
    return means_m if len(means_m) > 1 else {}


def probes_of(pairs: Pairs) -> tuple[Probe, ...]:
    """The first case with a result and the one with the worst stop, which may be the same."""
    back = [(case, result) for case, result in pairs if result is not None]
    if not back:
        return ()
    worst = max(back, key=lambda pair: _worst_m(pair[1]))
    chosen = {case.id: result for case, result in (back[0], worst)}
    return tuple(
        Probe(case_id=case_id, measures=probed(result)) for case_id, result in chosen.items()
    )


def probed(result: CaseResult) -> dict[str, float | None]:
    """The measures of a probe, rounded to the published digits."""
    return {
        name: None if value is None else _rounded(value)
        for name, value in result.measures.items()
        if PROBE.fullmatch(name)
    }


def _worst_m(result: CaseResult) -> float:
    return max((abs(at_m) for at_m in stops_m(result) if at_m is not None), default=0.0)


def stops_m(result: CaseResult) -> list[float | None]:
    """Stop error at every station of the timetable; None for a missed one."""
    return [value for name, value in result.measures.items() if STOP_ERROR.fullmatch(name)]


def mean_error_m(pairs: Pairs) -> ConfidenceInterval | None:
    """Mean |stop error| of the stops that were made, with its interval by resampling seeds."""
    by_seed: dict[int, list[float]] = {}
    for case, result in pairs:
        known = [abs(at_m) for at_m in (stops_m(result) if result else []) if at_m is not None]
        by_seed.setdefault(case.seed, []).extend(known)
    return cluster_mean_with_interval([own for own in by_seed.values() if own])


def _measured(pairs: Pairs, name: re.Pattern[str]) -> list[float]:
    return [
        value
        for _, result in pairs
        if result is not None
        for key, value in result.measures.items()
        if value is not None and name.fullmatch(key)
    ]


def results_of(campaign: str, pairs: Pairs, *, sources: str = "") -> Results:
    """Figures of a campaign that was run, for each scenario.

    Args:
        sources: hash of the sources that ran it, if known.
    """
    found: Results = {}
    for law, own in by_law(pairs).items():
        for scenario in dict.fromkeys(case.scenario for case, _ in own):
            of = [pair for pair in own if pair[0].scenario == scenario]
            found.setdefault(law, {})[scenario] = ScenarioFigures(
                campaign=campaign,
                title="",
                figures=figures_of(of),
                sources=sources,
                probes=probes_of(of),
            )
    return found


def merged_results(before: Results, news: Results) -> Results:
    """Replace older figures by newer ones of the same law and scenario."""
    return {law: {**before.get(law, {}), **news.get(law, {})} for law in sorted({*before, *news})}


def titled(results: Results, titles: Mapping[str, str]) -> Results:
    """Add titles by scenario; leave out scenarios without one, which are no longer shipped."""
    return {
        law: {
            name: msgspec.structs.replace(each, title=titles[name])
            for name, each in sorted(own.items())
            if name in titles
        }
        for law, own in results.items()
    }


def read_results(text: str) -> Results:
    return msgspec.json.decode(text, type=Results)


def results_json(results: Results) -> str:
    """JSON with numbers of four digits; equal campaigns give equal bytes on any day."""
    plain = _short(msgspec.to_builtins(results))
    return msgspec.json.format(msgspec.json.encode(plain), indent=1).decode() + "\n"


def _short(value: object) -> object:
    if isinstance(value, dict):
        return {name: _short(item) for name, item in value.items()}
    return _rounded(value) if isinstance(value, float) else value


def _rounded(value: float) -> float:
    return float(f"{value:.4g}")
