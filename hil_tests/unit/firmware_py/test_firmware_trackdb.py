"""The line by chainage, against oracles that examine every section and sampled points."""

import itertools
import re
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st

from firmware_py import settings
from firmware_py.settings import SettingsError
from firmware_py.trackdb import (
    CurveSection,
    GradientSection,
    LineMap,
    PlatformSide,
    SpeedSection,
    Station,
    StoppingPoint,
    TagKind,
    TagSite,
    TunnelSection,
    load_line,
)

KMH = 1.0 / 3.6
SAMPLES = 50
FLORENCE = load_line("florence")


def cut(points_m: list[int]) -> list[tuple[float, float]]:
    """Stretches between neighbouring points."""
    return [(float(a), float(b)) for a, b in itertools.pairwise(sorted(set(points_m)))]


@st.composite
def lines(draw: st.DrawFn) -> LineMap:
    """A random line whose sections touch, leave gaps, and end at the ends of the line."""
    start_m = draw(st.integers(-500, 500))
    end_m = start_m + draw(st.integers(10, 2000))
    inner = st.lists(st.integers(start_m, end_m), max_size=8)
    speeds = cut([start_m, *draw(inner), end_m])
    limits_mps = draw(st.lists(st.floats(1.0, 40.0), min_size=len(speeds), max_size=len(speeds)))
    slopes = [part for part in cut(draw(inner)) if draw(st.booleans())]
    bends = [part for part in cut(draw(inner)) if draw(st.booleans())]
    return LineMap(
        name="drawn",
        start_m=float(start_m),
        end_m=float(end_m),
        stations=(Station("only", start_m + 5.0, float(start_m), start_m + 6.0),),
        speed_sections=tuple(
            SpeedSection(*part, limit_mps)
            for part, limit_mps in zip(speeds, limits_mps, strict=True)
        ),
        gradients=tuple(GradientSection(*part, draw(st.floats(-60.0, 60.0))) for part in slopes),
        curves=tuple(CurveSection(*part, draw(st.floats(50.0, 2000.0))) for part in bends),
    )


@st.composite
def lines_and_stretches(draw: st.DrawFn) -> tuple[LineMap, float, float]:
    """A line and a train on it, at its edges, or partly or wholly off it."""
    line = draw(lines())
    edges_m = [line.start_m, line.end_m]
    sections: list[SpeedSection | GradientSection | CurveSection] = []
    sections += [*line.speed_sections, *line.gradients, *line.curves]
    for section in sections:
        edges_m += [section.start_m, section.end_m]
    place = st.one_of(st.sampled_from(edges_m), st.floats(line.start_m - 100.0, line.end_m + 100.0))
    rear_m, front_m = sorted((draw(place), draw(place)))
    return line, rear_m, front_m


def limit_by_hand(line: LineMap, at_m: float) -> float:
    for section in line.speed_sections:
        if section.start_m <= at_m < section.end_m:
            return section.limit_mps
    return line.speed_sections[0 if at_m < line.start_m else -1].limit_mps


def gradient_by_hand(line: LineMap, at_m: float) -> float:
    for section in line.gradients:
        if section.start_m <= at_m < section.end_m:
            return section.gradient_permille
    return 0.0


def radius_by_hand(line: LineMap, at_m: float) -> float | None:
    for section in line.curves:
        if section.start_m <= at_m < section.end_m:
            return section.radius_m
    return None


def rise_by_hand_m(line: LineMap, rear_m: float, front_m: float) -> Fraction:
    """Exact sum over all gradients of the part of the stretch that lies on each."""
    rise_m = Fraction(0)
    for section in line.gradients:
        part_m = min(Fraction(front_m), Fraction(section.end_m)) - max(
            Fraction(rear_m), Fraction(section.start_m)
        )
        rise_m += max(Fraction(0), part_m) * Fraction(section.gradient_permille) / 1000
    return rise_m


