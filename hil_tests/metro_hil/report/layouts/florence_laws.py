"""All control laws of the Florence campaign side by side, with the paper's own figures."""

from collections.abc import Mapping
from typing import Final

from metro_hil.report.law_figures import COMFORT, LawFigures, Pairs, figures_of
from metro_hil.report.layouts.tables import LayoutCell, LayoutTable

CM_PER_M: Final = 100.0
TABLES: Final = ("table-7", "table-8", "table-9")
COMFORT_ROWS: Final = (
    "asked for, m/s²",
    "asked for, m/s³",
    "felt in the worst car, m/s²",
    "felt over 1 s, m/s³",
    "felt at 2 Hz, m/s³",
)
PAPER: Final[Mapping[str, str]] = {
    "table 7, mean cm": "0.82",
    "table 8, mean cm": "3.36",
    "table 9, mean cm": "3.12",
    "within 10 cm": "all",
    "asked for, m/s²": "0.80",
    "asked for, m/s³": "0.60",
}
"""Figures of the paper. Means of tables 8 and 9 are over the three loads; acceleration and jerk are
the paper's limits."""


def of_scenario(pairs: Pairs, name: str) -> Pairs:
    """Pairs of the scenario with this name, or of its variants for single laws."""
    return [
        pair
        for pair in pairs
        if pair[0].scenario == name or pair[0].scenario.startswith(f"{name}-")
    ]


def interval_words(figures: LawFigures) -> str:
    """Text of the mean's interval without the mean itself; a dash if it says nothing."""
    low_m, high_m = figures.mean_low_m, figures.mean_high_m
    if low_m is None or high_m is None or low_m == high_m:
        return "–"
    return f"{low_m * CM_PER_M:.2f}–{high_m * CM_PER_M:.2f}"


def ride_words(pairs: Pairs) -> str:
    """Sentence with the greatest acceleration and jerk over all these cases."""
    accel, jerk, felt, second, slope = _comfort(figures_of(pairs))
    return (
        f"At most: asked for {accel} m/s² and {jerk} m/s³; felt in the worst car {felt} m/s², "
        f"{second} m/s³ over 1 s, {slope} m/s³ at 2 Hz."
    )


def summary_table(laws: Mapping[str, Pairs]) -> LayoutTable:
    """A column for each law: means, worst stop, share within 10 cm, time, comfort."""
    columns = {law: _column(pairs) for law, pairs in laws.items()}
    names = list(next(iter(columns.values())))
    head = (LayoutCell("|stop error| and ride"), *(LayoutCell(law) for law in laws))
    rows = tuple(
        (
            LayoutCell(name),
            *(LayoutCell(column[name]) for column in columns.values()),
            LayoutCell(PAPER.get(name, "")),
        )
        for name in names
    )
    return LayoutTable("All laws", ((*head, LayoutCell("paper")),), rows, tuple(_remarks(laws)))


def _column(pairs: Pairs) -> dict[str, str]:
    """Cells of one law, by the name of the row."""
    said: dict[str, str] = {}
    for table in TABLES:
        figures = figures_of(of_scenario(pairs, table))
        name = table.replace("-", " ")
        said[f"{name}, mean cm"] = _number(figures.mean_m, ".2f", CM_PER_M)
        said[f"{name}, 95 %"] = interval_words(figures)
    own = [pair for name in TABLES for pair in of_scenario(pairs, name)]
    # A law without a table, such as one that only demonstrates a failure, shows all its cases.
    figures = figures_of(own or pairs)
    said["stops"] = str(figures.stops)
    said["worst, cm"] = _number(figures.worst_m, "+.1f", CM_PER_M)
    said["within 10 cm"] = _percent(figures.within_ratio)
    said["at least, 95 %"] = _percent(figures.within_low_ratio)
    said["bound, cm"] = _number(figures.bound_m, ".1f", CM_PER_M)
    said["whole line, s"] = _number(figures.run_s, ".1f")
    said["over the shortest run"] = _percent(figures.over_ratio)
    said.update(zip(COMFORT_ROWS, _comfort(figures), strict=True))
    return said


def _number(value: float | None, form: str, scale: float = 1.0) -> str:
    return "–" if value is None else format(value * scale, form)


def _percent(ratio: float | None) -> str:
    """Per cent, never rounded up to 100."""
    if ratio is None:
        return "–"
    return f"{ratio * 100.0:.1f} %" if ratio == 1.0 or ratio < 0.9995 else "> 99.9 %"


def _comfort(figures: LawFigures) -> list[str]:
    values = [figures.comfort[name] for name in COMFORT]
    return ["–" if value is None else f"{value:.2f}" for value in values]


def _remarks(laws: Mapping[str, Pairs]) -> list[str]:
    lines = [
        "Intervals of means: bootstrap over seeds, 95 %. Share within 10 cm: least share by "
        "Clopper–Pearson, two-sided 95 %, a missed station counted as outside.",
        "Whole line: mean, dwells included. Acceleration and jerk: the greatest of all runs.",
    ]
    for law, pairs in laws.items():
        lacking = sum(result is None for _, result in pairs)
        if lacking:
            lines.append(f"Incomplete: {law}, {lacking} of {len(pairs)} cases without a result.")
        if not any(of_scenario(pairs, name) for name in TABLES):
            names = ", ".join(dict.fromkeys(case.scenario for case, _ in pairs))
            lines.append(f"{law}: in no table; its figures are those of {names}.")
    return lines
