"""Infrastructure and rolling stock of OSRD, and effort curves, become files that run."""

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_py.settings import SettingsError
from firmware_py.trackdb import LineMap, load_line
from firmware_py.trackdb.circuit import load_network
from metro_hil.exchange.effort_curve import effort_curve
from metro_hil.exchange.import_command import main
from metro_hil.exchange.railjson_line import read_infra
from metro_hil.exchange.survey import Element
from metro_hil.exchange.surveyed_network import line_along
from metro_hil.exchange.track_graph import PlaceOnTrack, TrackGraph, shortest_path
from plant_emulator.train_config import load_train
from vobc.config import load_config
from vobc.plausible import implausible


def track(name: str, length_m: float, **more: Any) -> dict[str, Any]:
    return {"id": name, "length": length_m, "slopes": [], "curves": [], **more}


def end(name: str, endpoint: str) -> dict[str, str]:
    return {"track": name, "endpoint": endpoint}


def point(name: str, *parts: tuple[str, float]) -> dict[str, Any]:
    return {
        "id": f"op.{name}",
        "extensions": {"identifier": {"name": name, "uic": 0}},
        "parts": [{"track": on, "position": at_m} for on, at_m in parts],
    }


# West (T1) leads into T2, which runs the other way; its begin branches into the long T3 and the
# short T4.
INFRA: Final[dict[str, Any]] = {
    "version": "3.5.0",
    "track_sections": [
        track("T1", 1000.0, slopes=[{"gradient": 5.0, "begin": 200.0, "end": 1000.0}]),
        track(
            "T2",
            1500.0,
            slopes=[{"gradient": 10.0, "begin": 0.0, "end": 500.0}],
            curves=[{"radius": -400.0, "begin": 500.0, "end": 800.0}],
        ),
        track("T3", 900.0),
        track("T4", 300.0),
    ],
    "switches": [
        {
            "id": "joint",
            "switch_type": "link",
            "ports": {"A": end("T1", "END"), "B": end("T2", "END")},
        },
        {
            "id": "points",
            "switch_type": "point_switch",
            "ports": {"A": end("T2", "BEGIN"), "B1": end("T3", "BEGIN"), "B2": end("T4", "BEGIN")},
        },
    ],
    "operational_points": [
        point("West", ("T1", 100.0)),
        point("Middle", ("T2", 900.0)),
        point("East", ("T3", 800.0), ("T4", 200.0)),
        point("Depot", ("T4", 250.0)),
    ],
    "speed_sections": [
        {
            "id": "slow",
            "speed_limit": 10.0,
            "speed_limit_by_tag": {},
            "track_ranges": [
                {"track": "T2", "begin": 900, "end": 1500, "applicable_directions": "STOP_TO_START"}
            ],
        },
        {
            "id": "other way",
            "speed_limit": 5.0,
            "speed_limit_by_tag": {},
            "track_ranges": [
                {"track": "T2", "begin": 0, "end": 1500, "applicable_directions": "START_TO_STOP"}
            ],
        },
    ],
    "signals": [{"id": "S"}],
}
STOCK: Final[dict[str, Any]] = {
    "railjson_version": "3.3",
    "name": "Metro 2",
    "length": 40.0,
    "mass": 90_000.0,
    "max_speed": 22.2,
    "comfort_acceleration": 1.0,
    "const_gamma": 0.9,
    "inertia_coefficient": 1.1,
    "startup_time": 0.0,
    "rolling_resistance": {"type": "davis", "A": 1800.0, "B": 36.0, "C": 11.66},
    "effort_curves": {
        "default_mode": "750V",
        "modes": {
            "750V": {
                "curves": [],
                "default_curve": {
                    "speeds": [0.0, 10.0, 20.0],
                    "max_efforts": [110e3, 110e3, 50e3],
                },
                "is_electric": True,
            }
        },
    },
}


def infra_line(change: Callable[[dict[str, Any]], object] | None = None, *stops: str) -> Any:
    table = copy.deepcopy(INFRA)
    if change is not None:
        change(table)
    return line_along(read_infra(Element("net.json", "", table)), stops)