def least_by_hand(
    line: LineMap, value: Callable[[LineMap, float], float], rear_m: float, front_m: float
) -> float:
    """The least value at both ends, at every edge between them and at sampled points."""
    places_m = [rear_m, front_m]
    sections: list[SpeedSection | GradientSection] = [*line.speed_sections, *line.gradients]
    for section in sections:
        places_m += [m for m in (section.start_m, section.end_m) if rear_m <= m <= front_m]
    places_m += [rear_m + (front_m - rear_m) * k / SAMPLES for k in range(SAMPLES)]
    return min(value(line, at_m) for at_m in places_m)


@given(lines_and_stretches())
def test_values_at_a_point_are_those_of_its_section(
    drawn: tuple[LineMap, float, float],
) -> None:
    line, *places_m = drawn

    for at_m in places_m:
        assert line.limit_mps(at_m) == limit_by_hand(line, at_m)
        assert line.gradient_permille(at_m) == gradient_by_hand(line, at_m)
        assert line.radius_m(at_m) == radius_by_hand(line, at_m)


@given(lines_and_stretches())
def test_the_least_limit_is_that_of_the_worst_point_under_the_train(
    drawn: tuple[LineMap, float, float],
) -> None:
    line, rear_m, front_m = drawn

    assert line.least_limit_mps(rear_m, front_m) == least_by_hand(
        line, limit_by_hand, rear_m, front_m
    )


@given(lines_and_stretches())
def test_the_worst_gradient_is_that_of_the_worst_point_under_the_train(
    drawn: tuple[LineMap, float, float],
) -> None:
    line, rear_m, front_m = drawn

    assert line.worst_gradient_permille(rear_m, front_m) == least_by_hand(
        line, gradient_by_hand, rear_m, front_m
    )


@given(lines_and_stretches())
def test_the_mean_gradient_is_the_rise_over_the_length(drawn: tuple[LineMap, float, float]) -> None:
    line, rear_m, front_m = drawn
    # A train is some metres long; over a tiny length the difference of two heights is too inexact.
    if front_m - rear_m < 0.1:
        front_m = rear_m + 0.1

    exact = float(
        rise_by_hand_m(line, rear_m, front_m) / (Fraction(front_m) - Fraction(rear_m)) * 1000
    )

    assert line.mean_gradient_permille(rear_m, front_m) == pytest.approx(exact, abs=1e-6)


@given(lines_and_stretches())
def test_height_is_the_rise_since_the_start_and_never_jumps(
    drawn: tuple[LineMap, float, float],
) -> None:
    line, *places_m = drawn

    for at_m in places_m:
        exact_m = float(rise_by_hand_m(line, line.start_m, max(at_m, line.start_m)))
        assert line.height_m(at_m) == pytest.approx(exact_m, abs=1e-9)
        # No gradient is steeper than 60 per mille here, so the height a micrometre further is the
        # same.
        assert line.height_m(at_m + 1e-6) == pytest.approx(line.height_m(at_m), abs=1e-7)


def test_the_front_is_under_a_new_limit_exactly_at_its_edge() -> None:
    slow_from_m, length_m = 1500.0, 68.59

    assert FLORENCE.least_limit_mps(slow_from_m - length_m, slow_from_m - 1e-9) == 70.0 / 3.6
    assert FLORENCE.least_limit_mps(slow_from_m - length_m, slow_from_m) == 40.0 / 3.6
    assert FLORENCE.least_limit_mps(1900.0 - 1e-9, 1900.0 - 1e-9 + length_m) == 40.0 / 3.6
    assert FLORENCE.least_limit_mps(1900.0, 1900.0 + length_m) == 70.0 / 3.6


def test_a_train_longer_than_the_slow_section_is_held_by_it() -> None:
    assert FLORENCE.least_limit_mps(1400.0, 2000.0) == 40.0 / 3.6


