"""Parameter files and missions: the shipped ones load, and every error is named."""

from dataclasses import replace
from pathlib import Path

import pytest

from firmware_py.settings import SettingsError, shipped_names
from firmware_py.trackdb import load_line
from vobc.config import SHIPPED, load_config, plan_mission

LINE = load_line("florence")


@pytest.mark.parametrize("name", shipped_names(SHIPPED))
def test_every_shipped_parameter_file_loads(name: str) -> None:
    config = load_config(name)

    assert config.name == name
    assert config.ato.train_length_m == config.train.length_m
    assert config.ato.rotating_mass_percent == pytest.approx(
        100.0 * config.train.rotating_mass_ratio
    )


def test_the_margins_are_the_published_ones() -> None:
    atp = load_config("florence4").atp

    assert atp.warning_margin_mps * 3.6 == pytest.approx(3.0)
    assert atp.emergency_margin_mps * 3.6 == pytest.approx(8.0)


def test_the_cycle_time_can_be_set() -> None:
    assert load_config("florence4", cycle_ms=100.0).cycle_ms == 100.0
    with pytest.raises(SettingsError, match=r"--cycle-ms: cycle_ms 4\.0 is not in 5\.\.200"):
        load_config("florence4", cycle_ms=4.0)


def shipped_text() -> str:
    root = Path(str(__import__("vobc.params", fromlist=["x"]).__path__[0]))
    return (root / "florence4.toml").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("rollback_m = 0.5", "rolback_m = 0.5", r"atp\.rolback_m: unknown key.*rollback_m"),
        ("rollback_m = 0.5", "", r"atp\.rollback_m: missing key"),
        ("rollback_m = 0.5", "rollback_m = -1", r"rollback_m -1\.0 is not in 0\.1\.\.2"),
        ("tare_kg = 130000.0", "tare_kg = 0", r"tare_kg 0\.0 is not in "),
        ("address = 1\n", "address = 0\n", r"address 0 is not in 1\.\.65535"),
        ("desk_s = 0.3", "desk_s = 0.0", r"desk_s 0\.0 is not in 0\.02\.\.5"),
        ("\nservice_margin_mps = 1.5", "\nservice_margin_mps = 9.5", r"service_margin_mps"),
        (
            "flat_service_margin_mps = 0.5",
            "flat_service_margin_mps = 2.5",
            r"flat_service_margin_mps < flat_emergency_margin_mps does not hold",
        ),
        (
            "authority_service_ratio = 0.6",
            "authority_service_ratio = 1.1",
            r"authority_service_ratio 1\.1 is not in 0\.1\.\.1",
        ),
        (
            "overshoot_m = 1.0",
            "overshoot_m = 5.5",
            r"overshoot_m 5\.5 is more than overshoot_mended_m 5\.0",
        ),
        ("jog_attempts = 3", "jog_attempts = -1", r"jog_attempts -1 is not in 0\.\.10"),
        ("scale_error_low_ratio = -0.01", "scale_error_low_ratio = 0.01", r"enclose 0"),
        ("cycle_ms = 50.0", "cycle_ms = 4.0", r"cycle_ms 4\.0 is not in 5\.\.200"),
        ("report_ms = 200.0", "report_ms = 0.0", r"report_ms 0\.0 is not in 50\.\.2000"),
    ],
)
def test_every_error_in_a_file_is_named(tmp_path: Path, old: str, new: str, words: str) -> None:
    text = shipped_text()
    assert old in text
    path = tmp_path / "mine.toml"
    path.write_text(text.replace(old, new), encoding="utf-8")

    with pytest.raises(SettingsError, match=words) as raised:
        load_config(str(path))
    assert "mine.toml" in str(raised.value)


def test_an_unknown_strategy_is_reported_with_the_known_ones(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(shipped_text() + '\n[ato]\nstrategy = "bold"\n', encoding="utf-8")

    with pytest.raises(SettingsError, match=r"strategy 'bold' is unknown; there is .*predictive"):
        load_config(str(path))


def test_an_unknown_name_is_reported_with_the_nearest_known_one() -> None:
    with pytest.raises(SettingsError, match="florence4"):
        load_config("florenc4")


def test_a_mission_stops_at_every_station_up_to_its_end() -> None:
    whole, hop = plan_mission(LINE, None, None), plan_mission(LINE, "II", "III")

    assert whole.start.name == "Start"
    assert [station.name for station in whole.stops] == ["I", "II", "III", "IV"]
    assert [station.name for station in hop.stops] == ["III"]


def test_an_impossible_mission_is_refused_with_the_reason() -> None:
    with pytest.raises(SettingsError, match=r"--from V: .*has no station V"):
        plan_mission(LINE, "V", None)
    with pytest.raises(SettingsError, match="--to II: lies at 3000 m, not beyond III at 3500 m"):
        plan_mission(LINE, "III", "II")


def test_a_train_without_weight_is_refused_wherever_it_comes_from() -> None:
    train = load_config("florence4").train

    with pytest.raises(ValueError, match=r"antenna_offset_m -1\.0 is not in 0\.\.500"):
        replace(train, antenna_offset_m=-1.0)
