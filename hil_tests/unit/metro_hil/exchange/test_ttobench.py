"""Tracks and trains of TTOBench become files that run; bad files give file and element."""

import copy
import itertools
import json
from pathlib import Path
from typing import Any, Final

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.trackdb import LineMap, load_line
from metro_hil.exchange.import_command import main
from metro_hil.exchange.ttobench import mean_curvature_per_m
from plant_emulator.train_config import load_train
from vobc.config import load_config
from vobc.plausible import implausible

KMH: Final = 1.0 / 3.6
TRACK: Final[dict[str, Any]] = {
    "metadata": {"id": "Short", "library version": "TTOBench v1.2"},
    "altitude": {"unit": "m", "value": 400.0},
    "stops": {"unit": "m", "values": [0.0, 900.0, 2400.0]},
    "speed limits": {
        "units": {"position": "m", "velocity": "km/h"},
        "values": [[0.0, 50], [150.0, 90], [2300.0, 40]],
    },
    "gradients": {
        "units": {"position": "m", "slope": "permil"},
        "values": [[0.0, -2.0], [700.0, 0.0], [1500.0, 24.0]],
    },
    "curvatures": {
        "units": {"position": "m", "radius at start": "m", "radius at end": "m"},
        "values": [
            [0.0, "infinity", "infinity"],
            [300.0, "infinity", 400.0],
            [400.0, -400.0, -400.0],
            [500.0, "infinity", "infinity"],
        ],
    },
}
TRAIN: Final[dict[str, Any]] = {
    "metadata": {"id": "Two", "library version": "TTOBench v1.3"},
    "mass": {"unit": "kg", "value": 90000},
    "rho": {"unit": "%", "value": 10.0},
    "max traction power": {"unit": "kW", "value": 1200.0},
    "max reg braking power": {"unit": "kW", "value": 1300.0},
    "max traction force": {"unit": "kN", "value": 110.0},
    "max reg braking force": {"unit": "kN", "value": 90.0},
    "max pn braking force": {"unit": "kN", "value": 100.0},
    "max acceleration": {"unit": "m/s^2", "value": 1.0},
    "max speed": {"unit": "km/h", "value": 80},
    "rolling resistance r0": {"unit": "kN", "value": 1.8},
    "rolling resistance r1": {"unit": "kN/(km/h)", "value": 0.01},
    "rolling resistance r2": {"unit": "kN/(km/h)^2", "value": 0.0009},
    "ETCS braking data": {
        "A_brake_emergency": {
            "units": {"velocity": "m/s", "deceleration": "m/s^2"},
            "values": [[0, 1.1], [20, 1.0], [40, 0.2]],
        },
        "K_dry_rst": {"unit": "-", "value": 0.9},
    },
}


def written(folder: Path, *files: dict[str, Any]) -> list[str]:
    """The paths of the files, written as JSON."""
    names = []
    for number, each in enumerate(files):
        path = folder / f"{number}.json"
        path.write_text(json.dumps(each), encoding="utf-8")
        names.append(str(path))
    return names


def imported(folder: Path, *files: dict[str, Any]) -> LineMap:
    out = folder / "out"
    assert main([*written(folder, *files), "--out", str(out)]) == 0
    return load_line(str(out / "Short.toml"))


def test_limits_gradients_and_curves_hold_where_the_file_says(tmp_path: Path) -> None:
    line = imported(tmp_path, TRACK)

    for at_m, kmh, permille in (
        (10.0, 50, -2.0),
        (149.0, 50, -2.0),
        (151.0, 90, -2.0),
        (800.0, 90, 0.0),
        (1600.0, 90, 24.0),
        (2350.0, 40, 24.0),
    ):
        assert line.limit_mps(at_m) == pytest.approx(kmh * KMH)
        assert line.gradient_permille(at_m) == permille
    assert [line.radius_m(at_m) for at_m in (100.0, 350.0, 450.0, 600.0)] == [
        None,
        pytest.approx(800.0),
        pytest.approx(400.0),
        None,
    ]


