"""Line, train and parameters judged together: every relation at both sides of its limit."""

import tomllib
from collections.abc import Mapping
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

import pytest

from firmware_py.settings import SettingsError, override, shipped_names
from firmware_py.trackdb import (
    GradientSection,
    LineMap,
    LineZone,
    Station,
    StoppingPoint,
    load_line,
)
from metro_hil.cli.vobc import main
from vobc.config import VobcConfig, load_config
from vobc.plausible import check_plausible, implausible

LINE = load_line("florence")
CONFIG = load_config("florence4")
LINES = Path(str(resources.files("metro_hil.campaign.shipped"))) / "lines"
EXAMPLES = Path(__file__).parents[3] / "docs" / "examples"


def changed(**changes: Any) -> VobcConfig:
    """The shipped parameters with changes; `__` stands for the dot of a key."""
    dotted = {name.replace("__", "."): value for name, value in changes.items()}
    return override(CONFIG, dotted, "test")


def sloped(permille: float, **changes: Any) -> LineMap:
    return replace(LINE, gradients=(GradientSection(1000.0, 2000.0, permille),), **changes)


def lines_in(path: Path) -> list[str]:
    """Names of the line in a file, or of all routes of a network."""
    routes = tomllib.loads(path.read_text(encoding="utf-8")).get("routes", [])
    return [f"{path}:{route['name']}" for route in routes] or [str(path)]


@pytest.mark.parametrize("params", [*shipped_names("vobc.params"), "shuttle2"])
def test_what_ships_is_plausible_on_every_line_that_ships(params: str) -> None:
    path = str(EXAMPLES / "train" / "shuttle2_params.toml") if params == "shuttle2" else params
    config = load_config(path)
    files = [EXAMPLES / "line" / "harbour.toml", *sorted(LINES.glob("*.toml"))]
    paths = [name for path in files for name in lines_in(path)]

    for name in (*shipped_names("firmware_py.trackdb"), *paths):
        assert implausible(config, load_line(name).for_train(config.train.length_m)) == []


@pytest.mark.parametrize(
    ("fine", "wrong", "words"),
    [
        (
            {"train__antenna_offset_m": 68.59},
            {"train__antenna_offset_m": 68.6},
            "train.antenna_offset_m: 68.6 is more than train.length_m 68.59",
        ),
        (
            {"train__car_lengths_m": [34.0, 34.6]},
            {"train__car_lengths_m": [34.0, 34.7]},
            "train.car_lengths_m: the cars are 68.7 m long together",
        ),
        (
            {"train__length_m": 40.0, "train__car_lengths_m": [2.0] * 20},
            {"train__length_m": 42.0, "train__car_lengths_m": [2.0] * 21},
            "train.car_lengths_m: 21 cars; the door frame carries 20",
        ),
        (
            {"atp__stop_decel_mps2": 1.0},
            {"atp__stop_decel_mps2": 1.01},
            "atp.stop_decel_mps2: 1.01 is more than train.service_decel_max_mps2 1",
        ),
        (
            {"atp__creep_mps": 1.4},
            {"atp__creep_mps": 1.3},
            "must not fall in this order",
        ),
        (
            {"atp__timeouts__desk_s": 0.11},
            {"atp__timeouts__desk_s": 0.1},
            "atp.timeouts.desk_s: 0.1 is not more than the 0.1 s between two frames",
        ),
        (
            {"report_ms": 1799.0},
            {"report_ms": 1800.0},
            "report_ms: 1800 is not less than the 1.8 s for which an authority is fresh",
        ),
        (
            {"odometry__zero_speed_mps": 0.06},
            {"odometry__zero_speed_mps": 0.05},
            "odometry.zero_speed_mps: 0.05 is not more than one pulse in odometry.window_s",
        ),
        (
            {"odometry__tag_bound_m": 0.29},
            {"odometry__tag_bound_m": 0.3},
            "odometry.tag_bound_m: 0.3 is not less than atp.door_window_m 0.3",
        ),
        (
            {"odometry__start_bound_m": 15.0},
            {"odometry__start_bound_m": 15.1},
            "odometry.start_bound_m: 15.1 to both sides is wider than",
        ),
        (
            {"odometry__max_speed_mps": 31.0},
            {"odometry__max_speed_mps": 20.0},
            "odometry.max_speed_mps 20",
        ),
        (
            {"odometry__max_accel_mps2": 1.3},
            {"odometry__max_accel_mps2": 1.29},
            "atp.guaranteed_decel_mps2 1 and 0.294 m/s² of the steepest climb exceed",
        ),
    ],
)
def test_each_relation_of_the_parameters_has_two_sides(
    fine: Mapping[str, Any], wrong: Mapping[str, Any], words: str
) -> None:
    assert implausible(changed(**fine), LINE) == []
    found = implausible(changed(**wrong), LINE)

    assert any(words in text for text in found), found
    with pytest.raises(SettingsError):
        check_plausible(changed(**wrong), LINE)


def test_a_climb_needs_a_limit_of_rollback_that_the_brake_can_keep() -> None:
    assert implausible(CONFIG, sloped(46.0)) == []
    [text] = implausible(CONFIG, sloped(47.0))

    assert text.startswith(
        "line florence: gradients: on the climb of 47 ‰ a train rolls back up to"
    )
    assert implausible(CONFIG, sloped(47.0, rollback_m=2.1)) == []
    # Two limits say no: the brake is too weak for its own climb, too.
    assert implausible(changed(atp__guaranteed_decel_mps2=0.4), sloped(47.0)) != []


