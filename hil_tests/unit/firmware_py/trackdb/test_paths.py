"""Paths over tracks: translation there and back, the mirrored line, and contradictions."""

import itertools
from dataclasses import replace
from typing import Any, Final

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.settings import SettingsError, shipped_names
from firmware_py.trackdb import TagKind, load_line
from firmware_py.trackdb.network import (
    Join,
    PlatformEdge,
    Running,
    Serves,
    Track,
    TrackCrossing,
    TrackLimit,
    TrackNetwork,
    TrackSwitch,
    TrackTag,
    TrackZone,
)
from firmware_py.trackdb.one_track import DOWN_TAGS, network_of, one_track_path
from firmware_py.trackdb.paths import TrackPlace, make_path
from firmware_py.trackdb.sites import GradientSection, StoppingPoint, TunnelSection
from metro_hil.benchmarks.mirrored import flipped

SHIPPED: Final = shipped_names("firmware_py.trackdb")
UP, DOWN = Running.UP, Running.DOWN


def straight(name: str, start_m: float, end_m: float, **parts: Any) -> Track:
    return Track(name, start_m, end_m, (TrackLimit(start_m, end_m, 20.0),), **parts)


@pytest.mark.parametrize("name", SHIPPED)
def test_the_mirrored_line_run_down_is_the_line_run_up(name: str) -> None:
    network = network_of(load_line(name))
    mirrored = replace(network, tracks=(flipped(network.tracks[0]),))

    for running in Running:
        path = make_path(network, "path", (("main", running),))
        mirror = make_path(mirrored, "path", (("main", running.other),))
        assert path.line == mirror.line


@given(
    st.integers(-90_000, 9_000_000),
    st.lists(st.integers(1, 200_000), min_size=4, max_size=12, unique=True),
)
def test_mirrored_places_have_the_same_chainage_to_the_last_bit(
    start_cm: int, lengths_cm: list[int]
) -> None:
    """The sums of both directions round differently, which chainages of a path must not show."""
    edges_m = [each / 100.0 for each in itertools.accumulate(lengths_cm, initial=start_cm)]
    pairs = list(itertools.pairwise(edges_m))
    platform = PlatformEdge("S", *pairs[1], stop_up_m=pairs[1][1], stop_down_m=pairs[1][0])
    track = straight(
        *("main", edges_m[0], edges_m[-1]),
        platforms=(platform,),
        gradients=tuple(GradientSection(*pair, 5.0 * n) for n, pair in enumerate(pairs, 1)),
        neutral_sections=(TrackZone(*pairs[2]),),
        tunnels=tuple(TunnelSection(*pair, 1.5 + n) for n, pair in enumerate(pairs[:3])),
        power_sections=tuple(TrackZone(*pair, f"S{n}") for n, pair in enumerate(pairs)),
        tags=tuple(TrackTag(n, at_m) for n, at_m in enumerate(edges_m, 1)),
    )
    network = TrackNetwork("drawn", (track,), buffer_stops=("main.start", "main.end"))
    mirrored = replace(network, tracks=(flipped(track),))

    for running in Running:
        path = make_path(network, "path", (("main", running),))
        assert path.line == make_path(mirrored, "path", (("main", running.other),)).line


def test_zones_hold_for_the_directions_that_they_name_and_join_where_tracks_meet() -> None:
    track = replace(
        network_of(replace(load_line("florence"), tags=())).tracks[0],
        neutral_sections=(TrackZone(100.0, 130.0), TrackZone(900.0, 940.0, "up", Serves.UP)),
    )
    start_m, end_m = track.start_m, track.end_m
    ends = (TrackZone(start_m, start_m + 9.0, direction=Serves.DOWN), TrackZone(end_m - 9.0, end_m))
    far = replace(track, name="far", platforms=(), neutral_sections=ends[:1])
    near_track = replace(track, neutral_sections=(*track.neutral_sections, *ends[1:]))
    network = TrackNetwork(
        "two", (near_track, far), (Join("main.end", "far.start"),), (), ("main.start", "far.end")
    )

    up = make_path(network, "up", (("main", Running.UP), ("far", Running.UP))).line
    down = make_path(network, "down", (("far", Running.DOWN), ("main", Running.DOWN))).line

    assert [each.start_m for each in up.neutral_sections] == [100.0, 900.0, end_m - 9.0]
    (joint, other) = down.neutral_sections
    assert joint.end_m - joint.start_m == pytest.approx(18.0)
    assert other.end_m - other.start_m == pytest.approx(30.0)


