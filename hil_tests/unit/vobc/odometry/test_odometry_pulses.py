"""Counting pulses of two axles: wraps, jumps, dead axles, and the lead of one over the other."""

import math

import pytest

from can_dbc.nodes import Direction
from can_dbc.odometer import Tacho
from vobc.odometry.pulses import STRETCH_PULSES, AxlePlay, LeadBounds, PulseCounter


def test_a_wrap_of_counter_b_during_a_silence_is_no_slip() -> None:
    """600 pulses are more than half of the 1024 that counter B can show."""
    pulses = PulseCounter(4000.0)
    for count in (0, 600, 1200):
        sample = Tacho(count, count % 1024, Direction.FORWARD, True, True, 0.0)
        pulses.step(sample, 0.3)

        assert not pulses.axles_differ


def test_the_lead_of_an_axle_counts_every_pulse_and_its_extremes_only_grow() -> None:
    pulses, bounds = PulseCounter(4000.0), LeadBounds()
    told = []
    for a, b in ((0, 1020), (10, 1030), (20, 1050), (40, 1060), (60, 1065)):
        pulses.step(Tacho(a, b % 1024, Direction.FORWARD, True, True, 0.0), 0.02)
        told.append((pulses.lead, *bounds.widen(pulses.lead)))

    assert told == [(0, 0, 0), (0, 0, 0), (10, 0, 10), (0, 0, 0), (-15, 15, 0)]
    bounds.begin(5)
    assert bounds.widen(7) == (0, 2)


def test_an_axle_without_plausible_pulses_leads_nothing() -> None:
    pulses = PulseCounter(4000.0)
    for a, b, healthy in ((0, 0, True), (10, 10, True), (20, 10, False), (30, 10, False)):
        pulses.step(Tacho(a, b, Direction.FORWARD, True, healthy, 0.0), 0.02)
        assert pulses.paired is (healthy and a > 0)
        assert pulses.lead == 0


def test_a_coupler_that_stretches_and_closes_loses_no_adhesion() -> None:
    """The axles swing by 14 pulses, as those of florence4 do when it starts."""
    pulses, differed = PulseCounter(4000.0), False
    for at in range(200):
        a, b = 4 * at, 4 * at - round(7.0 - 7.0 * math.cos(at / 8.0))
        pulses.step(Tacho(a, b % 1024, Direction.FORWARD, True, True, 0.0), 0.02)
        differed = differed or pulses.axles_differ

        assert not pulses.adhesion_lost
    assert differed


@pytest.mark.parametrize("sign", [1, -1])
def test_an_axle_that_leaves_the_play_of_the_couplers_has_lost_adhesion(sign: int) -> None:
    """The play of the couplers is met exactly, once to either side."""
    play = AxlePlay(STRETCH_PULSES)
    most = round(STRETCH_PULSES)

    assert not play.step(sign * most, 0)
    assert play.step(sign, 0)
    assert not play.step(-2 * sign * most, 0)
    assert play.step(-sign, 0)


def test_an_axle_that_spins_a_tenth_faster_loses_adhesion_within_two_metres() -> None:
    pulses, lost_at = PulseCounter(4000.0), 0
    for b in range(0, 400, 10):
        a = b + b // 10
        pulses.step(Tacho(a, b % 1024, Direction.FORWARD, True, True, 0.0), 0.02)
        lost_at = lost_at or (b if pulses.adhesion_lost else 0)

    assert 150 < lost_at < 200
