"""A train drives out, changes ends at the terminal, and drives back."""

from pathlib import Path
from typing import Final

import pytest

from firmware_py.trackdb.circuit import load_path
from metro_hil.model.end_condition import ARRIVED
from metro_hil.model.mission import plan_journey
from metro_hil.model.run_options import RunOptions, parse
from metro_hil.run.lockstep import Lockstep, config_of, scenario_of
from metro_hil.run.turnback import Departure, both_ways, change_ends
from plant_emulator.train_config import load_train, seen_from_other_cab
from vobc.vocabulary import PlaceProof

STOPPED_M: Final = 0.1
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


def ride(chosen: RunOptions, departure: Departure | None) -> Lockstep:
    journey, scenario = plan_journey(chosen), scenario_of(chosen)
    if departure is not None:
        journey, scenario = departure.journey(journey), departure.scenario(scenario)
    bench = Lockstep(config_of(chosen), scenario, journey)
    bench.run_until(lambda now_ns: now_ns > 2_000_000)
    return bench


def test_the_train_drives_out_and_back_and_never_lies_about_its_place(tmp_path: Path) -> None:
    out, back = both_ways(options(tmp_path))
    came, leaves = load_path(out.line), load_path(back.line)

    bench = ride(out, None)
    assert bench.run() == ARRIVED
    departure = change_ends(bench, came, leaves)
    bench.close()

    true_m, handed = departure.turned.front_m, departure.handed_over
    assert handed.proof is PlaceProof.REMEMBERED
    assert abs(true_m - handed.front_m) <= handed.bound_m
    # B is at 160 m, and the train of 68.59 m stands there with its new front at 91.41 m.
    assert true_m == pytest.approx(leaves.line.start_m + leaves.line.end_m - 91.41, abs=0.2)

    bench = ride(back, departure)
    assert bench.vobc.output.motion is None or not bench.vobc.output.motion.localised
    assert bench.plant.world.front_m == true_m
    assert bench.run() == ARRIVED
    stop_m = leaves.line.station("A").stop_m
    assert abs(bench.plant.world.front_m - stop_m) <= STOPPED_M
    bench.close()


def test_a_train_that_still_runs_hands_over_no_place(tmp_path: Path) -> None:
    out, back = both_ways(options(tmp_path))
    bench = ride(out, None)
    bench.run_until(lambda _: bench.plant.world.speed_mps > 3.0)

    departure = change_ends(bench, load_path(out.line), load_path(back.line))

    bench.close()
    assert departure.handed_over.proof is PlaceProof.UNKNOWN


def test_a_train_turned_twice_is_the_same_train() -> None:
    train = load_train("typeB4")

    assert seen_from_other_cab(seen_from_other_cab(train)) == train
    assert [each.car for each in seen_from_other_cab(train).sensors.tachos] == [4, 3]


def test_both_ways_keep_stations_and_folders_apart(tmp_path: Path) -> None:
    out, back = both_ways(options(tmp_path, "--from", "A", "--out", "here"))

    assert (out.line[-3:], out.start, out.end, out.out) == (":up", "A", None, "here/out")
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