@pytest.mark.parametrize(("name", "sections"), [("S1", ["S1"]), ("S2", ["S1", "S2"])])
def test_power_sections_join_only_with_parts_of_the_same_name(
    name: str, sections: list[str]
) -> None:
    near = straight("near", 0.0, 300.0, power_sections=(TrackZone(0.0, 300.0, "S1"),))
    platform = PlatformEdge("S", 0.0, 100.0, stop_up_m=90.0, stop_down_m=10.0)
    far = straight(
        *("far", 0.0, 200.0), platforms=(platform,), power_sections=(TrackZone(0.0, 200.0, name),)
    )
    network = TrackNetwork(
        "two", (near, far), (Join("near.end", "far.start"),), (), ("near.start", "far.end")
    )

    up = make_path(network, "up", (("near", UP), ("far", UP))).line
    down = make_path(network, "down", (("far", DOWN), ("near", DOWN))).line

    assert [each.name for each in up.power_sections] == sections
    assert [each.name for each in down.power_sections] == sections[::-1]
    assert [each.end_m for each in up.power_sections[:-1]] == [300.0] * (len(sections) - 1)
    assert up.power_sections[-1].end_m == 500.0


@pytest.mark.parametrize("name", SHIPPED)
def test_the_path_up_is_the_line_of_the_file(name: str) -> None:
    """Only the counterparts of stop tags come in, and the dwell time of a first station."""
    line, path = load_line(name), load_line(f"{name}:up")

    tags = tuple(tag for tag in path.tags if tag.tag_id < DOWN_TAGS)
    first = replace(path.stations[0], dwell_s=line.stations[0].dwell_s)
    stations = (first, *path.stations[1:])
    assert replace(path, name=line.name, tags=tags, stations=stations) == line


@pytest.mark.parametrize("name", SHIPPED)
def test_stop_tags_lie_before_the_stopping_points_of_both_directions(name: str) -> None:
    line = load_line(name)

    for running in Running:
        path = one_track_path(line, running).line
        for station in path.stations[1:]:
            own = {tag.kind for tag in path.tags if tag.station == station.name}
            assert own >= {TagKind.T1, TagKind.T2, TagKind.T3, TagKind.STOP}
            for tag in path.tags:
                if tag.station == station.name:
                    assert 0.0 < station.stop_m - tag.position_m <= 60.0


def test_short_trains_stop_in_the_other_direction_by_the_same_distance_from_the_end() -> None:
    line = load_line("florence")
    short = replace(line.station("I"), short_stops=(StoppingPoint(40.0, 1470.0),))
    line = replace(line, stations=(line.stations[0], short, *line.stations[2:]))

    station = one_track_path(line, DOWN).line.station("I")

    assert station.platform_end_m - station.short_stops[0].stop_m == pytest.approx(35.0)
    assert station.for_train(30.0).stop_m == station.short_stops[0].stop_m


def triangle() -> TrackNetwork:
    """Two lines that a switch brings together, each with a chainage of its own."""
    return TrackNetwork(
        "triangle",
        (
            straight("a", 100.0, 400.0, gradients=(GradientSection(150.0, 200.0, 10.0),)),
            straight("b", 0.0, 250.0),
            straight("c", -50.0, 900.0, tags=(TrackTag(7, 0.0),)),
            straight("d", 10.0, 60.0),
        ),
        joins=(Join("c.end", "d.end"),),
        switches=(TrackSwitch("W1", tip="c.start", left="a.end", right="b.start"),),
        buffer_stops=("a.start", "b.end", "d.start"),
    )


WAYS: Final = (
    (("a", UP), ("c", UP), ("d", DOWN)),
    (("d", UP), ("c", DOWN), ("a", DOWN)),
    (("d", UP), ("c", DOWN), ("b", UP)),
    (("b", DOWN), ("c", UP)),
)


@given(st.sampled_from(WAYS), st.floats(0.0, 1.0))
def test_a_place_translates_there_and_back(
    way: tuple[tuple[str, Running], ...], share: float
) -> None:
    network = triangle()
    stations = (PlatformEdge("S", 300.0, 500.0, stop_up_m=450.0, stop_down_m=350.0),)
    tracks = tuple(
        replace(each, platforms=stations) if each.name == "c" else each for each in network.tracks
    )
    path = make_path(replace(network, tracks=tracks), "way", way)
    line = path.line
    at_m = line.start_m + share * (line.end_m - line.start_m)

    place = path.to_track(at_m)

    track = network.track(place.track)
    assert track.start_m - 1e-9 <= place.at_m <= track.end_m + 1e-9
    assert path.to_path(place) == pytest.approx(at_m, abs=1e-9)