def test_a_train_partly_off_the_line_is_on_level_track_there() -> None:
    """Forty metres of the train are on the climb at the start of the line and forty before the
    line."""
    line = LineMap(
        name="ramp",
        start_m=0.0,
        end_m=100.0,
        stations=(Station("only", 50.0, 0.0, 60.0),),
        speed_sections=(SpeedSection(0.0, 100.0, 10.0),),
        gradients=(GradientSection(0.0, 100.0, 20.0),),
    )

    assert line.mean_gradient_permille(-40.0, 40.0) == pytest.approx(10.0)
    assert line.worst_gradient_permille(-40.0, 40.0) == 0.0
    assert line.worst_gradient_permille(0.0, 40.0) == 20.0
    assert line.mean_gradient_permille(60.0, 140.0) == pytest.approx(10.0)
    assert line.worst_gradient_permille(60.0, 100.0) == 0.0
    assert line.height_m(1e6) == pytest.approx(2.0)
    assert (line.limit_mps(-1e6), line.limit_mps(1e6)) == (10.0, 10.0)


def test_the_shipped_line_equals_the_published_one() -> None:
    """Tables 3 and 4 and the signalling scenario of section III.C of [Allotta 2013]."""
    assert {station.name: station.stop_m for station in FLORENCE.stations} == {
        "Start": 0.0,
        "I": 1500.0,
        "II": 3000.0,
        "III": 3500.0,
        "IV": 4500.0,
    }
    assert [(g.start_m, g.end_m, g.gradient_permille) for g in FLORENCE.gradients] == [
        (650.0, 750.0, 30.0),
        (1800.0, 1900.0, -30.0),
    ]
    assert [(c.start_m, c.end_m, c.radius_m) for c in FLORENCE.curves] == [(1600.0, 1700.0, 100.0)]
    for at_m, limit_kmh in ((0, 70), (1499, 70), (1500, 40), (1899, 40), (1900, 70), (4500, 70)):
        assert FLORENCE.limit_mps(at_m) == pytest.approx(limit_kmh * KMH)
    assert FLORENCE.height_m(1000.0) == pytest.approx(3.0)
    assert FLORENCE.height_m(2000.0) == pytest.approx(0.0)


@pytest.mark.parametrize("name", ["I", "II", "III", "IV"])
def test_three_tags_lead_to_every_stop_and_a_fourth_lies_under_the_antenna(name: str) -> None:
    """The tags lie 50, 10 and 1.5 m before the stop, for an antenna 2 m behind the front
    coupler."""
    stop_m, antenna_m = FLORENCE.station(name).stop_m, 2.0

    to_stop_m = {
        tag.kind: stop_m - antenna_m - tag.position_m
        for tag in FLORENCE.tags
        if tag.station == name
    }

    assert to_stop_m == {TagKind.T1: 50.0, TagKind.T2: 10.0, TagKind.T3: 1.5, TagKind.STOP: 0.0}


def test_every_published_train_fits_between_line_start_and_first_stop() -> None:
    consist_m = 2 * 17.455 + 2 * 16.84

    assert FLORENCE.stations[0].stop_m - consist_m >= FLORENCE.start_m
    for station in FLORENCE.stations:
        assert station.platform_start_m <= station.stop_m - consist_m
        assert station.side is PlatformSide.RIGHT


def test_stations_between_excludes_the_present_and_includes_the_last_station() -> None:
    assert [s.name for s in FLORENCE.stations_between(0.0, 3500.0)] == ["I", "II", "III"]
    assert [s.name for s in FLORENCE.stations_between(1500.0, 1500.0)] == []


def test_an_unknown_station_is_reported_with_the_known_ones() -> None:
    with pytest.raises(KeyError, match=r"florence has no station V; it has Start, I, II, III, IV"):
        FLORENCE.station("V")


@pytest.mark.parametrize("name", settings.shipped_names("firmware_py.trackdb"))
def test_every_shipped_line_loads(name: str) -> None:
    assert load_line(name).name == name


def florence_table() -> dict[str, Any]:
    return settings.parse(settings.find("florence", "firmware_py.trackdb"))


def changed(key: str, index: int, **values: Any) -> dict[str, Any]:
    """The shipped line with some values of one of its entries replaced."""
    table = florence_table()
    table[key][index] |= values
    return table


def bored(drag_ratio: float, end_m: float = 300.0) -> dict[str, Any]:
    """Florence with a tunnel."""
    tunnel = {"start_m": 100.0, "end_m": end_m, "drag_ratio": drag_ratio}
    return {**florence_table(), "tunnels": [tunnel]}


