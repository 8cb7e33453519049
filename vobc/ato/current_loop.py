"""The analogue mapping of a 4 to 20 mA loop, as seen from either end of the wire."""

import math
from typing import Final

LIVE_ZERO_MA: Final = 4.0
"""Under this there is no effort; a broken wire carries nothing."""
FULL_MA: Final = 18.0
"""From here to the end of the range effort is full."""
RANGE_MA: Final = 20.0
"""Over this the loop is faulty: the brake is applied in full, traction is cut."""


def brake_ratio(read_ma: float) -> float:
    """Share of full brake that a current asks for."""
    return 1.0 if read_ma > RANGE_MA else _ratio(read_ma)


def traction_ratio(read_ma: float) -> float:
    """Share of full traction that a current asks for."""
    return 0.0 if read_ma > RANGE_MA else _ratio(read_ma)


def _ratio(read_ma: float) -> float:
    if read_ma < LIVE_ZERO_MA:
        return 0.0
    return min(1.0, (read_ma - LIVE_ZERO_MA) / (FULL_MA - LIVE_ZERO_MA))


def current_ma(ratio: float, bits: int, *, up: bool) -> float:
    """Current of a converter with `bits` over 0 to 20 mA for a share of full effort.

    Args:
        ratio: not negative; over 1 it counts as 1.
        up: to the next step at or above, else at or below. No effort is always a step that reads
            as none.
    """
    steps = (1 << bits) - 1
    wanted_ma = LIVE_ZERO_MA + min(1.0, ratio) * (FULL_MA - LIVE_ZERO_MA)
    exact = wanted_ma / RANGE_MA * steps
    count = math.ceil(exact) if up and ratio > 0.0 else math.floor(exact)
    return count * RANGE_MA / steps
