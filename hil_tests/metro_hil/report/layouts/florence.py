"""Tables 7, 8 and 9 of [Allotta 2013] beside the same figures of a campaign, law by law."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from metro_hil.model.case import Case, CaseResult
from metro_hil.report.law_figures import by_law, figures_of
from metro_hil.report.layouts.florence_laws import (
    interval_words,
    of_scenario,
    ride_words,
    summary_table,
)
from metro_hil.report.layouts.tables import LayoutCell, LayoutTable, Mark

STATIONS: Final = ("I", "II", "III", "IV")
CM_PER_M: Final = 100.0
TOLERANCE_CM: Final = 10.0
"""Stopping tolerance of the paper's table 1, cm."""
LOADS: Final = (0.0, 0.5, 1.0)
ERRORS: Final = (-0.01, 0.0, 0.01, 0.02, 0.03, 0.04, 0.05)
"""Odometer errors of the paper's tables 8 and 9: -1 to +5 %."""

TABLE_7_CM: Final = (1.01, -0.006, -1.7, -0.564)
TABLE_7_MEAN_CM: Final = 0.824
"""The mean of the magnitudes is 0.820; the paper prints 0,824."""
Station = Mapping[float, tuple[float, float, float, float]]
TABLE_8_CM: Final[Station] = {
    0.0: (3.21, 2.24, 5.47, 3.36),
    0.5: (4.46, 2.72, 2.66, 2.83),
    1.0: (4.25, 1.94, 3.61, 3.59),
}
TABLE_8_LOAD_CM: Final = {0.0: 3.57, 0.5: 3.17, 1.0: 3.35}
"""The paper prints 35 for full load; its own stations give 3.35."""
TABLE_9_CM: Final[Station] = {
    0.0: (3.90, 3.93, 3.62, 3.54),
    0.5: (3.11, 2.86, 2.67, 2.86),
    1.0: (2.98, 2.49, 2.70, 2.83),
}
TABLE_9_LOAD_CM: Final = {0.0: 3.75, 0.5: 2.87, 1.0: 2.75}
SAME_CM: Final = 0.005
"""Half of the last digit that the paper prints, cm; smaller differences count as equal."""

Pairs = Sequence[tuple[Case, CaseResult | None]]


@dataclass(frozen=True, slots=True)
class Mean:
    """A mean of stop errors, and how many of its stops are known."""

    error_m: float | None
    stops: int
    """Number of stops that the mean should cover."""
    known: int

    @property
    def cm(self) -> float | None:
        return None if self.error_m is None else self.error_m * CM_PER_M

    @property
    def whole(self) -> bool:
        return 0 < self.stops == self.known


def florence_tables(pairs: Pairs) -> list[LayoutTable]:
    """Tables of each control law that the campaign has, then all laws side by side.

    A table covers the scenario `table-7`, `table-8` or `table-9`, or those whose names begin with
    it.
    """
    laws = by_law(pairs)
    tables = [table for law, own in laws.items() for table in _tables_of(law, own)]
    return [*tables, summary_table(laws)] if laws else []


def _tables_of(law: str, pairs: Pairs) -> list[LayoutTable]:
    of = {n: of_scenario(pairs, f"table-{n}") for n in ("7", "8", "9")}
    tables = []
    if of["7"]:
        title = f"{law}, table 7: stop error, ideal case, full load, cm"
        tables.append(_table_7(title, of["7"]))
    if of["8"]:
        title = f"{law}, table 8: stop error with a fixed brake delay of 1 s, "
        title += "mean over odometer errors, cm"
        tables.append(_table_by_load(title, of["8"], TABLE_8_CM, TABLE_8_LOAD_CM))
    if of["9"]:
        title = f"{law}, table 9: stop error with random brake delay, mean over odometer errors, cm"
        tables.append(_table_by_load(title, of["9"], TABLE_9_CM, TABLE_9_LOAD_CM))
    return tables