def test_the_shipped_train_fits_a_line_laid_out_for_it(tmp_path: Path) -> None:
    line = imported(tmp_path, TRACK)
    config = load_config("florence4")

    assert implausible(config, line) == []
    for station in line.stations:
        assert station.platform_start_m < station.stop_m - config.train.length_m
        served = {tag.kind.value: tag for tag in line.tags if tag.station == station.name}
        assert served["stop"].position_m == station.stop_m - config.train.antenna_offset_m
    places_m = [tag.position_m for tag in line.tags]
    gaps_m = [after_m - before_m for before_m, after_m in itertools.pairwise(places_m)]
    assert max(gaps_m) <= 250.01


def test_an_imported_train_is_the_train_of_the_file(tmp_path: Path) -> None:
    line = imported(tmp_path, TRACK, TRAIN)
    train = load_train(str(tmp_path / "out" / "Two.toml"))
    config = load_config(str(tmp_path / "out" / "Two_params.toml"))

    assert implausible(config, line) == []
    assert train.mass_kg == config.train.tare_kg == 90_000.0
    assert len(train.cars) == 2
    assert train.length_m == config.train.length_m == 39.0
    # 1 m/s² of 90 t with 10 % more inertia is less than the 110 kN of the motors.
    assert train.traction.rated_force_n == pytest.approx(99_000.0)
    assert config.train.rated_force_n == train.traction.rated_force_n
    assert train.brake.emergency.decel_mps2 == 1.0
    assert config.atp.guaranteed_decel_mps2 == pytest.approx(0.9)
    # The resistance at 72 km/h is 1.8 + 0.01 * 72 + 0.0009 * 72² = 7.1856 kN.
    davis, weight_kn = train.resistance, 90.0 * 9.81
    n_per_kn = davis.a_n_per_kn + 20.0 * (
        davis.b_n_per_kn_per_mps + 20.0 * davis.c_n_per_kn_per_mps2
    )
    assert n_per_kn * weight_kn == pytest.approx(7185.6, rel=1e-3)
    # The line has 90 km/h, the train 80 km/h.
    assert max(section.limit_mps for section in line.speed_sections) == pytest.approx(80 * KMH)


def test_every_filled_gap_stands_in_the_file(tmp_path: Path) -> None:
    imported(tmp_path, TRACK, TRAIN)

    line = (tmp_path / "out" / "Short.toml").read_text(encoding="utf-8")
    train = (tmp_path / "out" / "Two.toml").read_text(encoding="utf-8")
    for text in ("# - platforms:", "# - tags:", "# - left out: altitude", "lowered to it"):
        assert text in line
    for text in ("# - cars: 2, one for each 45 t", "# - length: 39 m", "# - tractive effort"):
        assert text in train


