"""Every seed gives a valid line, and lines differ."""

import itertools
import random
from collections import Counter
from dataclasses import asdict

import pytest

from metro_hil.simulation.generate import (
    DEFAULT_PROFILES,
    PROFILES,
    Draw,
    default_profile,
    draw,
)
from metro_hil.simulation.railway_events import some_of

FIRST = {name: seed for seed, name in DEFAULT_PROFILES}
"""First seed of each profile."""
VARIED_FROM, DENSE_FROM = FIRST["varied"], FIRST["dense"]
SIDINGS_FROM, CHOOSY_FROM = FIRST["sidings"], FIRST["choosy"]
ANY = [draw(seed) for seed in range(VARIED_FROM, VARIED_FROM + 300)]
DENSE = [draw(seed) for seed in range(DENSE_FROM, DENSE_FROM + 300)]


def _even(drawn: Draw) -> bool:
    return len({area.end_m - area.start_m for area in drawn.cast.line.areas}) == 1


def test_the_same_seed_gives_the_same_line() -> None:
    assert [draw(seed) for seed in range(VARIED_FROM, VARIED_FROM + 20)] == ANY[:20]


@pytest.mark.parametrize("seed", [1, 42, 3794, VARIED_FROM - 1])
def test_below_the_limit_areas_have_one_length(seed: int) -> None:
    drawn = draw(seed)
    assert drawn.cast.line.areas[0].end_m == 2000.0
    assert _even(drawn)
    assert (drawn.setting.length_m, drawn.between_s) == (80.0, 12.0)


def test_all_trains_stand_on_the_line_apart() -> None:
    for drawn in [*ANY, *DENSE]:
        line, length_m = drawn.cast.line, drawn.setting.length_m
        fronts_m = [drawn.setting.fronts_m[train] for train in drawn.cast.trains]
        assert len(fronts_m) >= 2
        assert fronts_m[0] - length_m >= 15.0
        assert fronts_m[-1] <= line.end_m - 15.0
        for behind_m, ahead_m in itertools.pairwise(fronts_m):
            assert ahead_m - length_m >= behind_m + 39.9


def test_late_seeds_have_sidings_and_trains_of_several_lengths() -> None:
    assert [draw(SIDINGS_FROM - 1).sidings, draw(SIDINGS_FROM).sidings] == [False, True]
    assert draw(SIDINGS_FROM - 1).setting.builds == {}
    settings = [draw(seed).setting for seed in range(SIDINGS_FROM, SIDINGS_FROM + 100)]
    builds = [(each, setting.length_m) for setting in settings for each in setting.builds.values()]
    trains = sum(len(setting.fronts_m) for setting in settings)
    assert 0.4 * trains < len(builds) < 0.6 * trains
    assert all(20.0 <= each.length_m <= longest_m for each, longest_m in builds)
    assert {each.axles for each, _ in builds} == {4, 8, 12, 16, 24}


def test_lines_differ() -> None:
    lines = [drawn.cast.line for drawn in ANY]
    assert {len(line.areas) for line in lines} == {1, 2, 3, 4}
    assert {line.apply_m for line in lines} == {400.0, 800.0, 1200.0}
    assert {len(drawn.cast.trains) for drawn in ANY} == {2, 3, 4, 5, 6, 7}
    assert len({len(line.sections) for line in lines}) > 30
    assert len({drawn.setting.length_m for drawn in ANY}) == 4
    assert not all(_even(drawn) for drawn in ANY)


def test_the_last_seeds_have_many_trains_and_events() -> None:
    def metres(drawn: list[Draw]) -> float:
        trains = sum(len(each.cast.trains) for each in drawn)
        return sum(each.cast.line.end_m for each in drawn) / trains

    assert metres(DENSE) < 0.6 * metres(ANY)
    assert all(each.between_s <= 3.0 and each.faults_s == (0.7, 15.0) for each in DENSE)
    assert all(each.sidings and each.by_hand and each.choosy for each in DENSE)
    assert 0.2 * len(DENSE) < sum(each.disturbed for each in DENSE) < 0.4 * len(DENSE)
    assert {each.foul_share for each in DENSE} == {0.0, 0.1, 0.3}
    assert 0.4 * len(DENSE) < sum(each.foul_share > 0.0 for each in DENSE) < 0.6 * len(DENSE)
    before = [draw(seed) for seed in range(DENSE_FROM - 50, DENSE_FROM)]
    assert {(each.faults_s, each.foul_share) for each in before} == {((1.0, 40.0), 0.0)}


def test_objects_lie_at_borders_too() -> None:
    sites = [(site, drawn.cast.line) for drawn in ANY for site in drawn.cast.line.objects]
    assert any(site.end_m == line.area_at(site.start_m).end_m for site, line in sites)
    assert any(site.start_m == line.area_at(site.start_m).start_m for site, line in sites)
    assert {site.kind for site, _ in sites} == {1, 2, 3}


def test_stops_are_on_the_line() -> None:
    for drawn in ANY:
        stops_m = list(drawn.setting.stops_m)
        assert stops_m == sorted(stops_m)
        assert all(0.0 < stop_m < drawn.cast.line.end_m for stop_m in stops_m)


def test_a_selective_seed_chooses_a_subset_of_events() -> None:
    assert [draw(CHOOSY_FROM - 1).choosy, draw(CHOOSY_FROM).choosy] == [False, True]
    things = [(name, list) for name in "aabcccc"]

    chosen = [Counter(n for n, _ in some_of(things, random.Random(n))) for n in range(300)]

    assert {len(each) for each in chosen} == {1, 2, 3}
    assert {name for each in chosen for name in each} == {"a", "b", "c"}
    assert {times for each in chosen for times in each.values()} == {1, 2, 4, 8}


def test_each_profile_has_the_features_of_the_one_before_it_and_one_more() -> None:
    assert [name for _, name in DEFAULT_PROFILES] == list(PROFILES)
    features = [
        {key for key, value in asdict(profile).items() if value is True}
        for profile in PROFILES.values()
    ]

    assert features[0] == {"even"}
    assert features[1] == set()
    for before, after in itertools.pairwise(features[1:]):
        assert before < after
        assert len(after - before) == 1


@pytest.mark.parametrize(("first", "name"), DEFAULT_PROFILES)
def test_a_seed_has_the_profile_of_its_range(first: int, name: str) -> None:
    assert default_profile(first).name == name
    assert first == 0 or default_profile(first - 1).name != name


def test_a_named_profile_takes_the_place_of_that_of_the_seed() -> None:
    assert draw(1, PROFILES["dense"]) != draw(1)
    assert draw(1, PROFILES["dense"]).choosy
    assert draw(DENSE_FROM, PROFILES["dense"]) == draw(DENSE_FROM)
    assert not draw(DENSE_FROM, PROFILES["varied"]).choosy
