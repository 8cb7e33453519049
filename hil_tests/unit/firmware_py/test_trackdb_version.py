"""The version of a track database changes with everything that trains and wayside rely on."""

import dataclasses
from dataclasses import replace
from typing import Any

import pytest

from firmware_py.settings import shipped_names
from firmware_py.trackdb import LineMap, LineZone, PlatformSide, load_line
from firmware_py.trackdb.version import database_version, version_of, version_text

LINE = load_line("florence")


def resurveyed(field: str, **changes: Any) -> LineMap:
    """The line with one changed item of one of its tables."""
    first, *rest = getattr(LINE, field)
    changed: dict[str, Any] = {field: (replace(first, **changes), *rest)}
    return replace(LINE, **changed)


def test_no_two_shipped_lines_have_the_same_version() -> None:
    versions = {database_version(load_line(name)) for name in shipped_names("firmware_py.trackdb")}

    assert len(versions) == len(shipped_names("firmware_py.trackdb"))


def test_the_version_is_the_same_on_every_machine() -> None:
    """Recorded once. It changes only together with the data or the fields of the line."""
    assert version_text(version_of((1, 0.1, "a", True, None))) == "59e3a9fc"


@pytest.mark.parametrize(
    "other",
    [
        replace(LINE, name="Florence"),
        replace(LINE, tags=LINE.tags[:-1]),
        resurveyed("tags", position_m=LINE.tags[0].position_m + 0.01),
        resurveyed("tags", tag_id=9999),
        resurveyed("speed_sections", limit_mps=LINE.speed_sections[0].limit_mps + 0.1),
        resurveyed("stations", stop_m=LINE.stations[0].stop_m + 0.01),
        resurveyed("stations", side=PlatformSide.LEFT),
        resurveyed("gradients", gradient_permille=1.0),
        replace(LINE, neutral_sections=(LineZone(100.0, 130.0),)),
        replace(LINE, no_stop_zones=(LineZone(100.0, 130.0),)),
        replace(LINE, evacuation_stops=(LineZone(100.0, 130.0, "exit"),)),
    ],
)
def test_another_survey_has_another_version(other: LineMap) -> None:
    assert database_version(other) != database_version(LINE)


@pytest.mark.parametrize(
    "other",
    [
        replace(LINE, description="another"),
        resurveyed("stations", dwell_s=5.0, run_s=99.0),
        replace(LINE, start_m=int(LINE.start_m)),
    ],
)
def test_timetable_and_description_belong_to_no_survey(other: LineMap) -> None:
    assert database_version(other) == database_version(LINE)


def test_every_vital_field_counts() -> None:
    """A field that is added to a site belongs to the version."""
    station = LINE.stations[0]
    counted = {field.name for field in dataclasses.fields(station)} - {"dwell_s", "run_s"}

    for name in counted:
        value = getattr(station, name)
        changed = value + 1.0 if isinstance(value, float) else f"not {value}"
        other = object.__new__(type(station))
        for field in dataclasses.fields(station):
            object.__setattr__(other, field.name, getattr(station, field.name))
        object.__setattr__(other, name, changed)
        assert version_of(other) != version_of(station), name
