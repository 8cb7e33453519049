"""Trains with their controllers on one line: reproducible bytes, and distance between trains."""

import os
from pathlib import Path

import pytest

from metro_hil.line.virtual.coordinator import TrainDiedError, conduct, groups
from metro_hil.line.virtual.member import VirtualTrain, plan_line
from plant_emulator.traffic.coupling import INTERVAL_S, Coupling, IntervalReport

LENGTH_M = 78.08


def test_the_number_of_processes_changes_no_byte(tmp_path: Path) -> None:
    """Only one of the two runs writes logs, which change nothing either."""
    plan = plan_line(line="changping", trains=3, consist=None, params=None, seed=5, law="green")
    folders = [tmp_path / f"train{start.train}" for start in plan.starts]
    for folder in folders:
        folder.mkdir()

    here = conduct(plan, 15.0, folders=[None] * 3, processors=1)
    there = conduct(plan, 15.0, folders=folders, processors=2)

    assert here.reports == there.reports
    assert here.rows == there.rows
    assert here.coupling.network.unconverged == there.coupling.network.unconverged == 0
    assert len({report.frame_chain for report in here.reports}) == 3
    assert all((folder / "bus.log").stat().st_size > 10_000 for folder in folders)
    metered_j = sum(each.energy.drawn_j - each.energy.returned_j for each in here.reports)
    assert metered_j > 0.0
    assert abs(metered_j / here.coupling.books.trains_j - 1.0) < 1e-9


def test_the_bus_reports_the_voltage_at_the_pantograph(tmp_path: Path) -> None:
    """The test decodes LINE_SUPPLY of one train from its log and compares it with the network's
    voltage."""
    plan = plan_line(line="changping", trains=1, consist=None, params=None, seed=1)
    (tmp_path / "train1").mkdir()

    record = conduct(plan, 40.0, folders=[tmp_path / "train1"])

    rows = (tmp_path / "train1" / "bus.log").read_text().splitlines()
    supplies = [row.split()[2].split("#")[1] for row in rows if " 188#" in row]
    volts = [int.from_bytes(bytes.fromhex(text)[:2], "little") / 10.0 for text in supplies]
    answered = [row.answers[0].voltage_v for row in record.rows]
    assert min(answered) < 815.0 < 834.0 < max(answered)
    assert all(any(abs(volt - each) < 0.06 for volt in volts) for each in answered[:-1])


@pytest.mark.sources
def test_a_train_stops_behind_one_that_is_kept_at_its_platform() -> None:
    plan = plan_line(line="changping", trains=2, consist=None, params=None, seed=2, law="timing")
    seats = [VirtualTrain(plan, index, None) for index in range(2)]
    seats[0].member.dispatcher.holds = lambda *_: True  # type: ignore[method-assign]
    coupling = Coupling(plan.traffic, plan.supply)
    gaps_m, speeds_mps = [], []

    for _ in range(round(250.0 / INTERVAL_S)):
        said = [seat.advance() for seat in seats]
        gaps_m.append(said[0].front_m - LENGTH_M - said[1].front_m)
        speeds_mps.append(said[1].speed_mps)
        for seat, answer in zip(seats, coupling.answers(said), strict=True):
            seat.on_message(answer)
    reports = [seat.close() for seat in seats]

    assert max(speeds_mps) > 15.0
    assert speeds_mps[-1] == 0.0
    assert 10.0 < gaps_m[-1] < 65.0
    assert min(gaps_m) == gaps_m[-1]
    assert [report.emergencies for report in reports] == [0, 0]


@pytest.mark.sources
def test_a_train_whose_process_ends_is_named_with_its_exit_code(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    plan = plan_line(line="changping", trains=2, consist=None, params=None, seed=5)
    advance = VirtualTrain.advance

    def dying(seat: VirtualTrain) -> IntervalReport:
        said = advance(seat)
        if seat.member.train == 1 and seat.member.plant.world.now_ns >= 10**9:
            os._exit(7)
        return said

    monkeypatch.setattr(VirtualTrain, "advance", dying)

    with pytest.raises(TrainDiedError, match="train 1: its process ended with 7"):
        conduct(plan, 5.0, folders=[None] * 2, processors=2)


@pytest.mark.parametrize(
    ("trains", "processors", "sizes"),
    [(7, 1, [7]), (7, 2, [4, 3]), (7, 4, [2, 2, 2, 1]), (7, 16, [1] * 7), (1, 2, [1])],
)
def test_trains_are_spread_evenly_over_processors(
    trains: int, processors: int, sizes: list[int]
) -> None:
    found = groups(trains, processors)

    assert [len(group) for group in found] == sizes
    assert [train for group in found for train in group] == list(range(trains))