def powered(*sections: tuple[float, float, str]) -> dict[str, Any]:
    """Florence with power sections of these ends and names."""
    keys = ("start_m", "end_m", "name")
    tables = [dict(zip(keys, each, strict=True)) for each in sections]
    return {**florence_table(), "power_sections": tables}


def without(key: str, index: int) -> dict[str, Any]:
    table = florence_table()
    del table[key][index]
    return table


def swapped(key: str, index: int) -> dict[str, Any]:
    table = florence_table()
    entries = table[key]
    entries[index], entries[index + 1] = entries[index + 1], entries[index]
    return table


def test_air_drag_rises_in_tunnels_by_the_share_of_the_train_inside() -> None:
    tunnels = (TunnelSection(100.0, 200.0, 2.0), TunnelSection(200.0, 250.0, 3.0))
    line = replace(load_line("florence"), tunnels=tunnels)

    ratios = [line.drag_ratio(at_m) for at_m in (99.9, 100.0, 199.9, 200.0, 249.9, 250.0)]
    assert ratios == [1.0, 2.0, 2.0, 3.0, 3.0, 1.0]
    for rear_m, mean in ((0.0, 1.0), (50.0, 1.5), (150.0, 2.5), (200.0, 2.0), (250.0, 1.0)):
        assert line.mean_drag_ratio(rear_m, rear_m + 100.0) == pytest.approx(mean)


@pytest.mark.parametrize(
    ("table", "said"),
    [
        (swapped("stations", 1), "stations: I at 1500.0 m is out of order after II at 3000.0 m"),
        (changed("stations", 2, name="I"), "stations: I occurs twice"),
        (changed("stations", 2, stop_m=3006.0), "stations[2]: station II: stop_m 3006.0 is not"),
        (changed("stations", 2, dwell_s=-1.0), "stations[2]: station II: dwell_s -1.0 is negative"),
        (changed("stations", 4, platform_end_m=4701.0), "stations: IV is not on the line"),
        (changed("stations", 2, side="middle"), "stations[2].side: 'middle': valid values: left"),
        (changed("stations", 2, stop=1.0), "stations[2].stop: unknown key; nearest valid key: sto"),
        ({**florence_table(), "stations": []}, "stations: there is none"),
        (without("speed_sections", 1), "speed_sections: a section starts at 1900.0 m where 1500"),
        (without("speed_sections", 2), "speed_sections: they end at 1900.0 m, the line at 4700"),
        (swapped("speed_sections", 0), "speed_sections: a section starts at 1500.0 m where -120"),
        (changed("speed_sections", 1, limit_mps=0.0), "speed_sections[1]: limit_mps 0.0 is not"),
        (changed("speed_sections", 1, end_m=1500.0), "speed_sections[1]: end_m 1500.0 is not be"),
        ({**florence_table(), "speed_sections": []}, "speed_sections: they end at -120.0 m"),
        (changed("gradients", 0, end_m=1850.0), "gradients: the section at 1800 m begins before"),
        (changed("gradients", 0, start_m=-121.0), "gradients: the section from -121.0 m to 750.0"),
        (changed("gradients", 1, gradient_permille=-121), "gradients[1]: gradient_permille -121.0"),
        (swapped("gradients", 0), "gradients: the section at 650 m begins before"),
        (changed("curves", 0, radius_m=49.0), "curves[0]: radius_m 49.0 is under 50"),
        (changed("curves", 0, end_m=4701.0), "curves: the section from 1600.0 m to 4701.0 m is n"),
        (swapped("tags", 3), "tags: tag 1650 at 650.0 m is out of order after tag 1900 at 900.0"),
        (changed("tags", 3, tag_id=4), "tags: tag_id 4 occurs twice"),
        (changed("tags", 3, tag_id=0), "tags[3]: tag_id 0 is not in 1..4294967295"),
        (changed("tags", 3, tag_id=2**32), "tags[3]: tag_id 4294967296 is not in 1..4294967295"),
        (changed("tags", 3, station="V"), "tags: tag 1650 serves unknown station V"),
        (changed("tags", 0, position_m=-121.0), "tags: tag 4 at -121.0 m is not on the line"),
        (changed("tags", 3, kind="t4"), "tags[3].kind: 't4': valid values: balise, t1, t2"),
        (
            powered((-120.0, 900.0, "N"), (899.0, 4700.0, "S")),
            "power_sections: S at 899 m begins b",
        ),
        (bored(0.9), "tunnels[0]: drag_ratio 0.9 is not in 1..10"),
        (bored(10.1), "tunnels[0]: drag_ratio 10.1 is not in 1..10"),
        (bored(2.0, end_m=4701.0), "tunnels: the section from 100.0 m to 4701.0 m is not on the"),
        (
            powered((-120.0, 900.0, "")),
            "power_sections: the one at -120 m has no name; give it one",
        ),
        ({**florence_table(), "end_m": -120.0}, "end_m -120.0 is not beyond start_m -120.0"),
    ],
)
def test_a_contradiction_in_a_line_is_reported_with_file_and_key(
    table: dict[str, Any], said: str, tmp_path: Path
) -> None:
    path = tmp_path / "line.toml"
    path.write_text(tomli_w.dumps(table), encoding="utf-8")

    with pytest.raises(SettingsError) as caught:
        load_line(str(path))

    assert re.match(rf"{re.escape(str(path))}(:\d+)?: {re.escape(said)}", str(caught.value))


