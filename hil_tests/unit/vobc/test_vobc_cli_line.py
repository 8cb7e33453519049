"""Which stops of a line a train that commands itself can reach."""

import argparse
from dataclasses import replace

import pytest

from firmware_py.settings import SettingsError
from firmware_py.trackdb import LineMap, SpeedSection, Station, load_line
from vobc.cli.line import areas_of

FLORENCE = load_line("florence")
"""The Florence line; its areas reach from -120 m to 4700 m."""
BY_RADIO = argparse.Namespace(line_radio="tcp/127.0.0.1:7447", line="florence")


def longer_line(*stations: Station) -> LineMap:
    """A line that extends beyond its areas at both ends."""
    speed = SpeedSection(-300.0, 5_000.0, 19.0)
    return replace(
        FLORENCE, start_m=-300.0, end_m=5_000.0, speed_sections=(speed,), stations=stations
    )


def line_with_stop(stop_m: float) -> LineMap:
    """The longer line with its last stopping point at `stop_m`."""
    last = replace(FLORENCE.stations[-1], stop_m=stop_m, platform_end_m=4_900.0)
    return longer_line(*FLORENCE.stations[:-1], last)


@pytest.mark.parametrize("stop_m", [4_500.0, 4_689.0])
def test_a_stop_far_enough_before_the_end_is_accepted(stop_m: float) -> None:
    areas = areas_of(BY_RADIO, line_with_stop(stop_m))

    assert areas is not None
    assert areas.end_m == 4_700.0


@pytest.mark.parametrize("stop_m", [4_689.1, 4_700.0, 4_800.0])
def test_a_stop_too_close_to_the_end_of_the_last_area_is_refused(stop_m: float) -> None:
    words = (
        f"^line florence: station IV: stop_m {stop_m:g} is out of reach: its areas begin at "
        "-120 m and end at 4700 m, and no authority comes nearer to that end than 11 m$"
    )
    with pytest.raises(SettingsError, match=words):
        areas_of(BY_RADIO, line_with_stop(stop_m))


@pytest.mark.parametrize(("stop_m", "reached"), [(-120.0, True), (-120.1, False)])
def test_a_stop_before_the_first_area_is_refused(stop_m: float, *, reached: bool) -> None:
    first = replace(FLORENCE.stations[0], stop_m=stop_m, platform_start_m=-200.0)
    line = longer_line(first, *FLORENCE.stations[1:])
    if reached:
        assert areas_of(BY_RADIO, line) is not None
        return
    with pytest.raises(SettingsError, match=r"station Start: stop_m -120\.1 is out of reach"):
        areas_of(BY_RADIO, line)


def test_a_train_that_a_zone_controller_commands_needs_no_areas() -> None:
    assert areas_of(argparse.Namespace(line_radio=None), line_with_stop(4_800.0)) is None


def test_a_line_that_permits_more_rollback_than_the_trains_keep_free_is_refused() -> None:
    with pytest.raises(SettingsError, match=r"rollback_m 2\.5 is more than the 2 m that trains"):
        areas_of(BY_RADIO, replace(line_with_stop(4500.0), rollback_m=2.5))