def test_a_climb_up_is_a_fall_down() -> None:
    network = network_of(load_line("florence"))
    up, down = (make_path(network, "way", (("main", each),)) for each in Running)

    for at_m in (10.0, 700.0, 1850.0, 4000.0):
        other_m = down.to_path(up.to_track(at_m))
        assert down.line.gradient_permille(other_m) == -up.line.gradient_permille(at_m)
        assert down.line.limit_mps(other_m) == up.line.limit_mps(at_m)


def test_a_place_of_another_track_is_refused() -> None:
    path = one_track_path(load_line("florence"), UP)

    with pytest.raises(KeyError, match="does not run over track siding"):
        path.to_path(TrackPlace("siding", 0.0, UP))


def crossing(a_m: float = 200.0, b: str = "c", clear_m: float = 20.0) -> TrackCrossing:
    return TrackCrossing("K", "a", a_m, b, 50.0, clear_m)


@pytest.mark.parametrize(
    ("way", "problem"),
    [
        ((), "there is none"),
        ((("a", UP), ("b", UP)), "no join or switch leads from a.end to b.start"),
        ((("a", DOWN), ("c", UP)), "no join or switch leads from a.start to c.start"),
        ((("a", UP), ("c", UP), ("a", UP)), "a occurs twice"),
        ((("e", UP),), "has no track e"),
    ],
)
def test_an_impossible_way_is_refused(way: tuple[tuple[str, Running], ...], problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        make_path(triangle(), "way", way)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"switches": (TrackSwitch("W1", "c.start", "a.end", ""),)}, "W1: right has no track end"),
        ({"buffer_stops": ("a.start", "b.end")}, "d.start leads nowhere"),
        ({"buffer_stops": ("a.start", "b.end", "a.end")}, "two tracks would lie at one place"),
        ({"joins": (Join("c.end", "d.middle"),)}, "no track end 'd.middle'"),
        ({"tracks": ()}, "there is none"),
        ({"crossings": (TrackCrossing("K", "a", 200.0, "x", 1.0),)}, "K: b: there is no track 'x'"),
        ({"crossings": (TrackCrossing("K", "a", -1.0, "c", 1.0),)}, "K: a_m -1 is not on track a"),
        (
            {"crossings": (TrackCrossing("K", "a", 200.0, "c", 50.0),) * 2},
            "crossings: K occurs twice",
        ),
        (
            {"tracks": (straight("a", 0.0, 1.0), straight("a", 0.0, 1.0))},
            "tracks: a occurs twice",
        ),
    ],
)
def test_a_network_that_contradicts_itself_is_refused(change: dict[str, Any], problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        replace(triangle(), **change)


@pytest.mark.parametrize(
    ("b", "clear_m", "problem"),
    [("a", 20.0, "K: a and b both name track a"), ("c", 0.0, "clear_m 0.0 is not positive")],
)
def test_a_crossing_that_contradicts_itself_is_refused(
    b: str, clear_m: float, problem: str
) -> None:
    with pytest.raises(ValueError, match=problem):
        crossing(b=b, clear_m=clear_m)


@pytest.mark.parametrize(
    ("parts", "problem"),
    [
        ({"gradients": (GradientSection(0.0, 9.0, 1.0), GradientSection(8.0, 9.0, 1.0))}, "before"),
        (
            {"power_sections": (TrackZone(0.0, 9.0, "S1", Serves.UP),)},
            "S1: direction up: a contact line feeds both",
        ),
        (
            {"power_sections": (TrackZone(0.0, 9.0, "S1"), TrackZone(8.0, 9.0, "S2"))},
            "power_sections: S2 at 8 m begins before S1 ends, at 9 m",
        ),
        ({"tags": (TrackTag(1, 101.0),)}, "tag 1 at 101 m is not on the track"),
        ({"tags": (TrackTag(1, 5.0), TrackTag(2, 5.0))}, "out of order"),
        ({"platforms": (PlatformEdge("S", -1.0, 9.0),)}, "not on the track"),
    ],
)
def test_a_track_that_contradicts_itself_is_refused(parts: dict[str, Any], problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        straight("a", 0.0, 100.0, **parts)


def test_limits_must_cover_each_direction_once() -> None:
    both, up = TrackLimit(0.0, 50.0, 20.0), TrackLimit(50.0, 90.0, 10.0, Serves.UP)

    with pytest.raises(ValueError, match="limits: down: they end at 50 m, the track at 90 m"):
        Track("a", 0.0, 90.0, (both, up))

    track = Track("a", 0.0, 90.0, (both, up, TrackLimit(50.0, 90.0, 15.0, Serves.DOWN)))
    assert [limit.limit_mps for limit in track.limits_for(DOWN)] == [20.0, 15.0]


def test_an_unknown_route_of_a_line_file_is_refused() -> None:
    with pytest.raises(SettingsError, match="route 'dwn': nearest valid route: down"):
        load_line("florence:dwn")