def test_a_fall_leaves_the_brake_something() -> None:
    weak = changed(atp__guaranteed_decel_mps2=0.4)

    assert implausible(weak, sloped(-35.0)) == []
    [text] = implausible(weak, sloped(-36.0))
    assert "a fall of 36 ‰ takes 0.353 m/s² of atp.guaranteed_decel_mps2 0.4" in text


def platform(start_m: float, end_m: float, stop_m: float = 1500.0, **changes: Any) -> LineMap:
    station = Station("Only", stop_m, start_m, end_m, **changes)
    return replace(LINE, stations=(station,), tags=())


@pytest.mark.parametrize(
    ("start_m", "end_m", "fits"),
    [
        (1400.0, 1510.0, True),
        # The train of 68.59 m may stand 0.3 m short of the stopping point or beyond it.
        (1431.11, 1500.3, True),
        (1431.12, 1500.3, False),
        (1431.11, 1500.29, False),
    ],
)
def test_wherever_it_stops_in_its_window_a_train_is_beside_the_platform(
    start_m: float, end_m: float, fits: bool
) -> None:
    found = implausible(CONFIG, platform(start_m, end_m))

    assert (found == []) is fits
    assert all("Only: no door of the train of 68.59 m is surely" in text for text in found)


def test_a_long_train_needs_doors_by_car_at_a_short_platform() -> None:
    long = load_config("hefei6")
    whole = override(long, {"train.car_lengths_m": []}, "test")

    assert implausible(long, LINE) == []
    [text] = implausible(whole, LINE)
    assert "stations: Start, I, II, III, IV: no door of the train of 117.12 m" in text
    assert "give train.car_lengths_m" in text


def test_the_stopping_point_for_the_trains_length_counts() -> None:
    points = (StoppingPoint(train_length_max_m=70.0, stop_m=1470.0),)
    line = platform(1400.0, 1500.0, short_stops=points)

    # A long train would reach beyond the end of the platform.
    assert implausible(CONFIG, line) != []
    assert implausible(CONFIG, line.for_train(CONFIG.train.length_m)) == []


def test_two_stops_are_farther_apart_than_a_jog_reaches() -> None:
    def two(hop_m: float) -> LineMap:
        stations = tuple(Station(name, at_m, 1300.0, 1600.0) for name, at_m in
                         (("A", 1500.0), ("B", 1500.0 + hop_m)))  # fmt: skip
        return replace(LINE, stations=stations, tags=())

    assert implausible(CONFIG, two(5.31)) == []
    [text] = implausible(CONFIG, two(5.29))
    assert "A and B are 5.29 m apart" in text


# `vobc check`.


def test_the_command_says_what_it_judged(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "--params", "hefei6"]) == 0

    out = capsys.readouterr().out
    assert "parameters hefei6 fit line florence" in out
    assert "rollback: protection keeps it within 2 m; on the steepest climb, 30 ‰" in out
    assert "gives the empty train 1.54 m/s², atp.runaway_mps2 is 1;" in out
    assert "doors at III: cars 1 to 4" in out


def test_the_command_is_content_with_a_runaway_that_covers_an_empty_train(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (resources.files("vobc.params") / "nanakuma4.toml").read_text(encoding="utf-8")
    path = tmp_path / "mine.toml"
    path.write_text(text.replace("runaway_mps2 = 1.0", "runaway_mps2 = 1.11"), encoding="utf-8")

    assert main(["check", "--params", str(path)]) == 0

    assert "runaway" not in capsys.readouterr().out


def test_the_command_names_every_contradiction(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (resources.files("vobc.params") / "florence4.toml").read_text(encoding="utf-8")
    path = tmp_path / "mine.toml"
    path.write_text(
        text.replace("desk_s = 0.3", "desk_s = 0.05").replace(
            "length_m = 68.59", "length_m = 90.0"
        ),
        encoding="utf-8",
    )

    assert main(["check", "--params", str(path)]) == 2

    said = capsys.readouterr().err.splitlines()
    assert len(said) == 2
    assert all(line.startswith("vobc check: ") for line in said)


def test_a_slip_of_the_pen_is_one_line_with_file_and_range(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (resources.files("vobc.params") / "florence4.toml").read_text(encoding="utf-8")
    path = tmp_path / "mine.toml"
    path.write_text(text.replace("door_window_m = 0.3", "door_window_m = 1e9"), encoding="utf-8")

    assert main(["check", "--params", str(path)]) == 2

    [said] = capsys.readouterr().err.splitlines()
    assert "mine.toml" in said
    assert "door_window_m 1000000000.0 is not in 0.05..1" in said


NORTH, SOUTH = LineZone(-120.0, 900.0, "North"), LineZone(900.0, 4700.0, "South")


@pytest.mark.parametrize(
    ("sections", "neutral", "text"),
    [
        ((), (), ""),
        ((NORTH, SOUTH), (), ""),
        ((NORTH, replace(SOUTH, start_m=1000.0)), (LineZone(900.0, 1000.0),), ""),
        (
            (NORTH, replace(SOUTH, start_m=900.5)),
            (),
            "none from 900 m to 900.5 m, between North, -120 m to 900 m and South, 900.5 m to",
        ),
        ((NORTH,), (), "none from 900 m to 4700 m, between North, -120 m to 900 m and the end of"),
        ((SOUTH,), (), "none from -120 m to 900 m, between the start of the line and South, 900 m"),
    ],
)
def test_power_sections_leave_no_gap(
    sections: tuple[LineZone, ...], neutral: tuple[LineZone, ...], text: str
) -> None:
    line = replace(load_line("florence"), power_sections=sections, neutral_sections=neutral)

    found = [each for each in implausible(CONFIG, line) if "power_sections" in each]

    assert len(found) == bool(text)
    assert text in "".join(found)
