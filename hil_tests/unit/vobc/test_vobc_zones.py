"""Zones: where traction is off, where a train waits, and from which speed it coasts through."""

import math
from dataclasses import replace
from typing import Final

import pytest
from hypothesis import given
from hypothesis import strategies as st

from can_dbc.vobc import EventKind
from firmware_py.trackdb import GradientSection, LineMap, LineZone, TunnelSection, load_line
from hil_tests.unit.vobc.test_vobc_events import SEEN
from vobc.config import load_config
from vobc.events import events_between
from vobc.plausible import implausible
from vobc.vocabulary import SAFE_OUTPUT, Interval, Motion
from vobc.zones import EvacuationHold, NeutralSections, ZoneHold, coastings

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


def test_a_tunnel_makes_a_train_coast_through_a_neutral_section_faster() -> None:
    (before,) = coastings(CONFIG, with_gap())
    bore = TunnelSection(1900.0, 2300.0, 5.0)
    (inside,) = coastings(CONFIG, replace(with_gap(), tunnels=(bore,)))

    assert inside.entry_mps > before.entry_mps


TUNNEL = LineZone(2000.0, 2200.0, "tunnel")
PAST_M = TUNNEL.end_m + LENGTH_M + CONFIG.ato.authority.margin_m + 1.0


def with_tunnel(*stations_m: float) -> LineMap:
    stations = tuple(
        replace(LINE.stations[1], name=f"S{at_m:g}", stop_m=at_m, platform_start_m=at_m - 70.0,
                platform_end_m=at_m + 5.0, short_stops=())
        for at_m in (1500.0, *stations_m)
    )  # fmt: skip
    return replace(LINE, no_stop_zones=(TUNNEL,), stations=stations, tags=())


@pytest.mark.parametrize(
    ("authority_end_m", "front_m", "speed_mps", "end_m"),
    [
        (1900.0, 1800.0, 10.0, 1900.0),
        (2100.0, 1800.0, 10.0, 2000.0),
        (PAST_M - 0.01, 1800.0, 10.0, 2000.0),
        (PAST_M, 1800.0, 10.0, PAST_M),
        # It could no longer stop comfortably, or is inside already.
        (2100.0, 1990.0, 10.0, 2100.0),
        (2100.0, 2000.0, 0.0, 2100.0),
        (2100.0, 1999.0, 0.0, 2000.0),
    ],
)
def test_operation_waits_before_a_zone_until_the_authority_passes_it(
    authority_end_m: float, front_m: float, speed_mps: float, end_m: float
) -> None:
    hold = ZoneHold(CONFIG, with_tunnel(4000.0))

    assert hold.end_m(authority_end_m, at(front_m, speed_mps)) == end_m


def test_a_stop_behind_the_zone_is_as_good_as_a_longer_authority() -> None:
    stop_m = TUNNEL.end_m + LENGTH_M + 0.5
    authority_m = stop_m + 0.5

    assert ZoneHold(CONFIG, with_tunnel(4000.0)).end_m(authority_m, at(1800.0)) == 2000.0
    assert ZoneHold(CONFIG, with_tunnel(stop_m)).end_m(authority_m, at(1800.0)) == authority_m


def test_a_train_that_began_to_wait_goes_on_waiting_until_it_may_pass() -> None:
    hold = ZoneHold(CONFIG, with_tunnel(4000.0))
    ends_m = [
        hold.end_m(authority_m, at(front_m, speed_mps))
        for authority_m, front_m, speed_mps in (
            (2100.0, 1800.0, 10.0),
            (2100.0, 1995.0, 3.0),
            (PAST_M, 1995.0, 1.0),
            (2100.0, 1998.0, 10.0),
        )
    ]

    assert ends_m == [2000.0, 2000.0, PAST_M, 2100.0]


def test_zones_without_room_for_a_train_between_them_are_passed_together() -> None:
    near, far = LineZone(2250.0, 2300.0), LineZone(2400.0, 2450.0)
    line = replace(with_tunnel(4000.0), no_stop_zones=(TUNNEL, near, far))
    hold = ZoneHold(CONFIG, line)

    assert hold.end_m(PAST_M, at(1800.0)) == 2000.0
    assert hold.end_m(PAST_M + 150.0, at(1800.0)) == 2400.0


def test_a_train_waits_for_a_neutral_section_where_it_has_a_run_up() -> None:
    climbs = with_gap(LineZone(2600.0, 2700.0), 20.0)
    (coasting,) = coastings(CONFIG, climbs)
    hold = ZoneHold(CONFIG, climbs)

    waits_m = hold.end_m(2650.0, at(1800.0))
    assert waits_m == pytest.approx(coasting.from_m - coasting.run_up_m)
    assert 0.0 < coasting.run_up_m < 300.0
    # Too close for the run-up, a standing train waits where it is.
    assert hold.end_m(2650.0, at(waits_m + 20.0)) == waits_m + 20.0
    # A moving one stops before the section.
    assert ZoneHold(CONFIG, climbs).end_m(2650.0, at(waits_m + 1.0, 1.0)) == 2600.0


