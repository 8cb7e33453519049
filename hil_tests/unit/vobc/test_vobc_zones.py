"""Neutral sections: where traction is off, and the speed from which a train coasts through."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.trackdb import GradientSection, LineMap, LineZone, load_line
from vobc.config import load_config
from vobc.plausible import implausible
from vobc.vocabulary import Interval, Motion
from vobc.zones import NeutralSections, coastings

CONFIG = load_config("florence4")
LENGTH_M = CONFIG.train.length_m
LINE = replace(load_line("florence"), gradients=())
GAP = LineZone(2000.0, 2060.0, "gap")
MOTION = Motion(
    front_m=Interval(0.0, 0.0, 0.0),
    speed_mps=Interval(0.0, 0.0, 0.0),
    accel_mps2=0.0,
    travel_m=0.0,
    standing=False,
    standstill=False,
    localised=True,
    slip=False,
    accepted_tag_ids=(),
)


def at(front_m: float, speed_mps: float = 0.0, width_m: float = 0.0) -> Motion:
    """A train somewhere within `width_m` to both sides."""
    return replace(
        MOTION,
        front_m=Interval(front_m - width_m, front_m, front_m + width_m),
        speed_mps=Interval(speed_mps, speed_mps, speed_mps),
    )


def with_gap(gap: LineZone = GAP, climb_permille: float = 0.0) -> LineMap:
    """The line with a neutral section, all of it on a climb."""
    slope = GradientSection(LINE.start_m, LINE.end_m, climb_permille)
    return replace(LINE, neutral_sections=(gap,), gradients=(slope,) if climb_permille else ())


@pytest.mark.parametrize(
    ("front_m", "off"),
    [(1999.9, False), (2000.1, True), (2060.0 + LENGTH_M - 0.1, True), (2060.1 + LENGTH_M, False)],
)
def test_traction_is_off_from_before_a_neutral_section_until_the_rear_has_left_it(
    front_m: float, off: bool
) -> None:
    sections = NeutralSections(CONFIG, with_gap())

    assert sections.off(at(front_m)) is off
    assert sections.off(at(front_m - 5.0, width_m=5.0)) is (off or front_m > 2060.0)
    assert not NeutralSections(CONFIG, LINE).off(at(front_m))


@given(speed_mps=st.floats(0.0, 25.0), front_m=st.floats(1900.0, 2200.0))
def test_operation_ends_its_demand_before_protection_removes_traction(
    speed_mps: float, front_m: float
) -> None:
    """Until the effort is gone, protection assumes that the train goes on as it is."""
    sections = NeutralSections(CONFIG, with_gap())
    motion = at(front_m, speed_mps)

    gone_m = front_m + speed_mps * CONFIG.atp.traction_cut_s
    if gone_m > GAP.start_m and front_m - LENGTH_M < GAP.end_m:
        assert sections.off(motion)
    if sections.off(motion):
        assert sections.eases(motion)


@pytest.mark.parametrize("climb_permille", [0.0, 20.0, 40.0])
def test_a_train_that_enters_as_fast_as_needed_comes_through(climb_permille: float) -> None:
    """The oracle steps through time, as the computation steps back through places."""
    (coasting,) = coastings(CONFIG, with_gap(climb_permille=climb_permille))

    for extra_mps, passes in ((0.1, True), (-0.1, False)):
        at_m, speed_mps = coasting.from_m, coasting.entry_mps + extra_mps
        while speed_mps > 0.95 and at_m < GAP.end_m + LENGTH_M:
            resistance = CONFIG.ato.resistance.n_per_kn(speed_mps)
            lost_mps2 = 9.81 * (climb_permille + resistance) / 1000.0
            lost_mps2 /= 1.0 + CONFIG.ato.rotating_mass_percent / 100.0
            at_m += speed_mps * 0.01
            speed_mps -= lost_mps2 * 0.01
        assert (at_m >= GAP.end_m + LENGTH_M) is passes


@pytest.mark.parametrize(
    ("gap", "climb_permille", "words"),
    [
        (GAP, 0.0, ""),
        (GAP, 20.0, ""),
        (LineZone(2000.0, 2400.0), 50.0, "and the limit there is 11.1 m/s"),
        (LineZone(1530.0, 1560.0), 20.0, "sets off at I may not reach"),
        (LineZone(1480.0, 1520.0), 0.0, "stops at I has no power"),
    ],
)
def test_a_section_that_the_train_cannot_pass_is_refused(
    gap: LineZone, climb_permille: float, words: str
) -> None:
    found = [
        text for text in implausible(CONFIG, with_gap(gap, climb_permille)) if "neutral" in text
    ]

    assert (words in found[0]) if words else not found
