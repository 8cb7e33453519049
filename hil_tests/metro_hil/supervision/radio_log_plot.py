"""Plots a line's radio: latency and age of each train's authorities, and the terms."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from firmware_py.storage.whole_file import whole_file
from metro_hil.supervision.radio_log import RadioFigures

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH_IN: Final = 12.0
HEIGHT_IN: Final = 9.0
STYLES: Final = ("-", "--", "-.", ":")
APART_PT: Final = 3.0
"""Vertical distance between the lines of two areas under the same term."""
FONT_PT: Final = 8.0
LABEL_PT: Final = (20.0, 11.0)
"""Width and height of a train's name."""
ABOVE_PT: Final = 5.0
LEVELS: Final = 8
"""Number of names above each other; if more trains took over at once some are left out."""
PT_PER_IN: Final = 72.0
NAMES_MAX: Final = 14
"""Maximum number of names in one column of a legend."""


def draw(figures: RadioFigures, path: Path, title: str) -> None:
    """Draw the plot. Raises OSError, and ValueError for a file ending without an image format."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure = picture(figures, title)
    try:
        with whole_file(path) as part:
            figure.savefig(part)
    finally:
        plt.close(figure)


def picture(figures: RadioFigures, title: str) -> "Figure":
    import matplotlib.pyplot as plt

    figure, (latency, age, terms) = plt.subplots(
        3, 1, sharex=True, figsize=(WIDTH_IN, HEIGHT_IN), layout="constrained"
    )
    for number, train in sorted(figures.trains.items()):
        name = f"T{number}"
        latency.plot(train.at_s, train.latency_ms, ".", markersize=3, label=name)
        age.plot(train.at_s, train.age_ms, ".", markersize=3, label=name)
    colours = _draw_terms(figures, terms)
    latency.set_title(title)
    latency.set_ylabel("report to authority, ms")
    age.set_ylabel("age when replaced, ms")
    terms.set_ylabel("term, areas drawn a little apart")
    terms.set_xlabel("s")
    for axes in (latency, age, terms):
        axes.grid(alpha=0.3)
        if names := axes.get_legend_handles_labels()[1]:
            # Beside the panel the legend hides nothing.
            columns = -(-len(names) // NAMES_MAX)
            beside = {"loc": "upper left", "bbox_to_anchor": (1.0, 1.0)}
            axes.legend(**beside, fontsize=FONT_PT, ncols=columns)
    # The places of labels depend on the size of everything else, so it is drawn first.
    figure.draw_without_rendering()
    _name_masters(figures, terms, colours)
    return figure


def _draw_terms(figures: RadioFigures, axes: "Axes") -> dict[int, Any]:
    """Return the colour of each area's line.

    Lines are shifted, because areas begin with the same term.
    """
    from matplotlib.ticker import MaxNLocator
    from matplotlib.transforms import offset_copy

    colours, figure = {}, axes.get_figure(root=True)
    axes.yaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    for nth, (area, changes) in enumerate(sorted(figures.terms.items())):
        times_s = [*[at_s for at_s, _, _ in changes], figures.end_s]
        values = [*[term for _, term, _ in changes], changes[-1][1]]
        (line,) = axes.step(
            *(times_s, values),
            where="post",
            linestyle=STYLES[nth % len(STYLES)],
            label=f"area {area}",
        )
        shift_pt = nth * APART_PT
        line.set_transform(offset_copy(axes.transData, figure, y=shift_pt, units="points"))
        colours[area] = line.get_color()
    drawn = [term for changes in figures.terms.values() for _, term, _ in changes]
    if drawn:
        room = 0.5 + 0.25 * (max(drawn) - min(drawn))
        axes.set_ylim(max(0.0, min(drawn) - room), max(drawn) + 2.0 * room)
    return colours


def _name_masters(figures: RadioFigures, axes: "Axes", colours: dict[int, Any]) -> None:
    """Write the name of the master at each new term, in the colour of the area."""
    changes = sorted(
        [(at_s, term, a, who) for a, each in figures.terms.items() for at_s, term, who in each]
    )
    pt_per_dot = PT_PER_IN / axes.figure.dpi
    at_pt = [tuple(axes.transData.transform((x, y)) * pt_per_dot) for x, y, _, _ in changes]
    above_pt = len(figures.terms) * APART_PT + ABOVE_PT
    for (at_s, term, area, who), raised_pt in zip(changes, raised(at_pt), strict=True):
        if raised_pt is None:
            continue
        axes.annotate(
            *(f"T{who}", (at_s, term), (2.0, above_pt + raised_pt)),
            textcoords="offset points",
            fontsize=FONT_PT,
            color=colours[area],
        )


def raised(at_pt: Sequence[tuple[float, float]]) -> list[float | None]:
    """Return the shift of each label so that no two overlap; None if there is no room."""
    width_pt, height_pt = LABEL_PT
    taken: list[tuple[float, float]] = []
    found: list[float | None] = []
    for x_pt, y_pt in at_pt:
        for level in range(LEVELS):
            spot = x_pt, y_pt + level * height_pt
            if all(abs(spot[0] - x) >= width_pt or abs(spot[1] - y) >= height_pt for x, y in taken):
                taken.append(spot)
                found.append(level * height_pt)
                break
        else:
            found.append(None)
    return found