@pytest.mark.parametrize(
    ("front_m", "text"),
    [
        (2000.0, ""),
        (2000.1, "no-stop zone tunnel, 2000 m to 2200 m"),
        (2200.0 + LENGTH_M - 0.1, "no-stop zone tunnel, 2000 m to 2200 m"),
        (2200.0 + LENGTH_M, ""),
    ],
)
def test_a_train_that_stands_in_a_zone_knows_it(front_m: float, text: str) -> None:
    assert ZoneHold(CONFIG, with_tunnel()).stands_in(at(front_m)) == text


def test_a_station_in_a_no_stop_zone_is_refused() -> None:
    inside = TUNNEL.end_m + LENGTH_M

    assert not any("no_stop" in text for text in implausible(CONFIG, with_tunnel(inside)))
    (found,) = (t for t in implausible(CONFIG, with_tunnel(inside - 0.1)) if "no_stop" in t)
    assert f"stops at S{inside - 0.1:g} stands in it" in found


def test_a_train_that_comes_to_stand_in_a_zone_reports_it_once() -> None:
    before = replace(SAFE_OUTPUT, motion=at(2050.0))
    still = replace(at(2050.0), standstill=True)
    stands = replace(before, motion=still, stands_in="no-stop zone tunnel, 2000 m to 2200 m")

    (event,) = (
        each for each in events_between(before, SEEN, stands) if "in which none" in each.words
    )
    assert event.kind is EventKind.STOPPED_IN_ZONE
    assert "no-stop zone tunnel" in event.words
    assert not events_between(stands, SEEN, stands)
    assert not events_between(stands, SEEN, before)


EXITS: Final = (LineZone(1930.0, 2000.0, "east"), LineZone(2430.0, 2500.0, "west"))
MARGIN_M: Final = CONFIG.ato.authority.margin_m


def held(front_m: float, authority_m: float, seconds: float, speed_mps: float = 10.0) -> float:
    """End that operation gets after an authority has been the same for so many seconds."""
    hold = EvacuationHold(CONFIG, replace(with_tunnel(4000.0), evacuation_stops=EXITS))
    end_m = math.nan
    for _ in range(round(seconds * 2.0) + 1):
        end_m = hold.end_m(authority_m, at(front_m, speed_mps), 0.5)
    return end_m


@pytest.mark.parametrize(
    ("front_m", "authority_m", "seconds", "end_m"),
    [
        (1800.0, 2300.0, 44.0, 2300.0),
        (1800.0, 2300.0, 46.0, 2000.0 + MARGIN_M),
        # Too late for the first one; the second one is beyond the authority, or is not.
        (1950.0, 2500.0, 46.0, 2500.0),
        (1950.0, 2600.0, 46.0, 2500.0 + MARGIN_M),
        # The authority reaches the next stop, at 4000 m.
        (1800.0, 4000.0, 46.0, 4000.0),
    ],
)
def test_a_train_that_is_held_for_long_stands_at_the_next_evacuation_stop(
    front_m: float, authority_m: float, seconds: float, end_m: float
) -> None:
    assert held(front_m, authority_m, seconds) == end_m


@given(front_m=st.floats(1600.0, 2600.0), speed_mps=st.floats(0.0, 20.0), ahead_m=st.floats(0, 999))
def test_an_evacuation_stop_never_lengthens_an_authority_and_never_needs_hard_braking(
    front_m: float, speed_mps: float, ahead_m: float
) -> None:
    end_m = held(front_m, front_m + ahead_m, 46.0, speed_mps)

    assert end_m <= front_m + ahead_m
    if end_m < front_m + ahead_m:
        assert speed_mps**2 / (2.0 * (end_m - front_m)) < CONFIG.ato.braking.decel_mps2


def test_a_train_goes_on_when_its_authority_grows() -> None:
    hold = EvacuationHold(CONFIG, replace(with_tunnel(4000.0), evacuation_stops=EXITS))
    for _ in range(100):
        hold.end_m(2300.0, at(1800.0), 0.5)

    assert hold.end_m(2300.9, at(1990.0), 0.5) == 2000.0 + MARGIN_M
    assert hold.end_m(2302.0, at(1990.0), 0.5) == 2302.0
    assert hold.end_m(2302.0, at(1990.0), 0.5) == 2302.0


def test_an_evacuation_stop_in_a_no_stop_zone_is_refused() -> None:
    free = LineZone(TUNNEL.end_m, TUNNEL.end_m + LENGTH_M, "exit")
    for stop, refused in ((free, False), (replace(free, end_m=free.end_m - 0.1), True)):
        line = replace(with_tunnel(4000.0), evacuation_stops=(stop,))
        assert any("evacuation_stops: exit" in t for t in implausible(CONFIG, line)) is refused
    with pytest.raises(ValueError, match="has no name"):
        replace(LINE, evacuation_stops=(LineZone(1.0, 2.0),))
