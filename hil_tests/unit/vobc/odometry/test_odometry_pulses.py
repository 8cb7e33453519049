"""Counting pulses of two axles: wraps, jumps, dead axles, and the lead of one over the other."""

from can_dbc.nodes import Direction
from can_dbc.odometer import Tacho
from vobc.odometry.pulses import LeadBounds, PulseCounter


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
