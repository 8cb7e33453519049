"""The plot of a line's radio is readable: whole terms, separate names, no line hidden by
another."""

import itertools
from collections.abc import Iterator

import matplotlib as mpl
import matplotlib.pyplot as plt
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from metro_hil.supervision.radio_log import RadioFigures, TrainFigures
from metro_hil.supervision.radio_log_plot import LABEL_PT, picture, raised

TERMS = {
    1: [(1.5, 1, 5)],
    2: [(1.5, 1, 2), (20.0, 9, 3)],
    3: [(1.6, 1, 1), (20.1, 9, 2)],
}


@pytest.fixture
def drawn() -> Iterator[Figure]:
    mpl.use("Agg")
    trains = {number: TrainFigures([2.0], [80.0], [150.0]) for number in range(1, 21)}
    figure = picture(RadioFigures(trains=trains, terms=TERMS, end_s=30.0), "a run")
    figure.canvas.draw()
    yield figure
    plt.close(figure)


def terms_of(figure: Figure) -> Axes:
    return figure.axes[2]


def test_terms_have_whole_numbers_and_none_is_below_zero(drawn: Figure) -> None:
    low, high = terms_of(drawn).get_ylim()
    ticks = [each for each in terms_of(drawn).get_yticks() if low <= each <= high]

    assert ticks
    assert all(each == int(each) and each >= 0 for each in ticks)


def test_a_single_term_has_a_whole_number_too() -> None:
    figure = picture(RadioFigures(terms={1: [(0.5, 1, 5)]}, end_s=3.0), "a run")
    figure.canvas.draw()

    low, high = terms_of(figure).get_ylim()
    assert [each for each in terms_of(figure).get_yticks() if low <= each <= high] == [1, 2]
    plt.close(figure)


def test_names_of_trains_do_not_overlap(drawn: Figure) -> None:
    texts = terms_of(drawn).texts
    boxes = [each.get_window_extent() for each in texts]

    assert [each.get_text() for each in texts] == ["T5", "T2", "T1", "T3", "T2"]
    assert not any(one.overlaps(other) for one, other in itertools.combinations(boxes, 2))


def test_areas_with_the_same_term_are_drawn_apart_in_different_styles(drawn: Figure) -> None:
    lines = terms_of(drawn).lines[:3]
    heights_px = [each.get_transform().transform((5.0, 1.0))[1] for each in lines]

    assert all(above - below > 2.0 for below, above in itertools.pairwise(heights_px))
    assert len({each.get_linestyle() for each in lines}) == 3


def test_legends_are_beside_the_plots(drawn: Figure) -> None:
    for axes in drawn.axes:
        legend = axes.get_legend()
        assert legend is not None
        assert legend.get_window_extent().x0 >= axes.get_window_extent().x1
        assert legend.get_window_extent().y0 >= axes.get_window_extent().y0


def test_labels_are_raised_where_they_collide_and_omitted_where_too_many_do() -> None:
    width_pt, height_pt = LABEL_PT

    assert raised([(0.0, 0.0), (width_pt, 0.0), (1.0, 2.0)]) == [0.0, 0.0, height_pt]
    assert raised([(0.0, 0.0)] * 9)[-2:] == [7.0 * height_pt, None]
