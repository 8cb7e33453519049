"""What operation believes of its own speed while the filter before it lags."""

import math
from dataclasses import replace

import pytest

from vobc.ato.config import BrakeBelief, TractionBelief
from vobc.ato.train_model import TrainModel
from vobc.odometry.tracking import SpeedTrack

CYCLE_S = 0.05
STEPS = 4
PULSE_M = 0.0105
DEAD_CYCLES = 13
LAG_S = 0.35
BANDWIDTH_RAD_S = 8.0
COASTING_S = 2.0
STEADY_S = 5.0
EASED_MPS3 = 0.1


def asked_mps2(cycle: int) -> float:
    """Nothing, then half a metre per second squared for some seconds, then less and less."""
    at_s = cycle * CYCLE_S
    if at_s < COASTING_S:
        return 0.0
    return 0.5 - EASED_MPS3 * max(0.0, at_s - STEADY_S)


def bias_mps(brake: BrakeBelief) -> float:
    """Mean of believed less true speed while the brake eases off, seen through pulses."""
    model = TrainModel(brake, TractionBelief(), CYCLE_S)
    track = SpeedTrack(bandwidth_rad_s=BANDWIDTH_RAD_S, window_s=0.2)
    speed_mps, front_m, braked_mps2 = 4.0, 0.0, 0.0
    errors_mps = []
    for cycle in range(round((STEADY_S + 4.0) / CYCLE_S)):
        model.issue(-asked_mps2(cycle))
        for part in range(STEPS):
            bites_mps2 = asked_mps2(cycle - DEAD_CYCLES)
            braked_mps2 += (bites_mps2 - braked_mps2) * (1.0 - math.exp(-CYCLE_S / STEPS / LAG_S))
            speed_mps -= braked_mps2 * CYCLE_S / STEPS
            front_m += speed_mps * CYCLE_S / STEPS
            now_s = (cycle + (part + 1) / STEPS) * CYCLE_S
            if part % 2:
                track.add(now_s, math.floor(front_m / PULSE_M))
        measured_mps = track.limited_rate_pulses_per_s(now_s) * PULSE_M
        if now_s < COASTING_S:
            model.meet(measured_mps)
        model.step(measured_mps, 0.0, 1)
        if now_s > STEADY_S + 2.0:
            errors_mps.append(model.speed_mps - speed_mps)
    return math.fsum(errors_mps) / len(errors_mps)


def test_a_brake_that_eases_off_does_not_make_the_train_seem_slower() -> None:
    assert bias_mps(BrakeBelief()) == pytest.approx(0.0, abs=0.0025)


def test_without_reckoning_with_the_filter_it_would() -> None:
    quick = replace(BrakeBelief(), speed_filter_rad_s=1000.0)

    assert bias_mps(quick) < -0.004
