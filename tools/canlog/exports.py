"""Files that `canlog extract` writes block by block: one for each message, or one MF4 for all."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np

from canlog.bus_model import CHANNEL_SIGN, LogPart, SignalSpec
from canlog.damage import LogError
from canlog.plan import WORD_BITS
from canlog.table import Table, exported

ROWS_TOGETHER: Final = 1 << 14
"""Rows that are written at once."""
NS_PER_S: Final = 1_000_000_000
NS_PER_MS: Final = 1_000_000
MF4_NAME: Final = "signals.mf4"


class Export(Protocol):
    """Takes the tables of each block; rows of one message come in order of the log."""

    def add(self, part: LogPart, table: Table) -> None:
        """Add rows of a message."""

    def close(self, names: Mapping[LogPart, str], folder: Path) -> Iterator[str]:
        """Finish the files in `folder`; yield a line about each."""


@dataclass(slots=True)
class _Open:
    """The file of one message while it is written."""

    path: Path
    writer: Any = None
    waiting: list[Any] = field(default_factory=list)
    waiting_rows: int = 0
    rows: int = 0


class TableFiles:
    """A Parquet, CSV or Arrow file for each message."""

    def __init__(self, scratch: Path, form: str) -> None:
        """Write below `scratch` until it is known which messages several channels have."""
        self._scratch, self._form = scratch, form
        self._open: dict[LogPart, _Open] = {}

    def add(self, part: LogPart, table: Table) -> None:
        found = self._open.get(part)
        if found is None:
            found = self._open[part] = _Open(self._scratch / str(len(self._open)))
        found.waiting.append(table.arrow(part))
        found.waiting_rows += len(table)
        found.rows += len(table)
        if found.waiting_rows >= ROWS_TOGETHER:
            self._write(found)

    def _write(self, found: _Open) -> None:
        import pyarrow as pa

        table = pa.concat_tables(found.waiting).combine_chunks()
        found.waiting, found.waiting_rows = [], 0
        if found.writer is None:
            found.writer = _writer(found.path, self._form, table.schema)
        found.writer.write_table(table)

    def close(self, names: Mapping[LogPart, str], folder: Path) -> Iterator[str]:
        for part, found in self._open.items():
            if found.waiting or found.writer is None:
                self._write(found)
            found.writer.close()
            path = folder / f"{names[part].replace(CHANNEL_SIGN, '.')}.{self._form}"
            found.path.replace(path)
            yield f"{path}: {found.rows} rows"


def _writer(path: Path, form: str, schema: Any) -> Any:
    if form == "csv":
        import pyarrow.csv

        return pyarrow.csv.CSVWriter(str(path), schema)
    if form == "arrow":
        import pyarrow.ipc

        packed = pyarrow.ipc.IpcWriteOptions(compression="lz4")
        return pyarrow.ipc.new_file(str(path), schema, options=packed)
    import pyarrow.parquet

    return pyarrow.parquet.ParquetWriter(str(path), schema)


class SignalsMf4:
    """One MF4 file with a group for each message: raw values with their conversions and units."""

    def __init__(self, scratch: Path) -> None:
        """Raises LogError without asammdf."""
        try:
            from asammdf import MDF
        except ImportError:
            raise LogError("MF4 needs asammdf: pip install 'metro-vobc-bench[logs]'") from None
        self._path = scratch / MF4_NAME
        self._file = MDF(version="4.10")
        self._start_ns: int | None = None
        self._groups: dict[LogPart, int] = {}
        self._rows: dict[LogPart, int] = {}

    def add(self, part: LogPart, table: Table) -> None:
        self._rows[part] = self._rows.get(part, 0) + len(table)
        if self._start_ns is None:
            first_ns = int(table.at_ns[0]) if len(table) else 0
            # Whole milliseconds: asammdf stores the start time no finer.
            self._start_ns = first_ns - first_ns % NS_PER_MS
            self._file.header.abs_time = self._start_ns
        stamps_s = (table.at_ns - self._start_ns) / NS_PER_S
        columns = [(_samples(table, each), ~table.valid(each.name)) for each in table.spec.signals]
        if part in self._groups:
            self._file.extend(self._groups[part], [(stamps_s, None), *columns])
        else:
            self._groups[part] = self._begin(part, table, stamps_s, columns)

    def _begin(self, part: LogPart, table: Table, stamps_s: Any, columns: list[Any]) -> int:
        from asammdf import Signal

        signals = [
            Signal(
                samples=samples,
                timestamps=stamps_s,
                name=spec.name,
                unit=spec.unit,
                comment=spec.comment,
                conversion=_conversion(spec),
                invalidation_bits=absent,
            )
            for spec, (samples, absent) in zip(table.spec.signals, columns, strict=True)
        ]
        self._file.append(signals, acq_name=part.name, common_timebase=True)
        return len(self._file.groups) - 1

    def close(self, names: Mapping[LogPart, str], folder: Path) -> Iterator[str]:
        for part, index in self._groups.items():
            head: Any = self._file.groups[index].channel_group
            head.acq_name = names[part]
        self._file.save(str(self._path), overwrite=True, compression=1)
        self._file.close()
        path = folder / MF4_NAME
        self._path.replace(path)
        for part, rows in self._rows.items():
            yield f"{path}: {names[part]}: {rows} rows"


def _samples(table: Table, spec: SignalSpec) -> Any:
    """(n,) raw values in the smallest type that holds them; text for more than 64 bits."""
    if spec.length > WORD_BITS:
        return exported(table[spec.name]).astype(f"S{3 + spec.length // 4}")
    if spec.is_float:
        # Readers scale float32 in float32, which loses digits: scaled ones are stored as values.
        exact = spec.length < WORD_BITS and (spec.scale, spec.offset) == (1, 0)
        return table[spec.name].astype(np.float32 if exact else np.float64)
    size = next(each for each in (1, 2, 4, 8) if 8 * each >= spec.length)
    return table.raw(spec.name).astype(f"{'i' if spec.signed else 'u'}{size}")


def _conversion(spec: SignalSpec) -> dict[str, Any] | None:
    """Return how to scale raw values, or the names of a state."""
    if spec.is_float or spec.length > WORD_BITS:
        return None
    line = {"a": float(spec.scale), "b": float(spec.offset)}
    if not spec.is_state:
        return None if line == {"a": 1.0, "b": 0.0} else line
    # A value without a name gets no text. With its number as text, asammdf drops all names.
    texts: dict[str, Any] = {}
    for at, (raw, name) in enumerate(sorted(spec.choices.items())):
        texts |= {f"val_{at}": raw, f"text_{at}": name}
    return texts
