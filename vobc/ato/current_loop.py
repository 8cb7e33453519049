"""The current loops of 4 to 20 mA from the controller's end: converter, mapping, what is set."""

import math
from typing import Final

from vobc.ato.settings.output import OutputStage
from vobc.vocabulary import CurrentReference

REST_MA: Final = 3.8
"""Set for no effort: far enough under the live zero that no error of the loop asks for any, far
enough over a broken wire, which carries nothing, to be told from it."""
LIVE_ZERO_MA: Final = 4.0
"""Under this there is no effort."""
FULL_MA: Final = 18.0
"""From here to the end of the range effort is full."""
RANGE_MA: Final = 20.0
"""Over this the loop is faulty: the brake is applied in full, traction is cut."""
LEAST_BRAKE_MA: Final = 4.1
"""Set for the least brake: scatter about the live zero must not apply and release it by turns."""
SAME_STEPS: Final = 1e-6
"""A current so close to a step of the converter is meant to be it."""


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
        up: to the next step at or above, and to no less than `LEAST_BRAKE_MA`; else at or below. No
            effort is the step at or below `REST_MA`.
    """
    steps = (1 << bits) - 1
    wanted_ma = LIVE_ZERO_MA + min(1.0, ratio) * (FULL_MA - LIVE_ZERO_MA)
    if ratio <= 0.0:
        count = math.floor(REST_MA / RANGE_MA * steps)
    elif up:
        count = math.ceil(max(LEAST_BRAKE_MA, wanted_ma) / RANGE_MA * steps - SAME_STEPS)
    else:
        count = math.floor(wanted_ma / RANGE_MA * steps + SAME_STEPS)
    return count * RANGE_MA / steps


def reference(
    force_n: float, decel_mps2: float, *, inertia_kg: float, config: OutputStage
) -> CurrentReference:
    """The currents for what arbitration lets out.

    Args:
        force_n: of traction, not negative.
        decel_mps2: of the service brake, not negative; more than full counts as full.
        inertia_kg: of the train as it is believed, rotating parts included.
    """
    pull_ratio = force_n / (inertia_kg * config.loop_traction_full_mps2)
    brakes_ratio = decel_mps2 / config.loop_brake_full_mps2
    return CurrentReference(
        traction_ma=current_ma(pull_ratio, config.loop_bits, up=False),
        brake_ma=current_ma(brakes_ratio, config.loop_bits, up=True),
    )
