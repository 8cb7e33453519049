"""The 4 to 20 mA current loops on the controller's side: converter, scaling and reference."""

import math
from typing import Final

from vobc.ato.settings.output import OutputStage
from vobc.vocabulary import CurrentReference

REST_MA: Final = 3.8
"""Current for no effort. It is so far below the live zero that no loop error demands effort, and so
far above 0 that it differs from a broken wire."""
LIVE_ZERO_MA: Final = 4.0
"""Current below which there is no effort."""
FULL_MA: Final = 18.0
"""Current from which effort is full, up to the end of the range."""
RANGE_MA: Final = 20.0
"""Current above which the loop is faulty: the brake is applied in full and traction is cut."""
LEAST_BRAKE_MA: Final = 4.1
"""Current of the least brake. Noise around the live zero must not alternate between applied and
released."""
SAME_STEPS: Final = 1e-6
"""Tolerance for a current that is meant to be a step of the converter."""


def brake_ratio(read_ma: float) -> float:
    """Brake demand of a current, as a share of full brake."""
    return 1.0 if read_ma > RANGE_MA else _ratio(read_ma)


def traction_ratio(read_ma: float) -> float:
    """Traction demand of a current, as a share of full traction."""
    return 0.0 if read_ma > RANGE_MA else _ratio(read_ma)


def _ratio(read_ma: float) -> float:
    if read_ma < LIVE_ZERO_MA:
        return 0.0
    return min(1.0, (read_ma - LIVE_ZERO_MA) / (FULL_MA - LIVE_ZERO_MA))


def current_ma(ratio: float, bits: int, *, up: bool) -> float:
    """Current for a share of full effort, from a converter with `bits` over 0 to 20 mA.

    Args:
        ratio: not negative. A value over 1 counts as 1.
        up: round up to a step, to no less than `LEAST_BRAKE_MA`; else round down. No effort gives
            the step at or below `REST_MA`.
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
    """Currents for the demand that arbitration passes on.

    Args:
        force_n: traction force, not negative.
        decel_mps2: service brake, not negative. More than full counts as full.
        inertia_kg: assumed inertia of the train, rotating parts included.
    """
    pull_ratio = force_n / (inertia_kg * config.loop_traction_full_mps2)
    brakes_ratio = decel_mps2 / config.loop_brake_full_mps2
    return CurrentReference(
        traction_ma=current_ma(pull_ratio, config.loop_bits, up=False),
        brake_ma=current_ma(brakes_ratio, config.loop_bits, up=True),
    )
