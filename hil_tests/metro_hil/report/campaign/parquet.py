"""All measures as one Parquet table: a row for each case, units in the columns' metadata."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from canlog.arrow_columns import arrow_column
from metro_hil.model.case import expected_text
from metro_hil.report.campaign.info import CampaignInfo
from metro_hil.report.campaign.ledger import (
    Ledger,
    LedgerEntry,
    exercised,
    factor_text,
    known_margin,
)
from metro_hil.report.campaign.units import unit_of

if TYPE_CHECKING:
    import pyarrow as pa

WRITTEN_BY: Final = "metro_hil"
Column = tuple[str, str, str, list[Any]]
"""Name, kind (`text`, `number`, `whole`, `flag`), unit, values."""
BLANKS: Final = {
    "text": ("", np.object_),
    "number": (0.0, np.float64),
    "whole": (0, np.int64),
    "flag": (False, np.bool_),
}
"""What stands in a column where a value is missing, and the numpy type of the column, by kind."""
FIXED: Final[tuple[tuple[str, str, str, Callable[[LedgerEntry], Any]], ...]] = (
    ("case_id", "text", "", lambda e: e.case.id),
    ("index", "whole", "", lambda e: e.case.index),
    ("scenario", "text", "", lambda e: e.case.scenario),
    ("seed", "whole", "", lambda e: e.case.seed),
    ("verdict", "text", "", lambda e: e.word),
    ("expected", "text", "", lambda e: expected_text(e.case)),
    ("as_expected", "flag", "", lambda e: e.as_expected),
    ("reason", "text", "", lambda e: e.reason),
    ("exit_reason", "text", "", lambda e: e.result.exit_reason if e.result else None),
    ("sim_s", "number", "s", lambda e: e.result.sim_s if e.result else None),
    ("frames", "whole", "", lambda e: e.result.frames if e.result else None),
    ("chain", "text", "", lambda e: e.result.chain if e.result else None),
)


def write_parquet(path: Path, info: CampaignInfo, ledger: Ledger) -> None:
    """Write the table; equal campaigns give equal bytes, because it holds no host and no date."""
    import pyarrow.parquet as pq

    pq.write_table(
        measures_table(info, ledger),
        path,
        compression="zstd",
        use_dictionary=True,
        store_schema=True,
    )


def measures_table(info: CampaignInfo, ledger: Ledger) -> "pa.Table":
    """Columns: fixed ones, then `factor.*`, `monitor.*.margin|at_s|verdict`, `measure.*`."""
    import pyarrow as pa

    columns = [*_fixed(ledger), *_factors(ledger), *_monitors(ledger), *_measures(ledger)]
    fields, arrays = [], []
    for name, kind, unit, values in columns:
        array = column_of(kind, values)
        fields.append(pa.field(name, array.type, metadata={"unit": unit} if unit else None))
        arrays.append(array)
    about = {
        "campaign": info.name,
        "fingerprint": info.fingerprint,
        "written_by": WRITTEN_BY,
        "expected_cases": str(ledger.expected_cases),
        "subset": info.subset,
    }
    return pa.Table.from_arrays(arrays, schema=pa.schema(fields, metadata=about))


def column_of(kind: str, values: Sequence[Any]) -> "pa.Array":
    """Return the values of one kind as a column; None leaves a gap."""
    blank, numpy_kind = BLANKS[kind]
    filled: Any = np.array([blank if value is None else value for value in values], numpy_kind)
    return arrow_column(filled, np.array([value is not None for value in values], np.bool_))


def _fixed(ledger: Ledger) -> list[Column]:
    return [(n, kind, unit, [get(e) for e in ledger.entries]) for n, kind, unit, get in FIXED]


def _factors(ledger: Ledger) -> list[Column]:
    names = sorted({name for entry in ledger.entries for name in entry.case.factors})
    columns: list[Column] = []
    for name in names:
        values = [entry.case.factors.get(name) for entry in ledger.entries]
        kind = _kind(values)
        if kind == "text":
            values = [v if v is None or isinstance(v, str) else _json(v) for v in values]
        elif kind == "number":
            values = [None if v is None else float(v) for v in values]
        columns.append((f"factor.{name}", kind, unit_of(name), values))
    return columns


def _kind(values: Sequence[Any]) -> str:
    known = [value for value in values if value is not None]
    if known and all(isinstance(value, bool) for value in known):
        return "flag"
    if any(isinstance(value, bool) for value in known):
        return "text"
    if known and all(isinstance(value, int) for value in known):
        return "whole"
    if known and all(isinstance(value, int | float) for value in known):
        return "number"
    return "text"


def _json(value: Any) -> str:
    if isinstance(value, int | float):
        return factor_text(value)
    return json.dumps(value, sort_keys=True, default=str)


def _monitors(ledger: Ledger) -> list[Column]:
    keys = sorted({(m.name, m.unit) for entry in ledger.entries for m in entry.monitors()})
    names = [name for name, _ in keys]
    columns: list[Column] = []
    for name, unit in keys:
        said = [
            next((m for m in entry.monitors() if (m.name, m.unit) == (name, unit)), None)
            for entry in ledger.entries
        ]
        # A name with two units stands for two monitors.
        stem = f"monitor.{name}" if names.count(name) == 1 else f"monitor.{name} [{unit}]"
        verdicts = [None if m is None else m.verdict.value for m in said]
        columns += [
            (f"{stem}.verdict", "text", "", verdicts),
            (f"{stem}.margin", "number", unit, [m and known_margin(m) for m in said]),
            (f"{stem}.at_s", "number", "s", [m and m.at_s for m in said]),
            (f"{stem}.exercised", "flag", "", [None if m is None else exercised(m) for m in said]),
        ]
    return columns


def _measures(ledger: Ledger) -> list[Column]:
    names = sorted({name for entry in ledger.entries for name in entry.measures()})
    return [
        (
            f"measure.{n}",
            "number",
            unit_of(n),
            [entry.measures().get(n) for entry in ledger.entries],
        )
        for n in names
    ]
