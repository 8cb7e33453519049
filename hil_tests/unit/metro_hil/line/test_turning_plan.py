"""The plan of a service of several trains, its headway limit, and what is refused."""

import json
from pathlib import Path
from typing import Final

import pytest

from firmware_py.settings import SettingsError
from firmware_py.trackdb.network import Running
from firmware_py.trackdb.paths import TrackPlace
from metro_hil.cli import vobc_run
from metro_hil.line.turning.command import as_document
from metro_hil.line.turning.conductor import Conductor, GraphPoint
from metro_hil.line.turning.figures import draw
from metro_hil.line.turning.headway import headway_limit, turnbacks
from metro_hil.line.turning.plan import FleetPlan, plan_fleet
from metro_hil.line.turning.train import TripRecord
from metro_hil.model.run_options import EXIT_USAGE, parse

EXAMPLES: Final = Path(__file__).resolve().parents[4] / "docs/examples/line"
NS: Final = 1_000_000_000


def plan(service: Path, *options: str) -> FleetPlan:
    return plan_fleet(parse(["run", "--lockstep", "--service", str(service), *options]))


@pytest.fixture(scope="module")
def every_90_s() -> FleetPlan:
    return plan(EXAMPLES / "every_90_s.toml")


def test_trains_are_due_one_headway_after_each_other(every_90_s: FleetPlan) -> None:
    assert every_90_s.trains == 6
    assert [every_90_s.due_ns(train, 0) for train in (1, 2, 6)] == [0, 90 * NS, 450 * NS]
    # Only the first trip of a round trip has a time: six trains leave 540 s.
    assert every_90_s.due_ns(1, 1) == 0
    assert every_90_s.due_ns(2, 2) == 630 * NS
    assert len({every_90_s.seed_of(train) for train in range(1, 7)}) == 6


def test_the_limit_adds_up_its_terms(every_90_s: FleetPlan) -> None:
    came, leaves = every_90_s.trips[0], every_90_s.trips[1]
    entry = came.entry
    assert entry is not None
    # North is at 1215 m, the signal at 1255 m: the train brakes for it from the middle on.
    assert (entry.start_m, entry.signal_m, entry.brake_m) == (1215.0, 1255.0, 1235.0)

    limit = headway_limit(every_90_s, came, entry, leaves)

    # From North to the siding 180 m, at 11 m/s as the limit: 180/11 + 11/0.8 + 0.8/0.6, less the
    # 20 m up to the brake. Out: 100 m up to the switch, and 78.6 m until the rear is 10 m beyond.
    ramp_s = 11.0 / 0.8 + 0.8 / 0.6
    assert limit.run_in_s == pytest.approx(180.0 / 11.0 + ramp_s - entry.brake_s, abs=2.5)
    # The switch has moved before the train would brake for the signal ahead of it.
    assert limit.wait_s == 0.0
    terms_s = limit.run_in_s + limit.turn_s + limit.wait_s + limit.run_out_s
    assert limit.total_s == pytest.approx(4.0 + 0.3 + terms_s)
    assert limit.total_s < 90.0


def test_the_headway_at_a_turnback_is_that_of_trains_that_left_its_switch(
    every_90_s: FleetPlan, tmp_path: Path
) -> None:
    conductor = Conductor(every_90_s, lambda number: None)
    for train, later_s in zip(conductor.trains, (0.0, 91.0), strict=False):
        came = TripRecord(train.number, 0, "South siding", "North siding", later_s, later_s, False)
        came.entered_s = later_s + 228.0
        leaves = TripRecord(
            train.number, 1, "North siding", "South siding", later_s + 261.0, None, True
        )
        leaves.clear_s = later_s + 289.0
        train.trips += [came, leaves]
    trips = [trip for train in conductor.trains for trip in train.trips]

    (turnback,) = turnbacks(every_90_s, trips)

    assert (turnback.limit.station, turnback.turns) == ("North siding", 2)
    assert turnback.headways_s == (91.0,)
    assert turnback.least_s == pytest.approx(61.0 + 4.3)
    document = json.loads(json.dumps(as_document(every_90_s, conductor, [turnback])))
    assert document["turnbacks"][0]["limit_s"] == pytest.approx(turnback.limit.total_s)
    assert (document["least_gap_m"], document["checked_count"]) == (None, 0)
    record = conductor.record
    record.points += [
        GraphPoint(float(at_s), 1, 0, TrackPlace("east", 200.0 + at_s, Running.UP))
        for at_s in range(5)
    ]
    draw(tmp_path / "graph.png", every_90_s, record, [turnback])
    assert (tmp_path / "graph.png").read_bytes().startswith(b"\x89PNG")


def test_a_line_without_switches_takes_one_train(tmp_path: Path) -> None:
    service = tmp_path / "service.toml"
    service.write_text('line = "florence"\n[[trips]]\nroute = "up"\n', encoding="utf-8")

    with pytest.raises(SettingsError, match="trains 2: florence has no switches"):
        plan(service, "--trains", "2")


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (["--trains", "21"], "--trains 21: with a service there are 1 to 20"),
        (["--trains", "2", "--traffic", "changping"], "--traffic: not with --service"),
        (["--trains", "2", "--supply", "weak"], "supply weak: sections: no section at"),
    ],
)
def test_options_that_do_not_fit(
    words: list[str], problem: str, capsys: pytest.CaptureFixture[str]
) -> None:
    service = ["run", "--lockstep", "--service", str(EXAMPLES / "shuttle.toml")]
    try:
        code: object = vobc_run.main([*service, *words])
    except SystemExit as ended:
        code = ended.code

    assert code == EXIT_USAGE
    assert problem in capsys.readouterr().err
