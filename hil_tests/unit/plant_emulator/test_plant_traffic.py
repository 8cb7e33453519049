"""Several trains on a line: their places, departures and common power supply."""

import itertools
from dataclasses import replace
from pathlib import Path

import pytest

from firmware_py.settings import SettingsError
from firmware_py.trackdb import LineZone, load_line
from plant_emulator.power.supplies import load_supply
from plant_emulator.traffic.config import load_traffic, plan_traffic, traffic_of
from plant_emulator.traffic.coupling import INTERVAL_S, Coupling, IntervalReport
from plant_emulator.traffic.dispatcher import LEAD_S, Dispatcher
from plant_emulator.traffic.member import leader_rear_m
from plant_emulator.traffic.timetable import lap_timetable, starts

STRONG = load_supply("strong")
TRAFFIC = load_traffic("changping")
LINE = load_line("changping")
TIMETABLE = lap_timetable(TRAFFIC, LINE)
FAR_S = 1.0e6


def test_a_lap_leaves_each_station_after_its_run_and_dwell() -> None:
    """Running takes 216, 130 and 127 s, a dwell 30 s and a turnback 97 s ([Lin])."""
    leaves_s = TIMETABLE.leaves_s

    assert leaves_s[1] == 216.0 + 30.0
    assert leaves_s[2] == leaves_s[1] + 130.0 + 30.0
    assert leaves_s[4] == leaves_s[2] + 127.0 + 97.0
    assert leaves_s[6] == leaves_s[4] + 127.0 + 30.0 + 130.0 + 30.0
    assert leaves_s[6] + 216.0 + 97.0 == TIMETABLE.lap_s == 7 * 180.0


def test_a_headway_that_leaves_too_little_time_is_refused() -> None:
    with pytest.raises(SettingsError, match="a lap takes 1260 s, 7 trains every 170 s leave 1190"):
        lap_timetable(replace(TRAFFIC, headway_s=170.0), LINE)


@pytest.mark.parametrize("trains", range(1, 8))
def test_trains_begin_one_behind_the_other_and_leave_in_time(trains: int) -> None:
    placed = starts(TRAFFIC, LINE, trains)

    assert [start.train for start in placed] == list(range(1, trains + 1))
    for ahead, behind in itertools.pairwise(placed):
        assert ahead.station.stop_m - behind.station.stop_m > 250.0
        assert ahead.phase_s - behind.phase_s == TRAFFIC.headway_s
    assert all(TIMETABLE.leaves_s[start.index] >= start.phase_s for start in placed)


@pytest.mark.parametrize("trains", [0, 8])
def test_other_numbers_of_trains_are_refused(trains: int) -> None:
    with pytest.raises(SettingsError, match="on changping there are 1 to 7"):
        starts(TRAFFIC, LINE, trains)


def test_a_line_without_traffic_is_refused_by_name() -> None:
    with pytest.raises(SettingsError, match=r"florence has no traffic file; .*: changping"):
        traffic_of("florence")


@pytest.mark.parametrize(
    ("front_m", "place_m"),
    [
        (0.0, 0.0),
        (7000.0, 7000.0),
        (7900.0, 7788.0),
        (8088.0 + 1964.0, 5824.0),
        (16000.0, 0.0),
        (16176.0 + 3799.0, 3799.0),
        (2 * 16176.0 - 300.0, 0.0),
    ],
)
def test_one_feeder_supplies_both_tracks_and_all_laps(front_m: float, place_m: float) -> None:
    assert TRAFFIC.place_m(front_m) == pytest.approx(place_m)


def dispatcher_of(index: int, dwell_s: float = 24.0) -> Dispatcher:
    start = next(each for each in starts(TRAFFIC, LINE, 7) if each.index == index)
    return Dispatcher(TRAFFIC, TIMETABLE, LINE, start, itertools.repeat(dwell_s))


def test_a_train_is_held_until_shortly_before_it_leaves() -> None:
    """At Gonghuacheng the timetable of train 6 is 180 s old, and the train leaves at 246 s."""
    dispatcher, stop_m = dispatcher_of(1), LINE.stations[1].stop_m

    assert dispatcher.holds(0.0, stop_m, 0.0)
    assert dispatcher.holds(66.0 - LEAD_S - 0.2, stop_m, 0.0)
    assert not dispatcher.holds(66.0 - LEAD_S, stop_m, 0.0)


