"""Timetables of trains that turn round: their energy, their search and the file that it writes."""

import json
from pathlib import Path
from typing import Final

import numpy as np
import pytest

from firmware_py.settings import SettingsError
from metro_hil.energy.line import meetings, service_command, timetable_command
from metro_hil.energy.line.meetings import find_meetings
from metro_hil.energy.line.service_command import hops_of
from metro_hil.energy.line.turning_service import TURN_S, WHOLE_S, TurningService
from metro_hil.energy.running_curve.train import load_train
from metro_hil.model.service import load_service

NETWORK: Final = Path(__file__).resolve().parents[4] / "docs/examples/line/terminus.toml"
SERVICE: Final = """
line = "terminus.toml"
trains = {trains}
headway_s = {headway_s}
[[trips]]
route = "out"
stops = ["North siding"]
run_s = {{ "North siding" = 110.0 }}
[[trips]]
route = "back"
stops = ["South siding"]
run_s = {{ "South siding" = 110.0 }}
"""
SUPPLY: Final = """
name = "s"
substations = [{ joint = "a", no_load_v = 836.0, source_ohm = 0.015 }]
sections = [{ begin = "a", end = "b", begin_m = -200.0, end_m = 1500.0, ohm_per_km = 0.02 }]
"""
PLANNED: Final = [110.0, 110.0, 0.0]
TRAIN: Final = load_train("typeB4")


def files(folder: Path, trains: int = 4, headway_s: float = 90.0) -> tuple[str, str]:
    """A service of two trips without stops on the way, and its supply."""
    (folder / "terminus.toml").write_text(NETWORK.read_text(encoding="utf-8"), encoding="utf-8")
    (folder / "supply.toml").write_text(SUPPLY, encoding="utf-8")
    text = SERVICE.format(trains=trains, headway_s=headway_s)
    (folder / "service.toml").write_text(text, encoding="utf-8")
    return str(folder / "service.toml"), str(folder / "supply.toml")


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> TurningService:
    return TurningService(*files(tmp_path_factory.mktemp("service")), TRAIN)


def test_the_energy_of_a_round_trip_is_that_of_its_runs_and_of_the_losses_between(
    service: TurningService,
) -> None:
    """The oracle is the energy of the designed runs, and of auxiliaries for the whole round."""
    found = service.simulate(PLANNED, seed=1, step_s=1.0)

    runs = service.profiles(PLANNED)
    assert found.traction_kwh + found.unserved_kwh == pytest.approx(
        sum(float(run.drawn_j[-1]) for run in runs) / 3.6e6, rel=0.01
    )
    given_kwh = sum(float(run.given_j[-1]) for run in runs) / 3.6e6
    assert found.regenerated_kwh == pytest.approx(given_kwh, rel=0.01)
    # Four trains every 90 s: each takes its auxiliaries for 360 s.
    own_kwh = TRAIN.auxiliary_w * 360.0 / 3.6e6
    least_kwh = found.traction_kwh + own_kwh - (found.regenerated_kwh - found.burnt_kwh)
    assert least_kwh < found.actual_kwh < 1.2 * least_kwh


def test_both_directions_run_over_the_same_supply(service: TurningService) -> None:
    """The middle goes from 60 m to the siding behind North and back; cars turn, and it stays."""
    out, back = service.profiles(PLANNED)

    half_m = TRAIN.length_m / 2.0
    assert out.at_m[0] == pytest.approx(60.0 + 40.0 - half_m, abs=40.0)
    assert out.at_m[-1] == pytest.approx(back.at_m[0], abs=20.0)
    assert (out.at_m[1:] > out.at_m[:-1]).all()
    assert (back.at_m[1:] < back.at_m[:-1]).all()


def test_a_layover_moves_the_trip_behind_it_and_nothing_before(service: TurningService) -> None:
    mean = np.array([0.5, 0.5])
    still = service._departures_s([110.0, 110.0, 3.0], mean)
    later = service._departures_s([110.0, 110.0, 10.0], mean)

    assert later[0] == still[0] == 0.0
    assert later[1] - still[1] == pytest.approx(7.0)
    assert later[2] == still[2] == 360.0
    assert still[1] > 110.0 + TURN_S


