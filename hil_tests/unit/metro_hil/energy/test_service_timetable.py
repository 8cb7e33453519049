"""Running times with which the trains of any line meet: energy of a service, search, command."""

import json
import tomllib
from pathlib import Path

import pytest

from firmware_py.settings import SettingsError
from metro_hil.energy.line import timetable_command
from metro_hil.energy.line.meetings import find_meetings
from metro_hil.energy.line.service import REACH_S, ServiceLine
from metro_hil.energy.line.service_command import train_of
from metro_hil.energy.running_curve.train import load_train, of_consist
from plant_emulator.traffic.config import load_traffic, plan_traffic
from plant_emulator.train_config import load_train as load_consist

STATION = """
[[stations]]
name = "{name}"
stop_m = {stop_m}
platform_start_m = {begin_m}
platform_end_m = {end_m}
side = "right"
dwell_s = 20.0
run_s = {run_s}
"""
LIMITS = "[[speed_sections]]\nstart_m = -180.0\nend_m = 600.0\nlimit_mps = 11.0\n"
STOPS = (("A", 0.0, 0.0), ("B", 250.0, 50.0), ("C", 500.0, 50.0))
SUPPLY = """
name = "s"
[[substations]]
joint = "west"
no_load_v = 836.0
source_ohm = 0.015
[[sections]]
begin = "west"
end = "east"
begin_m = 0.0
end_m = 550.0
ohm_per_km = 0.02
"""
TRAFFIC = """
name = "t"
line = "short.toml"
consist = "nanakuma4"
supply = "supply.toml"
trains = 3
headway_s = 50.0
dwell_s = 25.0
dwell_spread_s = {spread_s}
"""


def files(folder: Path, spread_s: float = 2.0, run_s: float = 50.0) -> str:
    """A line of two hops with its traffic and supply; the path of the traffic."""
    stations = [
        STATION.format(
            name=name, stop_m=m, begin_m=m - 120.0, end_m=m + 5.0, run_s=time_s and run_s
        )
        for name, m, time_s in STOPS
    ]
    line = ['name = "short"\nstart_m = -180.0\nend_m = 600.0\n', *stations, LIMITS]
    (folder / "short.toml").write_text("".join(line), encoding="utf-8")
    (folder / "supply.toml").write_text(SUPPLY, encoding="utf-8")
    text = TRAFFIC.format(spread_s=spread_s)
    (folder / "traffic.toml").write_text(text, encoding="utf-8")
    return str(folder / "traffic.toml")


def service(path: str) -> ServiceLine:
    traffic, line, supply = plan_traffic(None, path, None)
    return ServiceLine(traffic, line, load_train(traffic.consist), supply)


def test_the_energy_of_a_service_is_that_of_its_runs_and_of_the_losses_between(
    tmp_path: Path,
) -> None:
    """The oracle is the energy of the designed runs, without a network."""
    short = service(files(tmp_path))
    runs_s = [50.0, 51.0]

    found = short.simulate(runs_s, seed=1, step_s=1.0)

    traction_j = sum(float(run.drawn_j[-1]) for run in short.profiles(runs_s))
    given_j = sum(float(run.given_j[-1]) for run in short.profiles(runs_s))
    on_line_s = sum(runs_s) + 2 * 25.0
    own_kwh = load_train("nanakuma4").auxiliary_w * on_line_s / 3.6e6
    assert found.traction_kwh + found.unserved_kwh == pytest.approx(traction_j / 3.6e6, rel=1e-3)
    assert found.regenerated_kwh == pytest.approx(given_j / 3.6e6, rel=1e-3)
    least_kwh = found.traction_kwh + own_kwh - (found.regenerated_kwh - found.burnt_kwh)
    assert least_kwh < found.actual_kwh < 1.15 * least_kwh


def test_the_search_keeps_trip_times_and_finds_less_energy_on_its_dwells(tmp_path: Path) -> None:
    short = service(files(tmp_path, spread_s=0.0))
    begin_s = [50.0, 50.0]

    found = find_meetings(short, begin_s, seed=1, budget=5)
    again = find_meetings(short, begin_s, seed=1, budget=5)

    assert found == again
    assert sum(found.times_s) == pytest.approx(sum(begin_s))
    assert all(abs(run_s - 50.0) <= REACH_S for run_s in found.times_s)
    before, after = (short.simulate(runs, seed=1, step_s=1.0) for runs in (begin_s, found.times_s))
    assert after.actual_kwh < before.actual_kwh


def test_the_fastest_run_keeps_its_time_when_that_is_rounded(tmp_path: Path) -> None:
    short = service(files(tmp_path))
    fastest_s = float(short.hop(0).net.time_s.min())

    run = short.profile(0, fastest_s - 0.04)

    assert run is not None
    assert run.time_s[-1] == pytest.approx(fastest_s, abs=0.3)


def test_a_time_that_no_run_takes_is_refused_with_station_and_fastest_run(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r"traffic t: runs_s: C: .* no run of 20\.0 s; its fas"):
        service(files(tmp_path)).simulate([50.0, 20.0], seed=1, step_s=1.0)


def test_the_command_compares_timetables_and_writes_the_chosen_traffic(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "new").mkdir()
    out = tmp_path / "new" / "found.toml"
    words = ["--save-energy", "--traffic", files(tmp_path), "--budget", "2", "--json"]

    assert timetable_command.main([*words, "--out", str(out)]) == 0

    told = json.loads(capsys.readouterr().out)
    assert [each["name"] for each in told["timetables"]] == [
        *("as planned", "divided by least energy", "with meeting trains"),
    ]
    assert all(each["change_half_ratio"] is not None for each in told["timetables"])
    found = load_traffic(str(out))
    assert list(found.runs_s.values()) == told["runs_s"]
    assert sum(found.runs_s.values()) == pytest.approx(100.0, abs=0.2)
    assert Path(found.supply).resolve() == tmp_path / "supply.toml"
    assert tomllib.loads(out.read_text("utf-8"))["supply"] == "../supply.toml"
    assert timetable_command.main([*words, "--out", str(out)]) == 2
    assert "exists already" in capsys.readouterr().err


def test_the_train_of_a_traffic_is_its_consist_and_no_running_train_of_that_name() -> None:
    whole = of_consist(load_consist("nanakuma4"))

    assert train_of(None, "nanakuma4") == whole
    assert train_of("nanakuma4", "typeB4") == load_train("nanakuma4") != whole