@pytest.mark.parametrize(("unit", "code"), [("m^2", 0), ("ft^2", 2)])
def test_a_tunnel_resistance_is_printed_as_ratios_of_air_drag(
    unit: str, code: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = {
        "units": {"cross section": unit, "coefficient": "kN/(km/h)^2"},
        "values": [[24, 0.0009], [40, 0.00045]],
    }

    names = written(tmp_path, {**TRAIN, "tunnel resistance": table})
    assert main([*names, "--out", str(tmp_path / "out")]) == code

    said = capsys.readouterr()
    ratios = "drag_ratio of the line's tunnels it is 2.00 in 24 m², 1.50 in 40 m²"
    assert (ratios in said.out) is (code == 0)
    assert ("tunnel resistance.units.cross section: unit 'ft^2'" in said.err) is (code == 2)


@given(st.floats(-0.02, 0.02), st.floats(-0.02, 0.02))
def test_the_mean_curvature_is_that_of_the_clothoid(start: float, end: float) -> None:
    """The oracle sums the magnitude of the curvature over the transition."""
    steps = 2000
    total = sum(abs(start + (end - start) * (i + 0.5) / steps) for i in range(steps))

    assert mean_curvature_per_m(start, end) == pytest.approx(total / steps, abs=1e-7)


def changed(file: dict[str, Any], path: str, value: Any) -> dict[str, Any]:
    """A copy with one part replaced; None removes it."""
    copied = copy.deepcopy(file)
    *way, last = path.split("/")
    part: Any = copied
    for name in way:
        part = part[int(name) if name.isdigit() else name]
    key: Any = int(last) if last.isdigit() else last
    if value is None:
        del part[key]
    else:
        part[key] = value
    return copied


@pytest.mark.parametrize(
    ("path", "value", "element", "problem"),
    [
        ("stops/unit", None, "stops", "has no 'unit'"),
        ("stops/unit", "ft", "stops.unit", "'ft' is unknown"),
        ("stops/values", [0.0], "stops", "two or more"),
        ("stops/values/1", 0.0, "stops.values[1]", "not beyond"),
        ("stops/values/1", "far", "stops.values[1]", "'far' is not a number"),
        ("stops/values/1", 20.0, "stops", "20 m apart"),
        ("speed limits/values/1/1", 0, "speed limits", "must be positive"),
        ("speed limits/values/0/0", 5.0, "speed limits.values[0][0]", "must be at 0"),
        ("speed limits/values/1", [5.0], "speed limits.values[1]", "not a row"),
        ("speed limits", None, "the file", "has no 'speed limits'"),
        ("gradients/values/1/0", 0.0, "gradients.values[1][0]", "not beyond"),
        ("gradients/values/2/1", 300.0, "gradients[1]", "±120"),
        ("gradients/values", [], "gradients", "no values"),
        ("curvatures/values/1/2", 0.0, "curvatures.values[1][2]", "radius of 0"),
        ("curvatures/values/2/1", 20.0, "curves[1]", "under 50"),
        ("metadata/id", "../up", "metadata.id", "letters, digits"),
        ("metadata", [], "metadata", "not an object"),
    ],
)
def test_a_bad_track_names_file_and_element(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    path: str,
    value: Any,
    element: str,
    problem: str,
) -> None:
    (name,) = written(tmp_path, changed(TRACK, path, value))

    assert main([name, "--out", str(tmp_path / "out")]) == 2

    error = capsys.readouterr().err
    assert error.startswith(f"vobc import: {name}: {element}")
    assert problem in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("path", "value", "problem"),
    [
        ("mass/value", 0, "mass: is zero"),
        ("mass/unit", "lb", "mass.unit: unit 'lb'"),
        ("rho", None, "has no 'rho'"),
        ("max speed/value", 1e400, "not a finite number"),
        ("num coaches", {"unit": "-", "value": 2.5}, "not a whole number of coaches"),
        ("ETCS braking data/A_brake_emergency/values/0/0", 90, "greatest speed"),
    ],
)
def test_a_bad_train_names_file_and_element(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], path: str, value: Any, problem: str
) -> None:
    file = changed(TRAIN, path, value)
    if path.startswith("ETCS"):
        file = changed(file, "ETCS braking data/A_brake_emergency/values", [[90, 1.0]])
    (name,) = written(tmp_path, file)

    assert main([name, "--out", str(tmp_path / "out")]) == 2

    error = capsys.readouterr().err
    assert name in error
    assert problem in error


def test_an_existing_file_is_replaced_only_by_force(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    imported(tmp_path, TRACK)
    (name,) = written(tmp_path, TRACK)

    assert main([name, "--out", str(tmp_path / "out")]) == 2
    assert "give --force to replace it" in capsys.readouterr().err
    assert main([name, "--out", str(tmp_path / "out"), "--force"]) == 0


@pytest.mark.parametrize(
    ("text", "problem"),
    [("{", "not JSON"), ('{"timing points": {}}', "is a journey"), ("[]", "not an object")],
)
def test_another_file_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, problem: str
) -> None:
    path = tmp_path / "other.json"
    path.write_text(text, encoding="utf-8")

    assert main([str(path)]) == 2
    assert problem in capsys.readouterr().err
