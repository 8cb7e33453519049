"""The shipped consist files, and the refusal of wrong ones."""

import tomllib
from dataclasses import fields, is_dataclass, replace
from importlib import resources
from pathlib import Path

import pytest

from firmware_py.settings import SettingsError, shipped_names
from firmware_py.trackdb import load_line
from plant_emulator.train_config import (
    PACKAGE,
    ConsistModel,
    DeadTimeKind,
    Spread,
    load_train,
    with_overrides,
)
from plant_emulator.world import World

SHIPPED = shipped_names(PACKAGE)


TABLES = ("effort", "efficiency")
"""Tables of motors, which replace other keys of the same part."""


def text_of(name: str) -> str:
    return (resources.files("plant_emulator") / "consists" / f"{name}.toml").read_text("utf-8")


def changed(tmp_path: Path, old: str, new: str) -> str:
    text = text_of("florence4")
    assert old in text
    path = tmp_path / "changed.toml"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    return str(path)


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_consist_loads_under_its_own_name_and_stands_on_its_line(name: str) -> None:
    train = load_train(name)
    world = World(train, load_line("florence"), seed=1, front_m=0.0)
    for _ in range(100):
        world.step()
    assert train.name == name
    assert train.description
    assert world.front_m == 0.0


@pytest.mark.parametrize("name", SHIPPED)
def test_every_key_of_the_files_is_a_field_and_every_field_a_key(name: str) -> None:
    """A default would hide a property of the train from the reader of the file."""

    def compare(table: dict[str, object], value: object) -> None:
        assert is_dataclass(value)
        absent = {name for name in TABLES if not getattr(value, name, None)}
        assert set(table) == {field.name for field in fields(value)} - absent
        for key, inner in table.items():
            own = getattr(value, key)
            if isinstance(inner, dict):
                compare(inner, own)
            elif isinstance(inner, list):
                for one, other in zip(inner, own, strict=True):
                    compare(one, other)

    compare(tomllib.loads(text_of(name)), load_train(name))


def test_the_florence_train_equals_the_published_one() -> None:
    train = load_train("florence4")
    assert [car.tare_kg for car in train.cars] == [35_000.0, 30_000.0, 30_000.0, 35_000.0]
    assert [car.motor for car in train.cars] == [True, False, False, True]
    assert train.length_m == pytest.approx(68.59)
    assert with_overrides(train, load_ratio=1.0).mass_kg == pytest.approx(184_400.0)
    assert train.coupler.stiffness_n_per_m == 300_000.0
    assert train.coupler.damping_ns_per_m == 30_000.0
    assert train.sensors.odometer_error_ratio == Spread(-0.01, 0.05)
    assert train.sensors.antenna_m == 2.0


def test_the_variants_differ_from_florence4_as_their_names_say() -> None:
    base, late = load_train("florence4"), load_train("florence4_fixed_delay")
    service = late.brake.service
    assert service.dead_time_s == Spread(1.0, 1.0)
    again = replace(service, dead_time_s=base.brake.service.dead_time_s)
    brake = replace(late.brake, service=again)
    assert replace(late, brake=brake, name=base.name, description=base.description) == base
    assert base.brake.service.dead_time_s == Spread(0.4, 1.0)
    assert base.brake.service.dead_time_kind is DeadTimeKind.TRANSPORT


def test_the_ideal_train_has_neither_noise_nor_error() -> None:
    sensors = load_train("florence4_ideal").sensors
    none = Spread(0.0, 0.0)
    assert sensors.odometer_error_ratio == sensors.doppler_error_ratio == none
    assert sensors.imu_bias_mps2 == sensors.tag_stamp_s == none
    assert sensors.tag_sigma_m == sensors.doppler_sigma_mps == sensors.imu_sigma_mps2 == 0.0


def test_a_consist_names_its_model(tmp_path: Path) -> None:
    path = changed(tmp_path, 'model = "multi_mass"', 'model = "point_mass"')
    train = load_train(path)
    world = World(train, load_line("florence"), seed=1, front_m=0.0)
    assert train.model is ConsistModel.POINT_MASS
    assert len(world.consist.cars) == 1


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("tare_kg = 35000.0", "tare_kg = -35000.0", r"cars\[0\]: tare_kg -35000"),
        ("length_m = 17.455", "length_m = 0.0", r"cars\[0\]: length_m 0"),
        ("tare_kg = 35000.0", "tare_kg = nan", r"cars\[0\]\.tare_kg: nan is not a finite number"),
        ("tare_kg = 35000.0", 'tare_kg = "heavy"', r"cars\[0\]\.tare_kg: 'heavy' is not a number"),
        ("load_ratio = 0.5", "load_ratio = 1.1", "load_ratio 1.1 is not in 0..1"),
        ("load_ratio = 0.5", "load_ration = 0.5", "load_ration: unknown key; nearest .*load_ratio"),
        ("full_pressure_kpa = 380.0", "", "brake.full_pressure_kpa: missing key"),
        ('model = "multi_mass"', 'model = "multimass"', "nearest valid value: multi_mass"),
        ("cut_s = 0.15", "cut_s = 0.5", "traction: cut_s 0.5 is not in 0..0.3"),
        (
            "dead_time_s = { low = 0.4, high = 1.0 }",
            "dead_time_s = { low = 1.0, high = 0.4 }",
            "brake.service.dead_time_s: low 1.0 is not at or under high 0.4",
        ),
        (
            "dead_time_s = 0.3\nlag_s = 0.4",
            "dead_time_s = 0.5\nlag_s = 0.9",
            "brake.emergency: .*90 % after 2.57 s; allowed are 0.5 s and 1.6 s",
        ),
        ("fade_end_mps = 0.83", "fade_end_mps = 9.83", "fade_end_mps .* is not under"),
        ("car = 2", "car = 5", "sensors.tachos: car 5 is not in 1..4"),
        ("no_effort_v = 450.0", "no_effort_v = 700.0", "no_effort_v 700.0 is not under"),
        ("obstructed_closings = 0", "obstructed_closings = -1", "obstructed_closings -1"),
        ("adhesion_ratio = 0.28", "adhesion_ratio = 0.0", "adhesion_ratio 0.0 is not in"),
    ],
)
def test_a_wrong_consist_is_refused_by_file_key_and_value(
    tmp_path: Path, old: str, new: str, words: str
) -> None:
    path = changed(tmp_path, old, new)
    with pytest.raises(SettingsError, match=words) as refused:
        load_train(path)
    assert str(refused.value).startswith(path)


def test_a_train_without_a_motor_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "dead.toml"
    path.write_text(text_of("florence4").replace("motor = true", "motor = false"), "utf-8")
    with pytest.raises(SettingsError, match="cars: none has a motor"):
        load_train(str(path))


def test_overrides_are_checked_like_files() -> None:
    train = load_train("florence4")
    assert with_overrides(train) == train
    fixed = with_overrides(train, load_ratio=0.0, odometer_error_ratio=0.03)
    assert fixed.load_ratio == 0.0
    assert fixed.sensors.odometer_error_ratio == Spread(0.03, 0.03)
    with pytest.raises(ValueError, match="load_ratio"):
        with_overrides(train, load_ratio=float("nan"))
