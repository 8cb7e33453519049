"""A picture of a line's radio: latency and age of each train's authorities, and the terms."""

from pathlib import Path
from typing import Final

from metro_hil.line_desk.log import Figures

WIDTH_IN: Final = 12.0
HEIGHT_IN: Final = 9.0


def draw(figures: Figures, path: Path, title: str) -> None:
    """Raises OSError, and ValueError for an ending that is no picture."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, (latency, age, terms) = plt.subplots(
        3, 1, sharex=True, figsize=(WIDTH_IN, HEIGHT_IN), layout="constrained"
    )
    for number, train in sorted(figures.trains.items()):
        name = f"T{number}"
        latency.plot(train.at_s, train.latency_ms, ".", markersize=3, label=name)
        age.plot(train.at_s, train.age_ms, ".", markersize=3, label=name)
    for area, changes in sorted(figures.terms.items()):
        times_s = [*[at_s for at_s, _, _ in changes], figures.end_s]
        values = [*[term for _, term, _ in changes], changes[-1][1]]
        terms.step(times_s, values, where="post", label=f"area {area}")
        for at_s, term, train_number in changes:
            terms.annotate(f"T{train_number}", (at_s, term), fontsize=8)
    latency.set_title(title)
    latency.set_ylabel("report to authority, ms")
    age.set_ylabel("age when replaced, ms")
    terms.set_ylabel("term")
    terms.set_xlabel("s")
    for axes in (latency, age, terms):
        axes.grid(alpha=0.3)
        if axes.get_legend_handles_labels()[0]:
            axes.legend(loc="upper right", fontsize=8, ncols=4)
    try:
        figure.savefig(path)
    finally:
        plt.close(figure)
