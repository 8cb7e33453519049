"""Running time and energy of each hop, by the train's own meter."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import mean
from typing import Any, Final, NamedTuple

import numpy as np
from rich.table import Table

from metro_hil.metrics.stops import StationStop
from metro_hil.model.log_columns import Columns
from plant_emulator.power import HighVoltageBox
from plant_emulator.power.box import J_PER_KWH

ENERGIES: Final = ("traction_kwh", "regenerated_kwh", "drawn_kwh", "returned_kwh")


class MeterReading(NamedTuple):
    """Energies of a train since its start; as columns of the truth log they have these names."""

    traction_j: float
    """Into the inverters."""
    regenerated_j: float
    """Out of the inverters while the motors brake."""
    drawn_j: float
    """At the collector, with auxiliaries."""
    returned_j: float


@dataclass(frozen=True, slots=True)
class HopEnergy:
    """One run from a stop to the next, from its first movement to its first standstill.

    Energies are as in `MeterReading`. They are None if the train had no meter of the bench.
    """

    start: str
    end: str
    run_s: float
    traction_kwh: float | None
    regenerated_kwh: float | None
    drawn_kwh: float | None
    returned_kwh: float | None


def read_meter(power: HighVoltageBox) -> MeterReading:
    """Read the meter of a train."""
    return MeterReading(power.traction_j, power.braking_j, power.drawn_j, power.returned_j)


def hop_between(
    stations: tuple[str, str], run_s: float, left: MeterReading, arrived: MeterReading
) -> HopEnergy:
    """The hop between two readings of the meter."""
    used_kwh = [(now - then) / J_PER_KWH for then, now in zip(left, arrived, strict=True)]
    return HopEnergy(*stations, run_s, *(None if np.isnan(each) else each for each in used_kwh))


def measure_hops(truth: Columns, start: str, stops: Sequence[StationStop]) -> list[HopEnergy]:
    """The hops to all stations that the train reached, in running order.

    Args:
        start: station of the first departure.
        stops: as `measure_stops` gives them for this log.
    """
    time_s = truth.numbers("t_s")
    found: list[HopEnergy] = []
    for stop in stops:
        if stop.arrived_s is None or stop.run_time_s is None:
            continue
        left_s = stop.arrived_s - stop.run_time_s
        left, arrived = (
            MeterReading(
                *(
                    float(np.interp(at_s, time_s, truth.numbers(name)))
                    if truth.has(name)
                    else np.nan
                    for name in MeterReading._fields
                )
            )
            for at_s in (left_s, stop.arrived_s)
        )
        found.append(hop_between((start, stop.station), stop.run_time_s, left, arrived))
        start = stop.station
    return found


def means_of(hops: Sequence[HopEnergy]) -> list[dict[str, Any]]:
    """Means over all runs of each hop, in the order of the first runs, for JSON."""
    by_ends: dict[tuple[str, str], list[HopEnergy]] = {}
    for hop in hops:
        by_ends.setdefault((hop.start, hop.end), []).append(hop)
    return [
        {
            "from": start,
            "to": end,
            "runs": len(runs),
            "run_s": mean(run.run_s for run in runs),
            **{name: _mean([getattr(run, name) for run in runs]) for name in ENERGIES},
        }
        for (start, end), runs in by_ends.items()
    ]


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return mean(known) if known else None


def hop_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """The table of the hops that `means_of` returned, with their sum."""
    title = "hops, without standing times; energies in kWh"
    table = Table(title=title, title_justify="left", title_style="bold")
    for name in ("from", "to"):
        table.add_column(name, overflow="fold")
    for name in ("runs", "time, s", "traction", "regenerated", "drawn", "returned"):
        table.add_column(name, justify="right", no_wrap=True)
    for row in rows:
        cells = [str(row["from"]), str(row["to"]), str(row["runs"]), f"{row['run_s']:.1f}"]
        table.add_row(*cells, *(_sum_text([row[name]]) for name in ENERGIES))
    time_s = sum(row["run_s"] for row in rows)
    sums = (_sum_text([row[name] for row in rows]) for name in ENERGIES)
    table.add_section()
    table.add_row("sum", "", "", f"{time_s:.1f}", *sums)
    return table


def _sum_text(values_kwh: Sequence[float | None]) -> str:
    known = [value for value in values_kwh if value is not None]
    return f"{sum(known):.2f}" if known and len(known) == len(values_kwh) else "–"