@pytest.mark.parametrize(
    "change",
    [
        {"start_m": float("nan")},
        {"end_m": float("nan")},
        {"tags": (TagSite(1, float("nan")),)},
        {"stations": (replace(FLORENCE.stations[0], platform_end_m=float("inf")),)},
    ],
)
def test_a_line_with_nan_or_infinity_is_refused(change: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"nan|not on the line"):
        replace(FLORENCE, **change)


SHORT = (
    StoppingPoint(train_length_max_m=40.0, stop_m=60.0),
    StoppingPoint(train_length_max_m=80.0, stop_m=80.0),
)


@pytest.mark.parametrize(
    ("length_m", "stop_m"),
    [(1.0, 60.0), (40.0, 60.0), (40.1, 80.0), (80.0, 80.0), (80.1, 100.0), (400.0, 100.0)],
)
def test_a_train_takes_the_first_stopping_point_that_its_length_permits(
    length_m: float, stop_m: float
) -> None:
    station = Station("A", 100.0, 0.0, 105.0, short_stops=SHORT)

    assert station.stops_m == (100.0, 60.0, 80.0)
    assert station.for_train(length_m) == Station("A", stop_m, 0.0, 105.0)


def test_a_line_has_the_stopping_points_of_its_train() -> None:
    stations = tuple(
        replace(each, short_stops=(StoppingPoint(80.0, each.stop_m - 10.0),))
        for each in FLORENCE.stations
    )
    line = replace(FLORENCE, stations=stations)

    assert [each.stop_m for each in line.for_train(70.0).stations_between(1.0, 4600.0)] == [
        1490.0, 2990.0, 3490.0, 4490.0,
    ]  # fmt: skip
    assert line.for_train(90.0) == FLORENCE
    assert FLORENCE.for_train(70.0) is FLORENCE


def test_stopping_points_lie_along_the_platform_in_order_of_length() -> None:
    with pytest.raises(ValueError, match=r"short_stops: train_length_max_m must rise"):
        Station("A", 100.0, 0.0, 105.0, short_stops=SHORT[::-1])
    with pytest.raises(ValueError, match=r"stop_m 106\.0 is not along its platform"):
        Station("A", 100.0, 0.0, 105.0, short_stops=(StoppingPoint(40.0, 106.0),))
    with pytest.raises(ValueError, match=r"train_length_max_m 0\.0 is not positive"):
        StoppingPoint(0.0, 60.0)


@pytest.mark.parametrize("rollback_m", [0.0, -1.0, 10.1, float("nan")])
def test_the_limit_of_rollback_has_a_range(rollback_m: float) -> None:
    with pytest.raises(ValueError, match=r"rollback_m .* is not in"):
        replace(FLORENCE, rollback_m=rollback_m)
