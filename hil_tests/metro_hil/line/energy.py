"""Energy of several trains on one supply network, for JSON, tables and summaries."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any, Final, NamedTuple

from rich.table import Table

from plant_emulator.power import HighVoltageBox
from plant_emulator.power.box import J_PER_KWH
from plant_emulator.traffic.coupling import PowerCoupling

PERCENT: Final = 100.0
COLUMNS: Final = ("drawn", "returned", "resistor", "lowest voltage")
"""Columns of the table of trains, see `cells_of`."""


class TrainEnergy(NamedTuple):
    """Energies of one train by its own meter."""

    drawn_j: float
    returned_j: float
    resistor_j: float
    traction_j: float
    braking_j: float
    auxiliary_j: float
    lowest_v: float
    """Lowest voltage at the pantograph; infinite before the network fed the train."""


@dataclass(frozen=True, slots=True)
class FullService:
    """Energy of the network while all trains run: a whole number of headways, if there is one."""

    from_s: float
    to_s: float
    actual_j: float
    """Energy from the grid, less what inverters return."""
    regenerated_j: float
    resistor_j: float


def energy_of(power: HighVoltageBox) -> TrainEnergy:
    """Read the meter of a train."""
    return TrainEnergy(*(getattr(power, name) for name in TrainEnergy._fields))


def keys_of_network(coupling: PowerCoupling, trains: Sequence[TrainEnergy]) -> dict[str, Any]:
    """The energy of all trains together, for JSON."""
    books, network = coupling.books, coupling.network
    used_j = books.regenerated_j - books.resistor_j
    return {
        "actual_kwh": books.sources_j / J_PER_KWH,
        "returned_kwh": books.returned_j / J_PER_KWH,
        "storages_kwh": books.storages_j / J_PER_KWH,
        "overall_kwh": (books.sources_j + used_j) / J_PER_KWH,
        "traction_kwh": books.traction_j / J_PER_KWH,
        "auxiliary_kwh": books.auxiliary_j / J_PER_KWH,
        "regenerated_kwh": books.regenerated_j / J_PER_KWH,
        "resistor_kwh": books.resistor_j / J_PER_KWH,
        "lost_kwh": books.lost_j / J_PER_KWH,
        "use_ratio": used_j / max(1.0, books.traction_j),
        "lowest_v": books.lowest_v,
        "highest_v": books.highest_v,
        "closure_ratio": books.closure_ratio,
        "metered_ratio": _metered_ratio(coupling, trains),
        "unconverged": network.unconverged,
        "solved": network.solved,
        "sections": [
            {
                "section": name,
                "drawn_kwh": drawn_j / J_PER_KWH,
                "returned_kwh": books.fed_back_j[name] / J_PER_KWH,
            }
            for name, drawn_j in books.drawn_j.items()
        ],
    }


def section_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """The energy by power section, from its keys."""
    table = Table("power section", "drawn", "returned")
    for row in rows:
        energies = (f"{row[key]:.1f} kWh" for key in ("drawn_kwh", "returned_kwh"))
        table.add_row(row["section"], *energies)
    return table


def _metered_ratio(coupling: PowerCoupling, trains: Sequence[TrainEnergy]) -> float:
    """Relative difference between the trains' own meters and the network's books."""
    metered_j = sum(each.drawn_j - each.returned_j for each in trains)
    booked_j = coupling.books.trains_j
    return (metered_j - booked_j) / max(1.0, abs(booked_j))


def keys_of_train(energy: TrainEnergy) -> dict[str, float | None]:
    """The energy of one train, for JSON."""
    return {
        "drawn_kwh": energy.drawn_j / J_PER_KWH,
        "returned_kwh": energy.returned_j / J_PER_KWH,
        "regenerated_kwh": energy.braking_j / J_PER_KWH,
        "resistor_kwh": energy.resistor_j / J_PER_KWH,
        "lowest_v": energy.lowest_v if isfinite(energy.lowest_v) else None,
    }


def keys_of_service(full: FullService) -> dict[str, float]:
    """The energy while all trains run, for JSON."""
    return {
        "from_s": full.from_s,
        "to_s": full.to_s,
        "actual_kwh": full.actual_j / J_PER_KWH,
        "regenerated_kwh": full.regenerated_j / J_PER_KWH,
        "resistor_kwh": full.resistor_j / J_PER_KWH,
    }


def cells_of(energy: TrainEnergy) -> list[str]:
    """The energy of one train in a row of the table, by `COLUMNS`."""
    joules = (energy.drawn_j, energy.returned_j, energy.resistor_j)
    volts = f"{energy.lowest_v:.0f} V" if isfinite(energy.lowest_v) else "–"
    return [*(f"{each / J_PER_KWH:.1f} kWh" for each in joules), volts]


def summary_of(document: Mapping[str, Any]) -> list[str]:
    """Parts of the summary about the network.

    Args:
        document: with the keys of `keys_of_network`.
    """
    full = document.get("full_service")
    return [
        f"from the grid {document['actual_kwh']:.1f} kWh, regeneration used "
        f"{document['use_ratio']:.1%} of traction",
        f"regenerated {document['regenerated_kwh']:.1f} kWh, of which resistors burnt "
        f"{document['resistor_kwh']:.1f} kWh; lost in the network {document['lost_kwh']:.1f} kWh",
        *([] if full is None else [_text_of(full)]),
        f"pantographs {document['lowest_v']:.0f} to {document['highest_v']:.0f} V",
        f"{document['unconverged']} of {document['solved']} instants without a network solution",
        f"energy balance closes within {PERCENT * abs(document['closure_ratio']):.4f} %",
        f"meters within {PERCENT * abs(document['metered_ratio']):.3f} %",
    ]


def _text_of(full: Mapping[str, float]) -> str:
    """The energy while all trains run, from its keys."""
    return (
        f"with all trains running, from {full['from_s']:.0f} s to {full['to_s']:.0f} s, "
        f"{full['actual_kwh']:.1f} kWh"
    )
