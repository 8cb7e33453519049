"""All control laws of the Florence campaign side by side, beside what the paper says of its own."""

from collections.abc import Mapping
from typing import Final

from metro_hil.report.law_figures import COMFORT, LawFigures, Pairs, figures_of
from metro_hil.report.layouts.tables import LayoutCell, LayoutTable

CM_PER_M: Final = 100.0
TABLES: Final = ("table-7", "table-8", "table-9")
HEADS: Final = ("worst, cm", "within 10 cm [at least]", "hop, s", "m/s²", "m/s³", "m/s²")
HEADS_JERK: Final = ("m/s³, 1 s", "m/s³, 2 Hz")
PAPER: Final = ("0.82", "3.36", "3.12", "", "all, on average", "", "0.80", "0.60", "", "", "")
"""Means of tables 8 and 9 over the three loads; acceleration and jerk are those it is held to."""


def of_scenario(pairs: Pairs, name: str) -> Pairs:
    """Of the scenario with this name, or of those that are it for one law each."""
    return [
        pair
        for pair in pairs
        if pair[0].scenario == name or pair[0].scenario.startswith(f"{name}-")
    ]


def interval_words(figures: LawFigures) -> str:
    """Of the mean, without its best guess; a dash where it says nothing."""
    low_m, high_m = figures.mean_low_m, figures.mean_high_m
    if low_m is None or high_m is None or low_m == high_m:
        return "–"
    return f"{low_m * CM_PER_M:.2f}–{high_m * CM_PER_M:.2f}"


def ride_words(pairs: Pairs) -> str:
    """Greatest acceleration and jerk of all these cases."""
    accel, jerk, felt, second, slope = _comfort(figures_of(pairs))
    return (
        f"At most: asked for {accel} m/s² and {jerk} m/s³; felt in the worst car {felt} m/s², "
        f"{second} m/s³ over 1 s, {slope} m/s³ at 2 Hz."
    )


def summary_table(laws: Mapping[str, Pairs]) -> LayoutTable:
    """A row for each law: means of the tables, worst stop, share within 10 cm, time, comfort."""
    blank = LayoutCell("")
    wide = (
        LayoutCell("law"),
        LayoutCell("mean |stop error|, cm [95 %]", span=3),
        *(blank, blank, blank),
        LayoutCell("asked for", span=2),
        LayoutCell("felt in the worst car", span=3),
    )
    tables = (f"table {name[-1]}" for name in TABLES)
    narrow = (blank, *(LayoutCell(text) for text in (*tables, *HEADS, *HEADS_JERK)))
    paper = (LayoutCell("paper"), *(LayoutCell(text) for text in PAPER))
    rows = (*(_row(law, pairs) for law, pairs in laws.items()), paper)
    return LayoutTable("All laws", (wide, narrow), rows, tuple(_remarks(laws)))


def _row(law: str, pairs: Pairs) -> tuple[LayoutCell, ...]:
    own = [pair for name in TABLES for pair in of_scenario(pairs, name)]
    # What is in no table, such as a law that is only shown failing, speaks for itself.
    figures = figures_of(own or pairs)
    means = [_mean_words(figures_of(of_scenario(pairs, name))) for name in TABLES]
    worst = "–" if figures.worst_m is None else f"{figures.worst_m * CM_PER_M:+.1f}"
    hop = "–" if figures.hop_s is None else f"{figures.hop_s:.1f}"
    texts = (law, *means, worst, _share_words(figures), hop, *_comfort(figures))
    return tuple(LayoutCell(text) for text in texts)


def _mean_words(figures: LawFigures) -> str:
    if figures.mean_m is None:
        return "–"
    sure = interval_words(figures)
    return f"{figures.mean_m * CM_PER_M:.2f}" + ("" if sure == "–" else f" [{sure}]")


def _share_words(figures: LawFigures) -> str:
    share, low = figures.within_ratio, figures.within_low_ratio
    if share is None or low is None:
        return "–"
    return f"{share * 100.0:.1f} % of {figures.stops} [{low * 100.0:.1f} %]"


def _comfort(figures: LawFigures) -> list[str]:
    values = [figures.comfort[name] for name in COMFORT]
    return ["–" if value is None else f"{value:.2f}" for value in values]


def _remarks(laws: Mapping[str, Pairs]) -> list[str]:
    lines = [
        "Intervals of means: bootstrap over runs, 95 %. Share within 10 cm: least share by "
        "Clopper–Pearson, two-sided 95 %, a missed station counted as outside.",
        "Hop: mean time from standstill to standstill. Acceleration and jerk: the greatest of all "
        "runs.",
    ]
    for law, pairs in laws.items():
        lacking = sum(result is None for _, result in pairs)
        if lacking:
            lines.append(f"Incomplete: {law}, {lacking} of {len(pairs)} cases without a result.")
        if not any(of_scenario(pairs, name) for name in TABLES):
            names = ", ".join(dict.fromkeys(case.scenario for case, _ in pairs))
            lines.append(f"{law}: in no table; its figures are those of {names}.")
    return lines
