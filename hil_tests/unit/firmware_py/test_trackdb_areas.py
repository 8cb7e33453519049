"""The division of a line into areas: valid files, and the messages about invalid ones."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.settings import SettingsError
from firmware_py.trackdb.areas import (
    Area,
    AreaMap,
    Division,
    ObjectKind,
    ObjectSite,
    TrackSection,
    load_areas,
)

AREAS = (Area(1, 0.0, 1000.0), Area(2, 1000.0, 1500.0))


def divided(*borders_m: float, section_m: float) -> AreaMap:
    return Division("test", borders_m, section_m, 800.0).area_map()


@pytest.mark.parametrize("name", ["florence", "loop"])
def test_in_shipped_lines_every_section_lies_within_one_area(name: str) -> None:
    line = load_areas(name)

    assert line.sections
    for section in line.sections:
        area = line.area_at(section.start_m)
        assert area.start_m <= section.start_m < section.end_m <= area.end_m


def test_the_last_section_of_an_area_takes_the_rest() -> None:
    line = divided(-120.0, 80.0, 205.0, section_m=100.0)

    assert line.sections == (
        TrackSection(1, -120.0, -20.0),
        TrackSection(2, -20.0, 80.0),
        TrackSection(3, 80.0, 180.0),
        TrackSection(4, 180.0, 205.0),
    )


def test_a_line_without_sections_has_none() -> None:
    assert divided(0.0, 1000.0, 1500.0, section_m=0.0).sections == ()


@pytest.mark.parametrize(
    ("end_m", "ends_m"),
    [(224.9, (100.0, 224.9)), (225.0, (100.0, 200.0, 225.0)), (20.0, (20.0,)), (25.0, (25.0,))],
)
def test_every_section_under_a_train_holds_one_of_its_axles(
    end_m: float, ends_m: tuple[float, ...]
) -> None:
    line = divided(0.0, end_m, end_m + 100.0, section_m=100.0)

    assert tuple([each.end_m for each in line.sections]) == (*ends_m, end_m + 100.0)


@given(
    lengths_m=st.lists(st.floats(10.0, 5000.0), min_size=1, max_size=5),
    section_m=st.floats(25.0, 900.0),
)
def test_sections_have_the_configured_length_without_tiny_remainders(
    lengths_m: list[float], section_m: float
) -> None:
    borders_m = [0.0]
    for length_m in lengths_m:
        borders_m.append(borders_m[-1] + length_m)
    line = divided(*borders_m, section_m=section_m)

    for section in line.sections:
        area = line.area_at(section.start_m)
        least_m = min(25.0, area.end_m - area.start_m) - 1e-6
        assert least_m <= section.end_m - section.start_m <= section_m + 25.0
        if section.end_m not in borders_m:
            assert section.end_m - section.start_m == pytest.approx(section_m)
    assert {area.start_m for area in line.areas} <= {s.start_m for s in line.sections}


def test_inexact_decimal_lengths_leave_no_tiny_section() -> None:
    assert len(divided(0.0, 0.3 * 1000.0, section_m=0.1 * 1000.0).sections) == 3
    assert len(divided(0.0, (0.7 + 0.1) * 1000.0, section_m=0.1 * 1000.0).sections) == 8


@pytest.mark.parametrize(
    ("areas", "sections", "objects", "apply_m", "words"),
    [
        ((), (), (), 800.0, "line test: areas: there is none"),
        ((Area(0, 0.0, 1.0),), (), (), 800.0, "areas: number 0 is not in 1..255"),
        ((Area(256, 0.0, 1.0),), (), (), 800.0, "areas: number 256 is not in 1..255"),
        ((Area(1, 5.0, 5.0),), (), (), 800.0, "areas: 1 from 5.0 m to 5.0 m is no stretch"),
        (
            (Area(1, 0.0, 5.0), Area(2, 6.0, 9.0)),
            (),
            (),
            800.0,
            "areas: 2 starts at 6.0 m where 5.0 m is needed",
        ),
        ((Area(1, 0.0, 5.0), Area(1, 5.0, 9.0)), (), (), 800.0, "areas: a number occurs twice"),
        (
            AREAS,
            (TrackSection(1, 0.0, 1000.0), TrackSection(2, 1000.0, 1400.0)),
            (),
            800.0,
            "sections: they do not reach from 0.0 m to 1500.0 m",
        ),
        (
            AREAS,
            (TrackSection(1, 0.0, 900.0), TrackSection(2, 900.0, 1500.0)),
            (),
            800.0,
            "sections: none begins at 1000.0 m, where area 2 does",
        ),
        (
            AREAS,
            (),
            (ObjectSite(4, ObjectKind.SWITCH, 990.0, 1010.0),),
            800.0,
            "objects: object 4 does not lie within one area",
        ),
        (
            AREAS,
            (),
            (
                ObjectSite(4, ObjectKind.SWITCH, 10.0, 20.0),
                ObjectSite(4, ObjectKind.CROSSING, 30.0, 40.0),
            ),
            800.0,
            "objects: a number occurs twice",
        ),
        (AREAS, (), (), 0.0, "apply_m 0.0 is not positive"),
    ],
)
def test_an_impossible_division_is_refused(
    areas: tuple[Area, ...],
    sections: tuple[TrackSection, ...],
    objects: tuple[ObjectSite, ...],
    apply_m: float,
    words: str,
) -> None:
    with pytest.raises(ValueError, match=words.replace(".", r"\.")):
        AreaMap("test", areas, sections, objects, apply_m)


@pytest.mark.parametrize(
    ("told", "words"),
    [
        ("borders_m = [0.0]\nsection_m = 100.0", "a line has a start and an end"),
        ("borders_m = [0.0, 9.0]\nsection_m = -1.0", "section_m -1.0 is negative"),
        ("borders_m = [0.0, 9.0]\nsection_m = 24.9", "section_m 24.9: a train may stand over it"),
        ("borders_m = [0.0, 9e9]\nsection_m = 25.0", "more than 10,000 sections"),
    ],
)
def test_an_invalid_file_is_refused_by_name_with_its_error(
    tmp_path: Path, told: str, words: str
) -> None:
    path = tmp_path / "odd.toml"
    path.write_text(f'name = "odd"\napply_m = 800.0\n{told}\n')

    with pytest.raises(SettingsError, match=words) as found:
        load_areas(str(path))
    assert "odd.toml" in str(found.value)


def test_areas_know_their_neighbours_objects_and_track() -> None:
    site = ObjectSite(4, ObjectKind.SWITCH, 1000.0, 1010.0)
    line = AreaMap("test", AREAS, (), (site,))

    assert (line.preceding(1), line.following(1)) == (None, AREAS[1])
    assert (line.preceding(2), line.following(2)) == (AREAS[0], None)
    assert (line.objects_in(1), line.objects_in(2)) == ((), (site,))
    assert [line.area_at(at_m).number for at_m in (-5.0, 0.0, 999.9, 1000.0, 9000.0)] == [
        *(1, 1, 1, 2, 2)
    ]
    with pytest.raises(KeyError, match="line test has no area 3"):
        line.area(3)


def test_a_master_gets_its_sections_and_one_beyond_either_border() -> None:
    line = divided(0.0, 300.0, 500.0, 900.0, section_m=100.0)

    assert [section.number for section in line.sections_told(2)] == [3, 4, 5, 6]
    assert [section.number for section in line.sections_told(1)] == [1, 2, 3, 4]
    assert divided(0.0, 300.0, section_m=0.0).sections_told(1) == ()
