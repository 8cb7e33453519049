"""Smallest difference of each unit that matters; smaller differences count as equal."""

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
"""Smallest relevant differences by unit: at most about half of the last digit in tables of results.
A measure without a unit is a count."""
ROUNDING_RATIO: Final = 1.0 - 1e-9


def relevance_of(unit: str, chosen: Mapping[str, float]) -> float:
    """Smallest relevant difference of a unit; 0 for an unknown unit, so that any difference
    counts."""
    return chosen.get(unit, RELEVANT.get(unit, 0.0))


def that_matter(differences: Numbers, relevant: float) -> Numbers:
    """The differences that are large enough to matter and not zero."""
    sizes = np.abs(differences)
    return differences[(sizes >= relevant * ROUNDING_RATIO) & (sizes > 0.0)]


def parse_relevance(texts: Sequence[str]) -> dict[str, float]:
    """Parse texts such as `m=0.01`. Raises ValueError that names the text and the form."""
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
