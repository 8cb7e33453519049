"""Smallest difference of each unit that matters: whatever differs by less counts as equal."""

import math
from collections.abc import Mapping, Sequence
from typing import Final, NewType

import numpy as np

from metro_hil.model.log_columns import Numbers

InUnit = NewType("InUnit", float)
"""A number in the unit that is named beside it."""
RELEVANT: Final[Mapping[str, float]] = {
    "m": 0.0005,
    "m/s": 0.005,
    "m/s²": 0.002,
    "m/s³": 0.002,
    "km/h": 0.02,
    "s": 0.01,
    "ms": 1.0,
    "kWh": 0.01,
    "V": 1.0,
    "1": 0.001,
    "%": 0.1,
    "": 1.0,
}
"""By unit: about half of the last digit that tables of results print, or less. A measure without a
unit is a number of things."""
ROUNDING_RATIO: Final = 1.0 - 1e-9


def relevance_of(unit: str, chosen: Mapping[str, float]) -> float:
    """In the unit; 0 for a unit of which nothing is known, so that any difference counts."""
    return chosen.get(unit, RELEVANT.get(unit, 0.0))


def that_matter(differences: Numbers, relevant: float) -> Numbers:
    """Without those that are smaller than what matters, or nothing."""
    sizes = np.abs(differences)
    return differences[(sizes >= relevant * ROUNDING_RATIO) & (sizes > 0.0)]


def parse_relevance(texts: Sequence[str]) -> dict[str, float]:
    """`m=0.01` and the like. Raises ValueError that names the text and says what it has to be."""
    found = {}
    for text in texts:
        unit, equals, number = text.rpartition("=")
        try:
            value = float(number)
        except ValueError:
            value = -1.0
        if not equals or not 0.0 <= value < math.inf:
            raise ValueError(f"{text!r} is not UNIT=NUMBER, such as m=0.01")
        found[unit] = value
    return found
