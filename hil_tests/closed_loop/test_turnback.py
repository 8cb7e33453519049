"""A train drives out, changes ends at the terminal, and drives back."""

from pathlib import Path
from typing import Final

import pytest

from firmware_py.settings import SettingsError
from metro_hil.model.end_condition import ARRIVED
from metro_hil.model.mission import plan_journey
from metro_hil.model.run_options import RunOptions, parse
from metro_hil.model.service import PlannedTrip
from metro_hil.run.lockstep import Lockstep, config_of, scenario_of
from metro_hil.run.turnback import (
    Departure,
    go_on,
    options_of,
    timed_journey,
    timed_scenario,
    trips_of,
)
from plant_emulator.train_config import load_train, seen_from_other_cab
from vobc.vocabulary import PlaceProof

STOPPED_M: Final = 0.1
EXAMPLES: Final = Path(__file__).resolve().parents[2] / "docs/examples/line"
LINE: Final = """
name = "shuttle"
start_m = -130.0
end_m = 400.0
stations = [
    { name = "A", stop_m = 0.0, platform_start_m = -75.0, platform_end_m = 5.0, dwell_s = 5.0 },
    { name = "B", stop_m = 160.0, platform_start_m = 85.0, platform_end_m = 165.0, dwell_s = 5.0 },
]
speed_sections = [{ start_m = -130.0, end_m = 400.0, limit_mps = 15.0 }]
gradients = [{ start_m = 20.0, end_m = 60.0, gradient_permille = 20.0 }]
tags = [
    { tag_id = 4, position_m = -2.0, kind = "stop", station = "A" },
    { tag_id = 11, position_m = 108.0, kind = "t1", station = "B" },
    { tag_id = 12, position_m = 148.0, kind = "t2", station = "B" },
    { tag_id = 13, position_m = 156.5, kind = "t3", station = "B" },
    { tag_id = 14, position_m = 158.0, kind = "stop", station = "B" },
]
"""


def options(folder: Path, *more: str) -> RunOptions:
    path = folder / "shuttle.toml"
    path.write_text(LINE, encoding="utf-8")
    return parse(["run", "--lockstep", "--and-back", "--line", str(path), *more])


def ride(chosen: RunOptions, trip: PlannedTrip, departure: Departure | None) -> Lockstep:
    journey = timed_journey(trip, plan_journey(chosen))
    scenario = timed_scenario(trip, scenario_of(chosen))
    if departure is not None:
        journey, scenario = departure.journey(journey), departure.scenario(scenario)
    bench = Lockstep(config_of(chosen), scenario, journey)
    bench.run_until(lambda now_ns: now_ns > 2_000_000)
    return bench


def test_the_train_drives_out_and_back_and_never_lies_about_its_place(tmp_path: Path) -> None:
    chosen = options(tmp_path)
    came, leaves = trips_of(chosen)
    out, back = options_of(chosen, (came, leaves))

    bench = ride(out, came, None)
    assert bench.run() == ARRIVED
    departure = go_on(bench, came, leaves, cab_b=False)
    bench.close()

    true_m, handed = departure.turned.front_m, departure.handed_over
    assert handed.proof is PlaceProof.REMEMBERED
    assert abs(true_m - handed.front_m) <= handed.bound_m
    # B is at 160 m, and the train of 68.59 m stands there with its new front at 91.41 m.
    line = leaves.path.line
    assert true_m == pytest.approx(line.start_m + line.end_m - 91.41, abs=0.2)

    bench = ride(back, leaves, departure)
    assert bench.vobc.output.motion is None or not bench.vobc.output.motion.localised
    assert bench.plant.world.front_m == true_m
    assert bench.run() == ARRIVED
    stop_m = line.station("A").stop_m
    assert abs(bench.plant.world.front_m - stop_m) <= STOPPED_M
    bench.close()


def test_a_train_that_still_runs_hands_over_no_place(tmp_path: Path) -> None:
    chosen = options(tmp_path)
    came, leaves = trips_of(chosen)
    bench = ride(options_of(chosen, (came, leaves))[0], came, None)
    bench.run_until(lambda _: bench.plant.world.speed_mps > 3.0)

    departure = go_on(bench, came, leaves, cab_b=False)

    bench.close()
    assert departure.handed_over.proof is PlaceProof.UNKNOWN


def test_a_train_turned_twice_is_the_same_train() -> None:
    train = load_train("typeB4")

    assert seen_from_other_cab(seen_from_other_cab(train)) == train
    assert [each.car for each in seen_from_other_cab(train).sensors.tachos] == [4, 3]


def test_both_ways_keep_stations_and_folders_apart(tmp_path: Path) -> None:
    chosen = options(tmp_path, "--from", "A", "--out", "here")
    out, back = options_of(chosen, trips_of(chosen))

    assert (out.line[-3:], out.start, out.end, out.out) == (":up", "A", "B", "here/out")
    assert (back.line[-5:], back.start, back.end, back.out) == (":down", "B", "A", "here/back")