def _table_7(title: str, pairs: Pairs) -> LayoutTable:
    """Like the paper, the errors have signs, and the mean is that of magnitudes."""
    signed = [_mean(pairs, station, magnitude=False) for station in STATIONS]
    sizes = [_mean(pairs, station, magnitude=True) for station in STATIONS]
    overall = _join(sizes)
    ours = [
        LayoutCell(_signed(shown), _mark(size, abs(paper)))
        for shown, size, paper in zip(signed, sizes, TABLE_7_CM, strict=True)
    ]
    theirs = [LayoutCell(f"{paper:+.3g}") for paper in TABLE_7_CM]
    mean = LayoutCell(_plain(overall), _mark(overall, TABLE_7_MEAN_CM))
    rows = (
        (LayoutCell("this campaign"), *ours, mean),
        (LayoutCell("paper"), *theirs, LayoutCell(f"{TABLE_7_MEAN_CM:.3f}")),
    )
    compared = [
        (f"station {station}", size, abs(paper))
        for station, size, paper in zip(STATIONS, sizes, TABLE_7_CM, strict=True)
    ]
    verdicts = _verdicts(compared, [("mean", overall, TABLE_7_MEAN_CM)])
    remarks = (*verdicts, *_worst(pairs), ride_words(pairs))
    head = (LayoutCell(""), *(LayoutCell(f"station {name}") for name in STATIONS))
    return LayoutTable(title, ((*head, LayoutCell("mean |error|")),), rows, remarks)


def _table_by_load(
    title: str, pairs: Pairs, paper: Station, paper_load: Mapping[float, float]
) -> LayoutTable:
    ours: list[LayoutCell] = [LayoutCell("mean station, this campaign")]
    theirs: list[LayoutCell] = [LayoutCell("mean station, paper")]
    ours_load: list[LayoutCell] = [LayoutCell("mean load, this campaign")]
    theirs_load: list[LayoutCell] = [LayoutCell("mean load, paper")]
    sure: list[str] = []
    stations: list[tuple[str, Mean, float]] = []
    loads: list[tuple[str, Mean, float]] = []
    for load_ratio in LOADS:
        loaded = [pair for pair in pairs if _near(_load_ratio(pair[0]), load_ratio)]
        lacking = len(_lacking_errors(loaded))
        means = [_mean(loaded, name, magnitude=True, lacking=lacking) for name in STATIONS]
        for station, mean, paper_cm in zip(STATIONS, means, paper[load_ratio], strict=True):
            ours.append(LayoutCell(_plain(mean), _mark(mean, paper_cm)))
            theirs.append(LayoutCell(f"{paper_cm:.2f}"))
            stations.append((f"station {station} at {load_ratio * 100:.0f} %", mean, paper_cm))
        overall = _join(means)
        paper_cm = paper_load[load_ratio]
        ours_load.append(LayoutCell(_plain(overall), _mark(overall, paper_cm), len(STATIONS)))
        theirs_load.append(LayoutCell(f"{paper_cm:.2f}", span=len(STATIONS)))
        sure.append(f"{load_ratio * 100:.0f} % {interval_words(figures_of(loaded))}")
        loads.append((f"load {load_ratio * 100:.0f} %", overall, paper_cm))
    wide = (
        LayoutCell("passengers"),
        *(LayoutCell(f"{load_ratio * 100:.0f} %", span=len(STATIONS)) for load_ratio in LOADS),
    )
    narrow = (LayoutCell("station"), *(LayoutCell(name) for _ in LOADS for name in STATIONS))
    remarks = (
        *_verdicts(stations, loads),
        f"Mean load, 95 %, cm: {', '.join(sure)}.",
        *_worst(pairs),
        *_errors_covered(pairs),
        ride_words(pairs),
    )
    rows = (tuple(ours), tuple(theirs), tuple(ours_load), tuple(theirs_load))
    return LayoutTable(title, (wide, narrow), rows, remarks)


def _mean(pairs: Pairs, station: str, *, magnitude: bool, lacking: int = 0) -> Mean:
    """Mean over the pairs; `lacking` counts further stops for which no case exists."""
    found = [_error_m(result, station) for _, result in pairs]
    known = [abs(error) if magnitude else error for error in found if error is not None]
    return Mean(sum(known) / len(known) if known else None, len(found) + lacking, len(known))


def _error_m(result: CaseResult | None, station: str) -> float | None:
    return None if result is None else result.measures.get(f"stop_{station}_error_m")