def test_the_search_keeps_what_the_turnback_needs(service: TurningService) -> None:
    most_s = service.layover_max_s(PLANNED, 1)

    found = find_meetings(service, PLANNED, seed=1, budget=4)

    assert found == find_meetings(service, PLANNED, seed=1, budget=4)
    assert 0.0 <= found.times_s[-1] <= most_s < 90.0
    assert not service.permits([110.0, 110.0, most_s + 0.1], PLANNED, {2: 1.0})
    assert not service.permits([110.0, 110.0, -0.1], PLANNED, {2: -1.0})
    assert service.permits([110.0, 110.0, most_s], PLANNED, {2: 1.0})
    before, after = (service.simulate(t, seed=7001, step_s=4.0) for t in (PLANNED, found.times_s))
    assert after.actual_kwh <= before.actual_kwh


def test_no_run_is_shorter_than_whole_trains_or_the_plan_take(service: TurningService) -> None:
    fastest_s = float(service.hop(0).net.time_s.min())
    least_s = service.least_s(0)
    (costs, _) = hops_of(service)

    assert least_s == pytest.approx(min(110.0, fastest_s + WHOLE_S))
    assert costs.fastest_s == least_s
    assert costs.energy_j(least_s) == costs.energies_j[0] > costs.energies_j[-1]
    near = [least_s, 220.0 - least_s, 0.0]
    assert service.permits(near, near, {0: 1.0})
    assert not service.permits([least_s - 0.1, *near[1:]], near, {0: 1.0})


def test_a_round_trip_that_its_trains_cannot_make_in_time_is_refused(tmp_path: Path) -> None:
    service = TurningService(*files(tmp_path, trains=2), TRAIN)

    with pytest.raises(SettingsError, match=r"headway_s: a round trip takes up to \d+ s, and 2"):
        service.simulate(PLANNED, seed=1, step_s=4.0)


def test_a_service_without_a_timetable_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="headway_s: is 0; trains that meet need a timetable"):
        TurningService(*files(tmp_path, headway_s=0.0), TRAIN)


def test_the_command_writes_a_service_that_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(service_command, "JUDGING_STEP_S", 6.0)
    monkeypatch.setattr(meetings, "TRAINING_STEP_S", 6.0)
    name, supply = files(tmp_path)
    (tmp_path / "new").mkdir()
    out = tmp_path / "new" / "found.toml"
    words = ["--save-energy", "--service", name, "--supply", supply, "--train", "typeB4"]

    assert timetable_command.main([*words, "--budget", "2", "--json", "--out", str(out)]) == 0

    told = json.loads(capsys.readouterr().out)
    trips = load_service(str(out))
    assert [dict(trip.run_s) for trip in trips] == [
        {"North siding": told["runs_s"][0]},
        {"South siding": told["runs_s"][1]},
    ]
    assert [trip.layover_s for trip in trips] == [0.0, *told["layovers_s"]]
    assert sum(told["runs_s"]) == pytest.approx(220.0)
    line = trips[0].timed(trips[0].path.line)
    assert line.station("North siding").run_s == told["runs_s"][0]
    assert told["timetables"][0]["layovers_s"] == [0.0]


@pytest.mark.parametrize(
    ("more", "problem"),
    [
        (["--line", "hefei"], "--line: not with --service, whose file decides it"),
        (["--traffic", "changping"], "--traffic: not with --service, whose file decides it"),
        ([], "--supply: is missing; --service needs it"),
    ],
)
def test_options_that_do_not_fit_a_service_are_refused(
    more: list[str], problem: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name, supply = files(tmp_path)
    words = ["--save-energy", "--service", name, "--train", "typeB4", *more]
    if more:
        words += ["--supply", supply]

    assert timetable_command.main(words) == 2

    assert problem in capsys.readouterr().err