def imported(folder: Path, *arguments: str, **files: Any) -> int:
    paths = []
    for name, content in files.items():
        path = folder / name.replace("_", ".")
        path.write_text(content if isinstance(content, str) else json.dumps(content))
        paths.append(str(path))
    return main([*paths, *arguments, "--out", str(folder / "out"), "--force"])


def test_the_path_turns_values_round_where_a_section_runs_the_other_way() -> None:
    line = infra_line(None, "West", "Middle", "East")

    # 900 m of T1, then 600 m of T2 from its end; East is nearer on T4.
    assert line.stops == (("West", 0.0), ("Middle", 1500.0), ("East", 2600.0))
    assert line.gradients == (
        (0.0, 0.0),
        (100.0, 5.0),
        (900.0, 0.0),
        (1900.0, -10.0),
        (2400.0, 0.0),
    )
    assert [(each.start_m, each.end_m, each.radius_m) for each in line.bends] == [
        (1600.0, 1900.0, 400.0)
    ]
    assert line.limits == ((0.0, 80 / 3.6), (900.0, 10.0), (1500.0, 80 / 3.6))
    assert line.ignored == ("signals: the authority comes by radio",)


def test_the_opposite_path_has_the_opposite_values() -> None:
    line = infra_line(None, "East", "Middle", "West")

    assert line.stops == (("East", 0.0), ("Middle", 1100.0), ("West", 2600.0))
    assert (200.0, 10.0) in line.gradients
    assert min(limit_mps for _, limit_mps in line.limits) == 5.0


def test_all_points_of_a_single_track_are_stops_in_running_order() -> None:
    def single(table: dict[str, Any]) -> None:
        table["track_sections"] = table["track_sections"][1::-1]
        table["switches"] = table["switches"][:1]
        table["operational_points"] = [
            point("c", ("T1", 400.0)),
            point("a", ("T2", 100.0)),
            point("b", ("T2", 1200.0)),
        ]

    assert [name for name, _ in infra_line(single).stops] == ["a", "b", "c"]


@settings(max_examples=30, deadline=None)
@given(
    lengths_m=st.lists(st.integers(1, 500), min_size=1, max_size=6),
    flipped=st.lists(st.booleans(), min_size=6, max_size=6),
    share=st.floats(0.0, 1.0),
)
def test_a_path_is_as_long_there_as_back(
    lengths_m: list[int], flipped: list[bool], share: float
) -> None:
    names = [str(number) for number in range(len(lengths_m))]
    links: dict[tuple[str, bool], list[tuple[str, bool]]] = {}
    for number in range(len(names) - 1):
        one, other = (names[number], not flipped[number]), (names[number + 1], flipped[number + 1])
        links.setdefault(one, []).append(other)
        links.setdefault(other, []).append(one)
    graph = TrackGraph(dict(zip(names, map(float, lengths_m), strict=True)), links)
    first = [PlaceOnTrack(names[0], share * lengths_m[0])]
    last = [PlaceOnTrack(names[-1], share * lengths_m[-1])]

    there, back = shortest_path(graph, [first, last]), shortest_path(graph, [last, first])

    assert there is not None
    assert back is not None
    assert there[1][-1] == pytest.approx(back[1][-1])
    assert [piece.track for piece in there[0]] == [piece.track for piece in back[0][::-1]]
    assert sum(piece.to_m - piece.from_m for piece in there[0]) == pytest.approx(there[1][-1])


def test_line_and_train_of_osrd_fit_each_other(tmp_path: Path) -> None:
    assert imported(tmp_path, "--stops", "West,Middle,East", net_json=INFRA, train_json=STOCK) == 0

    line: LineMap = load_line(str(tmp_path / "out" / "net.toml"))
    train = load_train(str(tmp_path / "out" / "Metro_2.toml"))
    config = load_config(str(tmp_path / "out" / "Metro_2_params.toml"))
    assert implausible(config, line) == []
    assert (train.mass_kg, train.length_m) == (90_000.0, 40.0)
    assert train.traction.max_power_w == 1.1e6
    # 1 m/s² of 90 t with 10 % more inertia is less than the 110 kN of the curve.
    assert train.traction.rated_force_n == pytest.approx(99_000.0)
    text = (tmp_path / "out" / "Metro_2.toml").read_text(encoding="utf-8")
    assert "power, 1100 kW; at most 10 % above the curve, at 72 km/h (mode 750V)" in text


