"""Energy by hop, against logs with a known answer."""

from io import StringIO

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from metro_hil.line.virtual.member import HopMeter
from metro_hil.metrics.hops import HopEnergy, MeterReading, hop_table, means_of, measure_hops
from metro_hil.metrics.stops import StationStop
from metro_hil.model.log_columns import Columns
from plant_emulator.traffic.dispatcher import StationRun

J_PER_KWH = 3.6e6
STOPS = (
    StationStop("B", 0.0, arrived_s=70.0, run_time_s=60.0),
    StationStop("C"),
    StationStop("D", 0.0, arrived_s=200.0, run_time_s=90.0),
)


def log(*, metered: bool = True) -> Columns:
    """A second a row. Traction takes 1 kWh, the brake gives 0.5 kWh a row; auxiliaries 0.1 kWh."""
    names = ("t_s", *MeterReading._fields)
    rows = [
        (float(row), *(row * each * J_PER_KWH if metered else "" for each in (1.0, 0.5, 1.1, 0.4)))
        for row in range(300)
    ]
    return Columns.of_rows("truth", names, rows)


def test_a_hop_has_the_energy_between_its_first_movement_and_its_standstill() -> None:
    hops = measure_hops(log(), "A", STOPS)

    assert [(hop.start, hop.end, hop.run_s) for hop in hops] == [("A", "B", 60.0), ("B", "D", 90.0)]
    assert [hop.traction_kwh for hop in hops] == pytest.approx([60.0, 90.0])
    assert [hop.regenerated_kwh for hop in hops] == pytest.approx([30.0, 45.0])
    assert [hop.drawn_kwh for hop in hops] == pytest.approx([66.0, 99.0])
    assert [hop.returned_kwh for hop in hops] == pytest.approx([24.0, 36.0])


@pytest.mark.parametrize("truth", [log(metered=False), Columns.of_rows("t", ("t_s",), [(0.0,)])])
def test_without_a_meter_there_is_a_time_and_no_energy(truth: Columns) -> None:
    """The train of another program has no meter, and older logs lack the columns."""
    (first, _) = measure_hops(truth, "A", STOPS)

    assert first == HopEnergy("A", "B", 60.0, None, None, None, None)


def test_on_a_line_a_hop_ends_with_the_run_and_begins_with_the_departure() -> None:
    """The train stands until 20 s, and runs until 60 s. It takes 1 kJ a second, also at rest."""
    meter = HopMeter("A 2", MeterReading(0.0, 0.0, 0.0, 0.0), {"A 2": "A"})
    run = StationRun("B", 40.0, 20.0, 60.0, 0.0)

    for at_s in range(1, 80):
        reading = MeterReading(*(at_s * 1000.0,) * 4)
        meter.look(reading, [run] if at_s >= 60 else [], stands=not 20 < at_s < 60)

    (hop,) = meter.found
    assert (hop.start, hop.end, hop.run_s) == ("A", "B", 40.0)
    assert hop.traction_kwh == hop.returned_kwh == pytest.approx(40.0e3 / J_PER_KWH)


def test_a_train_that_reached_no_station_has_no_hop() -> None:
    assert measure_hops(log(), "A", [StationStop("B")]) == []
    assert means_of([]) == []


@given(st.lists(st.tuples(st.sampled_from("ABC"), st.floats(1.0, 200.0)), min_size=1, max_size=12))
def test_means_times_runs_are_the_sum(runs: list[tuple[str, float]]) -> None:
    hops = [HopEnergy(start, "D", time_s, time_s, 0.0, 1.0, 0.0) for start, time_s in runs]

    rows = means_of(hops)

    assert [row["from"] for row in rows] == list(dict.fromkeys(start for start, _ in runs))
    assert sum(row["runs"] for row in rows) == len(runs)
    total = sum(row["runs"] * row["run_s"] for row in rows)
    assert total == pytest.approx(sum(time_s for _, time_s in runs))
    assert all(row["traction_kwh"] == pytest.approx(row["run_s"]) for row in rows)


def test_the_table_has_each_hop_and_the_sum() -> None:
    known = HopEnergy("A", "B", 60.0, 2.0, 0.5, 2.5, 0.25)
    again = HopEnergy("A", "B", 62.0, 3.0, 0.5, 3.5, 0.25)
    other = HopEnergy("B", "C", 30.0, 1.0, None, 1.5, 0.0)
    console = Console(width=100, file=StringIO(), record=True)

    console.print(hop_table(means_of([known, other, again])))

    lines = [line.replace("│", " ").split() for line in console.export_text().splitlines()]
    assert ["A", "B", "2", "61.0", "2.50", "0.50", "3.00", "0.25"] in lines
    assert ["B", "C", "1", "30.0", "1.00", "–", "1.50", "0.00"] in lines
    assert ["sum", "91.0", "3.50", "–", "4.50", "0.25"] in lines