def test_an_arrival_is_noted_and_the_dwell_begins() -> None:
    dispatcher, stations = dispatcher_of(1), LINE.stations
    for now_s in (60.0, 66.0):
        dispatcher.holds(now_s, stations[1].stop_m, 0.0)
    dispatcher.holds(80.0, stations[1].stop_m + 50.0, 10.0)
    assert not dispatcher.holds(120.0, 5000.0, 20.0)

    assert dispatcher.holds(197.0, stations[2].stop_m + 0.05, 0.0)
    assert not dispatcher.holds(197.0 + 24.0 - LEAD_S, stations[2].stop_m + 0.05, 0.0)

    run = dispatcher.runs[0]
    assert (run.station, run.planned_s) == ("Shahe", 130.0)
    assert run.late_s == pytest.approx(1.0)
    assert run.error_m == pytest.approx(0.05)


def test_a_terminal_is_left_at_once_and_the_next_platform_by_the_timetable() -> None:
    dispatcher, stations = dispatcher_of(2), LINE.stations
    dispatcher.holds(46.0, stations[2].stop_m, 0.0)
    dispatcher.holds(60.0, stations[2].stop_m + 50.0, 10.0)
    assert not dispatcher.holds(175.0, stations[3].stop_m, 0.0)

    dispatcher.holds(200.0, stations[3].stop_m + 50.0, 10.0)
    assert dispatcher.holds(246.0, stations[4].stop_m, 0.0)
    leaves_s = TIMETABLE.leaves_s[4] - 360.0
    assert dispatcher.holds(leaves_s - LEAD_S - 0.2, stations[4].stop_m, 0.0)
    assert not dispatcher.holds(leaves_s - LEAD_S, stations[4].stop_m, 0.0)


def said(front_m: float, *, wants_w: float = 0.0, gives_w: float = 0.0) -> IntervalReport:
    return IntervalReport(front_m, 0.0, front_m - 90.0, wants_w, gives_w, 100_000.0)


def test_each_train_gets_the_rear_of_the_one_ahead_and_the_foremost_that_of_the_last() -> None:
    coupling = Coupling(TRAFFIC, STRONG)

    answers = coupling.answers([said(9000.0), said(5000.0), said(1000.0)])

    assert [answer.leader_rear_m for answer in answers] == [*(17075.0, 8900.0, 4900.0)]


def test_a_braking_train_feeds_an_accelerating_one_nearby() -> None:
    apart, near = (Coupling(TRAFFIC, STRONG) for _ in range(2))
    apart.answers([said(7700.0, gives_w=1.5e6), said(100.0, wants_w=1.5e6)])
    near.answers([said(4000.0, gives_w=1.5e6), said(3900.0, wants_w=1.5e6)])

    assert near.books.sources_j < 0.5 * apart.books.sources_j
    for coupling in (apart, near):
        books = coupling.books
        trains_j = books.traction_j + books.auxiliary_j - books.regenerated_j + books.resistor_j
        assert books.trains_j == pytest.approx(trains_j, rel=1e-6)
        assert abs(books.closure_ratio) < 1e-6
        assert sum(coupling.substations_w) * INTERVAL_S == pytest.approx(books.sources_j)


def test_the_energy_of_the_power_sections_is_that_of_all_trains() -> None:
    ends_m = (0.0, 3950.0, 8000.0, 16000.0)
    sections = [LineZone(*pair, f"S{n}") for n, pair in enumerate(itertools.pairwise(ends_m), 1)]
    coupling = Coupling(TRAFFIC, STRONG, sections)

    coupling.answers([said(4000.0, gives_w=1.5e6), said(3900.0, wants_w=1.5e6)])
    coupling.answers([said(8000.0, wants_w=1.0e6), said(7999.9, wants_w=1.0e6)])

    books = coupling.books
    assert books.drawn_j["S1"] == pytest.approx(1.6e6 * INTERVAL_S, rel=1e-3)
    assert books.fed_back_j == {"S1": 0.0, "S2": pytest.approx(1.4e6 * INTERVAL_S), "S3": 0.0}
    assert books.drawn_j["S2"] == pytest.approx(1.1e6 * INTERVAL_S, rel=1e-3)
    assert books.drawn_j["S3"] == pytest.approx(books.drawn_j["S2"], rel=1e-3)
    net_j = sum(books.drawn_j.values()) - sum(books.fed_back_j.values())
    assert net_j == pytest.approx(books.trains_j, rel=1e-6)