def neutral(table: dict[str, Any], direction: str = "STOP_TO_START") -> None:
    """A gap from 950 m of T1 to 80 m before the end of T2, for one direction."""
    table["neutral_sections"] = [
        {
            "id": "gap",
            "lower_pantograph": False,
            "track_ranges": [
                {"track": "T1", "begin": 950, "end": 1000, "direction": "START_TO_STOP"},
                {"track": "T2", "begin": 1420, "end": 1500, "direction": direction},
            ],
        }
    ]


def test_a_neutral_section_holds_in_its_direction(tmp_path: Path) -> None:
    there = infra_line(neutral, "West", "Middle", "East").given
    back = infra_line(neutral, "East", "Middle", "West").given

    # The path begins at 100 m of T1. Both parts meet where the tracks do.
    assert there["neutral_sections"] == [{"start_m": 850.0, "end_m": 980.0, "name": "gap"}]
    assert "neutral_sections" not in back

    table = copy.deepcopy(INFRA)
    neutral(table)
    assert imported(tmp_path, net_json=table) == 0
    network = load_network(str(tmp_path / "out" / "net.toml"))
    (zone,) = network.track("T2").neutral_sections
    assert (zone.start_m, zone.end_m, zone.direction.value) == (1420.0, 1500.0, "down")


def test_tracks_that_branch_become_a_network(tmp_path: Path) -> None:
    assert imported(tmp_path, net_json=INFRA) == 0

    network = load_network(str(tmp_path / "out" / "net.toml"))
    (switch,) = network.switches
    assert (switch.tip, switch.left, switch.right) == ("T2.start", "T3.start", "T4.start")
    assert [(join.a, join.b) for join in network.joins] == [("T1.end", "T2.end")]
    assert network.buffer_stops == ("T1.start", "T3.end", "T4.end")
    limits = [(each.direction.value, each.limit_mps) for each in network.track("T2").limits]
    assert ("down", 10.0) in limits
    assert ("up", 5.0) in limits
    line = load_line(f"{tmp_path / 'out' / 'net.toml'}:T1-T4")
    assert [station.name for station in line.stations] == ["West", "Middle", "East", "Depot"]


def test_resistance_is_that_of_each_kilogram_from_version_3_4_on(tmp_path: Path) -> None:
    new = copy.deepcopy(STOCK) | {"railjson_version": "3.4"}
    for name in "ABC":
        new["rolling_resistance"][name] /= 90_000.0
    assert imported(tmp_path, train_json=STOCK) == 0
    before = load_train(str(tmp_path / "out" / "Metro_2.toml")).resistance
    assert imported(tmp_path, train_json=new) == 0
    after = load_train(str(tmp_path / "out" / "Metro_2.toml")).resistance

    assert after.c_n_per_kn_per_mps2 == pytest.approx(before.c_n_per_kn_per_mps2)
    # 1800 N on 90 t of 9.81 m/s².
    assert after.a_n_per_kn == pytest.approx(1800.0 / 882.9, rel=1e-3)


def test_a_csv_file_replaces_the_effort_of_the_train(tmp_path: Path) -> None:
    rows = "effort_kn, speed_kmh\n80,0\n80,36\n40,72\n\n"

    assert imported(tmp_path, train_json=STOCK, effort_csv=rows) == 0

    traction = load_train(str(tmp_path / "out" / "Metro_2.toml")).traction
    assert traction.rated_force_n == pytest.approx(80_000.0)
    assert traction.max_power_w == pytest.approx(800_000.0)
    points = [(point.speed_mps, point.force_n) for point in traction.effort]
    assert points == [(0.0, 80e3), (pytest.approx(10.0), 80e3), (pytest.approx(20.0), 40e3)]


