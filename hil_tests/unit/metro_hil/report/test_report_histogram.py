"""Histograms of a campaign's page, also of values that hardly differ."""

import math

import pytest

from metro_hil.report.campaign.page.drawing import histogram, span_of


@pytest.mark.parametrize(
    "values",
    [
        [0.25, 0.25],
        [0.25, math.nextafter(0.25, 1.0)],
        [-1e-300, 0.0, 1e-300],
        [-5.0, math.nextafter(-5.0, 0.0)],
        [0.0],
        [-2.0, 3.0],
    ],
)
def test_a_histogram_is_drawn_of_any_values(values: list[float]) -> None:
    mean = (values[0], values[0], values[0])

    assert "<rect" in histogram(values, "m", mean, span_of(values))