def open_line(folder: Path, traffic: str = "", supply: str = "") -> str:
    """Write traffic of an open line, with these changes, and return its path."""
    (folder / "supply.toml").write_text(
        'name = "s"\n[[substations]]\njoint = "A"\nno_load_v = 836.0\nsource_ohm = 0.015\n'
        '[[sections]]\nbegin = "A"\nend = "B"\nbegin_m = 0.0\nend_m = 12000.0\n'
        f"ohm_per_km = 0.02\n{supply}",
        encoding="utf-8",
    )
    path = folder / "traffic.toml"
    path.write_text(
        'name = "t"\nline = "nanakuma"\nconsist = "nanakuma4"\nsupply = "supply.toml"\n'
        f"trains = 3\nheadway_s = 240.0\ndwell_s = 30.0\ndwell_spread_s = 5.0\n{traffic}",
        encoding="utf-8",
    )
    return str(path)


def test_an_open_line_has_its_own_times_and_nothing_ahead_of_the_first_train(
    tmp_path: Path,
) -> None:
    config, line, supply = plan_traffic(
        None, open_line(tmp_path, "[runs_s]\nJiromaru = 99.0\n"), None
    )
    placed = starts(config, line, 2)

    assert lap_timetable(config, line).leaves_s[1] == 99.0 + 30.0
    assert placed[0].index > placed[1].index == 0
    assert leader_rear_m(config, placed, 0, 66.0) > line.end_m
    answers = Coupling(config, supply).answers([said(4000.0), said(1000.0)])
    assert answers[0].leader_rear_m > line.end_m
    assert answers[1].leader_rear_m == 3900.0


def test_no_train_begins_at_the_end_of_an_open_line(tmp_path: Path) -> None:
    config, line, _ = plan_traffic(None, open_line(tmp_path), None)
    last_s = lap_timetable(config, line).leaves_s[-2]

    assert starts(replace(config, headway_s=last_s), line, 2)[0].station == line.stations[-2]
    with pytest.raises(SettingsError, match="the foremost would be at its end"):
        starts(replace(config, headway_s=last_s + 1.0), line, 2)


@pytest.mark.parametrize(
    ("traffic", "supply", "complaint"),
    [
        ("[runs_s]\nJiromaro = 9.0\n", "", "traffic t: runs_s: Jiromaro: .*Jiromaru"),
        (
            "[runs_s]\nJiromaru = 0.0\n",
            "",
            r"traffic\.toml:9: runs_s: Jiromaru 0\.0 is not",
        ),
        ("turnback_s = 9.0\n", "", "traffic.toml: stations_a_lap, terminals and turnback_s are"),
        ("lap_m = 900.0\n", "", r"traffic\.toml: turnback_s 0\.0 is not positive"),
        ("headway = 9.0\n", "", r"traffic\.toml:9: headway: unknown key"),
        ("", "[voltages]\nceiling_v = 2500.0\n", r"ceiling_v 2500\.0 is above 2000"),
        ("", '[[substations]]\njoint = "C"\nno_load_v = 800.0\nsource_ohm = 1.0\n', "C: no sec"),
    ],
)
def test_a_mistake_in_traffic_or_supply_is_named_with_its_file(
    traffic: str, supply: str, complaint: str, tmp_path: Path
) -> None:
    with pytest.raises(SettingsError, match=complaint):
        plan_traffic(None, open_line(tmp_path, traffic, supply), None)


def test_a_supply_that_does_not_reach_along_the_line_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="supply strong: sections: no section at 78"):
        plan_traffic("nanakuma", open_line(tmp_path), "strong")