@given(
    efforts_n=st.lists(st.floats(1.0, 5e5), min_size=2, max_size=12),
    step_mps=st.floats(0.5, 5.0),
)
def test_force_and_power_reach_the_whole_curve(efforts_n: list[float], step_mps: float) -> None:
    points = [(number * step_mps, effort_n) for number, effort_n in enumerate(efforts_n)]

    curve = effort_curve(points, 100.0)

    for speed_mps, effort_n in points:
        assert effort_n <= curve.force_n
        assert speed_mps * effort_n <= curve.power_w


@pytest.mark.parametrize(
    ("change", "stops", "message"),
    [
        (None, (), "net.json: switches: the tracks branch, close to a loop or lie apart; give"),
        (None, ("West", "Easd"), "operational_points: has no 'Easd'; nearest valid"),
        (None, ("West",), "1 stops; a line needs two or more"),
        (None, ("Depot", "West", "Middle"), "no path leads through Depot, West, Middle in this"),
        (
            lambda t: t["switches"][0]["ports"]["A"].update(track="T9"),
            ("West", "East"),
            "switches[0].ports.A.track: 'T9' is no track section; valid track sections: T1",
        ),
        (
            lambda t: t["switches"][1]["ports"].pop("B2"),
            ("West", "East"),
            "switches[1].ports: has no 'B2', which the import needs",
        ),
        (
            lambda t: t["switches"][1].update(switch_type="point_swich"),
            ("West", "East"),
            "switches[1].switch_type: 'point_swich' is unknown; nearest valid",
        ),
        (
            lambda t: t["operational_points"][0]["parts"][0].update(position=1000.1),
            ("West", "East"),
            "operational_points[0].parts[0].position: 1000.1 is not on T1, which is 1000 m long",
        ),
        (
            lambda t: t["track_sections"][1].update(id="T1"),
            ("West", "East"),
            "track_sections[1].id: 'T1' is used twice",
        ),
        (
            lambda t: t["track_sections"][1]["slopes"][0].update(end=0),
            ("West", "East"),
            "track_sections[1].slopes[0]: begin 0.0 is not before end 0",
        ),
        (
            lambda t: neutral(t, "BOTH"),
            ("West", "East"),
            "neutral_sections[0].track_ranges[1].direction: 'BOTH' is none of START_TO_STOP",
        ),
    ],
)
def test_an_error_of_the_infrastructure_names_its_element(
    change: Callable[[dict[str, Any]], object] | None, stops: tuple[str, ...], message: str
) -> None:
    with pytest.raises(SettingsError) as caught:
        infra_line(change, *stops)

    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("change", "csv", "message"),
    [
        ({"mass": 0}, "", "train.json: mass: 0 is not positive"),
        ({"inertia_coefficient": 0.1}, "", "inertia_coefficient: 0.1 is not in 1..2"),
        ({"railjson_version": "3.4"}, "", "rolling_resistance: 3.33e+03 N for each kg at 36 km/h"),
        ({"railjson_version": "three"}, "", "railjson_version: 'three' is not a version such as"),
        ({}, "speed,effort\n0,1\n", "effort.csv: line 1: 'speed,effort' is no head of a table"),
        ({}, "speed_kmh,effort_kn\n0,80\n10,x\n", "effort.csv: line 3: '10,x' is not 2 numbers"),
        ({}, "speed_kmh,effort_kn\n10,80\n5,80\n", "effort.csv: 1.38889 m/s does not follow"),
        ({}, "speed_kmh,effort_kn\n10,80\n", "effort.csv: 1 points; a curve needs two or more"),
    ],
)
def test_an_error_of_a_train_names_its_element_and_writes_nothing(
    change: dict[str, Any],
    csv: str,
    message: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    files = {"train_json": STOCK | change} | ({"effort_csv": csv} if csv else {})

    assert imported(tmp_path, **files) == 2

    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_curve_without_a_train_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert imported(tmp_path, effort_csv="speed_kmh,effort_kn\n0,80\n40,40\n") == 2

    assert "effort.csv: a table of motors belongs to one train" in capsys.readouterr().err