def _join(means: Sequence[Mean]) -> Mean:
    """Mean over stations of equal weight, as in the paper."""
    stops, known = sum(mean.stops for mean in means), sum(mean.known for mean in means)
    if any(mean.error_m is None for mean in means):
        return Mean(None, stops, known)
    return Mean(sum(mean.error_m or 0.0 for mean in means) / len(means), stops, known)


def _load_ratio(case: Case) -> float | None:
    value = case.factors.get("train.load_ratio", case.setup.load_ratio)
    return None if value is None else float(value)


def _odometer_error(case: Case) -> float | None:
    value = case.factors.get("train.odometer_error", case.setup.odometer_error)
    return None if value is None else float(value)


def _near(value: float | None, wanted: float) -> bool:
    return value is not None and abs(value - wanted) < 1e-9


def _mark(ours: Mean, paper_cm: float) -> Mark:
    if ours.cm is None or not ours.whole:
        return Mark.INCOMPLETE
    if abs(ours.cm - paper_cm) <= SAME_CM:
        return Mark.NONE
    return Mark.BETTER if ours.cm < paper_cm else Mark.WORSE


def _plain(mean: Mean) -> str:
    return "–" if mean.cm is None else f"{mean.cm:.2f}"


def _signed(mean: Mean) -> str:
    return "–" if mean.cm is None else f"{mean.cm:+.2f}"


def _verdicts(
    parts: Sequence[tuple[str, Mean, float]], wholes: Sequence[tuple[str, Mean, float]]
) -> list[str]:
    """Sentences that say where this campaign is better and where it is worse."""
    lines = []
    marks = [_mark(mean, paper_cm) for _, mean, paper_cm in parts]
    said = [
        f"{marks.count(mark)} {mark.value}" for mark in (Mark.BETTER, Mark.WORSE, Mark.INCOMPLETE)
    ]
    lines.append(
        f"Against the paper, of {len(parts)} stations' figures: {', '.join(said)}, "
        f"{marks.count(Mark.NONE)} the same."
    )
    for name, mean, paper_cm in (*parts, *wholes):
        if _mark(mean, paper_cm) is Mark.WORSE:
            lines.append(f"Worse: {name}, {_plain(mean)} cm against {paper_cm:.2f} cm.")
    lines += [
        f"Incomplete: {name}, only {mean.known} of {mean.stops} stops known."
        for name, mean, paper_cm in wholes
        if _mark(mean, paper_cm) is Mark.INCOMPLETE
    ]
    better = [
        f"{name} {_plain(mean)} against {paper_cm:.2f} cm"
        for name, mean, paper_cm in wholes
        if _mark(mean, paper_cm) is Mark.BETTER
    ]
    if better:
        lines.append(f"Better in the mean: {', '.join(better)}.")
    return lines


def _worst(pairs: Pairs) -> list[str]:
    """Sentences about the farthest stop, which a mean may hide."""
    stops = [
        (abs(error) * CM_PER_M, case.id, station, error * CM_PER_M)
        for case, result in pairs
        for station in STATIONS
        if (error := _error_m(result, station)) is not None
    ]
    if not stops:
        return ["No stop is known."]
    size_cm, case_id, station, cm = max(stops, key=lambda stop: (stop[0], stop[1], stop[2]))
    outside = sum(stop[0] > TOLERANCE_CM for stop in stops)
    return [
        f"Farthest of {len(stops)} stops: {cm:+.2f} cm at station {station} in {case_id}; "
        f"{outside} beyond ±{TOLERANCE_CM:.0f} cm."
        + ("" if size_cm <= TOLERANCE_CM else " The paper allows none.")
    ]


def _errors_covered(pairs: Pairs) -> list[str]:
    """Remarks on missing odometer errors; the paper's mean covers seven, so others do not
    compare."""
    lines = []
    for load_ratio in LOADS:
        loaded = [pair for pair in pairs if _near(_load_ratio(pair[0]), load_ratio)]
        lacking = [f"{error * 100:+.0f} %" for error in _lacking_errors(loaded)]
        if lacking:
            lines.append(
                f"Not comparable at {load_ratio * 100:.0f} %: no case with an odometer error of "
                f"{', '.join(lacking)}."
            )
    return lines


def _lacking_errors(pairs: Pairs) -> list[float]:
    have = [_odometer_error(case) for case, _ in pairs]
    return [error for error in ERRORS if not any(_near(known, error) for known in have)]
