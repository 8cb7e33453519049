"""A board of lines and trains: how each train ran each line, one row for each pair."""

import math
from collections.abc import Callable, Sequence
from typing import Final

from metro_hil.model.case import Case, CaseResult, MonitorResult
from metro_hil.report.layouts.tables import LayoutCell, LayoutTable

MARGIN: Final = "margin to the emergency curve"
"""Name of the monitor whose margin the board shows."""
CM_PER_M: Final = 100.0
KMH_PER_MPS: Final = 3.6
PERCENT: Final = 100.0
M_PER_KM: Final = 1000.0
UNKNOWN: Final = "–"

Pair = tuple[Case, CaseResult | None]


def lines_tables(pairs: Sequence[Pair]) -> list[LayoutTable]:
    """The board. A case that did not run, or a value that was not measured, shows a dash."""
    head = ("line", "train", *(name for name, _ in COLUMNS))
    of: dict[tuple[str, str], list[CaseResult | None]] = {}
    for case, result in pairs:
        line = case.setup.line.removesuffix(".toml").replace(".toml:", ":")
        pair = (line, case.setup.consist.removesuffix(".toml"))
        of.setdefault(pair, []).append(result)
    rows = [
        tuple(
            LayoutCell(text)
            for text in (*pair, *(text_of([r for r in runs if r]) for _, text_of in COLUMNS))
        )
        for pair, runs in of.items()
    ]
    title = "Lines and trains"
    return [LayoutTable(title, (tuple(map(LayoutCell, head)),), tuple(rows), REMARKS)]


def _worst(measure: str, factor: float = 1.0, form: str = ".1f") -> Callable[..., str]:
    def text(results: Sequence[CaseResult]) -> str:
        found = [value for r in results if (value := r.measures.get(measure)) is not None]
        return format(max(found) * factor, form) if found else UNKNOWN

    return text


def _total(measure: str) -> Callable[..., str]:
    def text(results: Sequence[CaseResult]) -> str:
        found = [value for r in results if (value := r.measures.get(measure)) is not None]
        return f"{math.fsum(found):.0f}" if found else UNKNOWN

    return text


def _stops(results: Sequence[CaseResult]) -> str:
    """Stops made of all stops; a result without either measured nothing."""
    made = [r.measures.get("stops_made_count") for r in results]
    missed = [r.measures.get("stops_missed_count") for r in results]
    known = [(m, n) for m, n in zip(made, missed, strict=True) if m is not None and n is not None]
    if not known:
        return UNKNOWN
    reached = sum(m for m, _ in known)
    return f"{reached:.0f}/{reached + sum(n for _, n in known):.0f}"


def _margin_kmh(results: Sequence[CaseResult]) -> str:
    """Least distance of the speed to the emergency curve."""
    margins = [
        monitor.margin
        for result in results
        for monitor in result.monitors
        if _is_margin(monitor) and monitor.margin is not None
    ]
    return f"{min(margins) * KMH_PER_MPS:.1f}" if margins else UNKNOWN


def _is_margin(monitor: MonitorResult) -> bool:
    return monitor.name == MARGIN


def _running_s(results: Sequence[CaseResult]) -> str:
    """Mean over the runs of the sum of running times between stops."""
    sums = [
        math.fsum(times)
        for result in results
        if (
            times := [
                value
                for name, value in result.measures.items()
                if name.startswith("stop_") and name.endswith("_run_s") and value is not None
            ]
        )
    ]
    return f"{math.fsum(sums) / len(sums):.0f}" if sums else UNKNOWN


def _per_km(results: Sequence[CaseResult]) -> str:
    """Net energy at the collector for each kilometre."""
    found = [
        (drawn - returned) / distance_m * M_PER_KM
        for r in results
        if (drawn := r.measures.get("energy_drawn_kwh")) is not None
        and (returned := r.measures.get("energy_returned_kwh")) is not None
        and (distance_m := r.measures.get("distance_m"))
    ]
    return f"{math.fsum(found) / len(found):.1f}" if found else UNKNOWN


COLUMNS: Final[tuple[tuple[str, Callable[..., str]], ...]] = (
    ("stops", _stops),
    ("doors\nshut", _total("doors_shut_count")),
    ("stranded", _total("stranded_count")),
    ("error\nmean, cm", _worst("stop_error_mean_m", CM_PER_M)),
    ("error\nworst, cm", _worst("stop_error_worst_m", CM_PER_M)),
    ("jerk\nm/s³", _worst("jerk_max_mps3", form=".2f")),
    ("running\ntime, s", _running_s),
    ("over the\nshortest, %", _worst("over_fastest_total_ratio", PERCENT)),
    ("margin\nkm/h", _margin_kmh),
    ("energy\nkWh/km", _per_km),
)
REMARKS: Final = (
    "doors shut: stops with a dwell time at which no door opened; stranded: trains left standing.",
    "stops: made of all; error: distance from the stopping point at the first standstill.",
    "jerk: greatest, of the whole train, low-passed at 2 Hz.",
    "shortest: between stops under the limits of speed, acceleration and jerk, without resistance.",
    "margin: least distance of the speed to the emergency curve.",
    "energy: drawn less returned at the collector. The worst of several runs; times, energy: mean.",
)