@pytest.mark.parametrize(
    "words", [(), ("--lockstep", "--duration", "9"), ("--lockstep", "--trains", "2")]
)
def test_what_cannot_change_ends_is_refused(
    words: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        parse(["run", "--and-back", *words])

    assert ended.value.code == 2
    assert "--and-back: " in capsys.readouterr().err


LOOP: Final = """
name = "balloon"
buffer_stops = ["a.start", "b.start"]
joins = [{ a = "a.end", b = "loop.start" }, { a = "loop.end", b = "b.end" }]
[[tracks]]
name = "a"
start_m = -100.0
end_m = 50.0
limits = [{ start_m = -100.0, end_m = 50.0, limit_mps = 10.0 }]
platforms = [{ station = "A", start_m = -80.0, end_m = 5.0, stop_up_m = 0.0, dwell_s = 1.0 }]
tags = [{ tag_id = 1, position_m = -2.0, kind = "stop", station = "A", direction = "up" }]
[[tracks]]
name = "loop"
start_m = 0.0
end_m = 150.0
limits = [{ start_m = 0.0, end_m = 150.0, limit_mps = 10.0 }]
platforms = [
    { station = "L", start_m = 20.0, end_m = 99.0, side = "none", stop_up_m = 90.0, dwell_s = 0.0 },
]
tags = [
    { tag_id = 11, position_m = 38.0, kind = "t1", station = "L", direction = "up" },
    { tag_id = 12, position_m = 78.0, kind = "t2", station = "L", direction = "up" },
    { tag_id = 13, position_m = 86.5, kind = "t3", station = "L", direction = "up" },
    { tag_id = 14, position_m = 88.0, kind = "stop", station = "L", direction = "up" },
]
[[tracks]]
name = "b"
start_m = -100.0
end_m = 50.0
limits = [{ start_m = -100.0, end_m = 50.0, limit_mps = 10.0 }]
platforms = [{ station = "B", start_m = -80.0, end_m = 5.0, stop_down_m = -70.0, dwell_s = 1.0 }]
[[routes]]
name = "in"
legs = ["a up", "loop up"]
[[routes]]
name = "off"
legs = ["loop up", "b down"]
"""


def test_in_a_loop_the_train_goes_on_with_the_same_cab(tmp_path: Path) -> None:
    """In the siding, the doors stay shut, and the wayside keeps the train for the layover."""
    (tmp_path / "balloon.toml").write_text(LOOP, encoding="utf-8")
    service = tmp_path / "service.toml"
    service.write_text(
        'line = "balloon.toml"\n[[trips]]\nroute = "in"\n'
        '[[trips]]\nroute = "off"\nlayover_s = 12.0\n',
        encoding="utf-8",
    )
    chosen = parse(["run", "--lockstep", "--service", str(service)])
    came, leaves = trips_of(chosen)
    first, second = options_of(chosen, (came, leaves))

    bench = ride(first, came, None)
    assert bench.run() == ARRIVED
    assert bench.plant.world.doors_locked
    departure = go_on(bench, came, leaves, cab_b=False)
    bench.close()

    assert not departure.cab_b
    # The path that leads on begins with the loop, where the train stands at 90 m.
    assert departure.turned.front_m == pytest.approx(90.0, abs=STOPPED_M)
    handed = departure.handed_over
    assert abs(departure.turned.front_m - handed.front_m) <= handed.bound_m

    bench = ride(second, leaves, departure)
    bench.run_until(lambda now_ns: now_ns > 11_900_000_000)
    assert bench.plant.world.front_m == pytest.approx(departure.turned.front_m, abs=0.01)
    bench.run_until(lambda now_ns: bench.plant.world.speed_mps > 0.5)
    bench.close()
    assert bench.clock.now_ns() < 20_000_000_000


@pytest.mark.parametrize(
    ("before", "after", "problem"),
    [
        ('route = "back"', 'route = "bak"', "shuttle.toml:12: trips[1].route: 'bak': not a route"),
        ("layover_s = 20.0", 'start = "Pier"', "trips[1].start: 'Pier': the trip before ends at"),
        ("Pier = 25.0", "Peer = 25.0", "trips[1].dwell_s: 'Peer': no stop on route back; nearest"),
        ("dwell_s = { Pier", "run_s = { Peer", "trips[1].run_s: 'Peer': no stop on route back; ne"),
        ("dwell_s = { Pier = 25.0", "run_s = { Pier = -1.0", "run_s.Pier -1 is not in 0..600"),
        ("layover_s = 20.0", 'end = "Siding"', "trips[1]: end Siding: lies at 145 m, not beyond"),
        ("layover_s = 20.0", "layover_s = 601.0", "layover_s 601.0 is not in 0..600"),
        ("round_trips = 2", "round_trips = 0", "round_trips 0 is not in 1..100"),
        ('"ferry.toml"', '"fery.toml"', "fery.toml: no such file"),
        ('"ferry.toml"', '"ferry.toml:out"', "names a route; each trip names its own"),
    ],
)
def test_a_service_that_cannot_be_driven_is_refused(
    before: str, after: str, problem: str, tmp_path: Path
) -> None:
    for name in ("ferry.toml", "shuttle.toml"):
        text = (EXAMPLES / name).read_text(encoding="utf-8")
        (tmp_path / name).write_text(text.replace(before, after), encoding="utf-8")

    with pytest.raises(SettingsError) as refused:
        trips_of(parse(["run", "--lockstep", "--service", str(tmp_path / "shuttle.toml")]))

    assert problem in str(refused.value)


def test_the_file_of_a_service_decides_what_options_would() -> None:
    with pytest.raises(SystemExit):
        parse(["run", "--lockstep", "--service", "x.toml", "--to", "III"])
