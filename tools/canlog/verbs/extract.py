"""`canlog extract`: writes a table of physical values for each message, as Parquet, CSV or npz."""

import argparse
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from canlog.bus_model import Bus, MessageSpec
from canlog.damage import Damage
from canlog.frames import Frames, empty
from canlog.read import CHANNEL_SIGN, Log, read, stream
from canlog.table import Groups, Table, exported
from canlog.verbs.common import add_log, bus_asked, read_options
from firmware_py.storage.whole_file import whole_file

SUMMARY: Final = "write a table of physical values for each message, with exact time and units"
FORMS: Final = ("parquet", "csv", "npz", "arrow")
WHOLE: Final = "npz"
"""The one format that needs all rows at once."""
ROWS_TOGETHER: Final = 1 << 14
"""Rows of one message that are written at once."""


def options(parser: argparse.ArgumentParser) -> None:
    add_log(parser)
    parser.add_argument("-o", dest="out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--as", dest="form", choices=FORMS, default="parquet")
    parser.add_argument("--message", action="append", metavar="NAME", help="only this one")


def run(given: argparse.Namespace) -> int:
    """Extract the tables. Raises LogError."""
    bus, wanted = bus_asked(given), tuple(given.message or ())
    for name in wanted:
        _known(bus, name)
    given.out.mkdir(parents=True, exist_ok=True)
    if given.form == WHOLE:
        _extract_whole(given, bus, wanted)
        return 0
    source = stream(given.log, read_options(given))
    unknown: dict[int, int] = {}
    # Only at the end is it known which messages are on several channels; the files get their names
    # then.
    with tempfile.TemporaryDirectory(dir=given.out, prefix=".canlog-") as scratch:
        tables = _Tables(Path(scratch), given.form, bus, wanted)
        for frames in source:
            tables.feed(frames, unknown)
        tables.close(given.out)
    _report(bus, unknown, source.warnings)
    return 0


def _known(bus: Bus, name: str) -> MessageSpec:
    """Return the message of a name. Raises LogError if no DBC file defines it."""
    channel, sign, plain = name.partition(CHANNEL_SIGN)
    if sign:
        return bus.on(channel).message(plain)
    for each in bus.by_channel.values():
        if name in each.messages:
            return each.messages[name]
    return bus.message(name)


@dataclass(slots=True)
class _Open:
    """The file of one message on one channel while it is written."""

    path: Path
    writer: Any = None
    waiting: list[Any] = field(default_factory=list)
    waiting_rows: int = 0
    rows: int = 0


class _Tables:
    """Writes the rows of each message block by block."""

    def __init__(self, scratch: Path, form: str, bus: Bus, wanted: Sequence[str]) -> None:
        self._scratch, self._form, self._bus, self._wanted = scratch, form, bus, wanted
        self._open: dict[tuple[str, str], _Open] = {}

    def feed(self, frames: Frames, unknown: dict[int, int]) -> None:
        """Add the next block, and count by key the frames that no DBC file defines."""
        groups = Groups(frames)
        keys: dict[tuple[str, str], tuple[MessageSpec, list[int]]] = {}
        for key, channel in groups.places:
            spec = self._bus.on(channel).spec_at(key)
            if spec is None:
                unknown[key] = unknown.get(key, 0) + groups.count(key, channel=channel)
            elif self._is_wanted(spec.name, channel):
                keys.setdefault((spec.name, channel), (spec, []))[1].append(key)
        for (name, channel), (spec, mine) in keys.items():
            self._add(name, channel, groups.table(spec, channel, mine))

    def _is_wanted(self, name: str, channel: str) -> bool:
        full = f"{channel}{CHANNEL_SIGN}{name}"
        return not self._wanted or name in self._wanted or full in self._wanted

    def _add(self, name: str, channel: str, table: Table) -> None:
        found = self._open.get((name, channel))
        if found is None:
            path = self._scratch / str(len(self._open))
            found = self._open[name, channel] = _Open(path)
        found.waiting.append(table.arrow(channel))
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

    def close(self, folder: Path) -> None:
        """Move the files to their names, and write empty files for requested messages without
        frames.
        """
        spread = [name for name, _ in self._open]
        for name in self._wanted:
            if not any(name in (each, f"{on}{CHANNEL_SIGN}{each}") for each, on in self._open):
                self._add(name, "", Groups(empty()).table(_known(self._bus, name)))
        for (name, channel), found in self._open.items():
            if found.waiting or found.writer is None:
                self._write(found)
            found.writer.close()
            full = f"{channel}.{name}" if spread.count(name) > 1 else name
            path = folder / f"{full.replace(CHANNEL_SIGN, '.')}.{self._form}"
            found.path.replace(path)
            print(f"{path}: {found.rows} rows")


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


def _report(bus: Bus, unknown: dict[int, int], warnings: Sequence[Damage]) -> None:
    for key, count in sorted(unknown.items()):
        print(
            f"canlog: {count} frames {bus.name_of(key)} are in no DBC file",
            file=sys.stderr,
        )
    for each in warnings:
        print(f"canlog: warning: {each}", file=sys.stderr)


def _extract_whole(given: argparse.Namespace, bus: Bus, wanted: Sequence[str]) -> None:
    log = read(given.log, bus, replace(read_options(given), on_disk=True))
    for name in _names(log, wanted):
        # Unlike the log's own table, a fresh one is not kept in memory.
        table, channel = log.fresh_table(name), log.channel_of(name)
        path = given.out / f"{name.replace(CHANNEL_SIGN, '.')}.{WHOLE}"
        columns: dict[str, Any] = {"at_ns": table.at_ns, "channel": np.array(channel)}
        for signal in table.names:
            columns[signal] = exported(table[signal])
            columns[f"{signal}.valid"] = table.valid(signal)
        with whole_file(path) as part:
            np.savez_compressed(part, **columns)
        print(f"{path}: {len(table)} rows")
    _report(bus, {key: len(log.rows(key)) for key in log.unknown}, log.warnings)


def _names(log: Log, wanted: Sequence[str]) -> list[str]:
    """Return names of messages in the log; a name on several channels gives one per channel."""
    if not wanted:
        return list(log.messages)
    found: list[str] = []
    for name in wanted:
        spread = [each for each, spec in log.messages.items() if name in (each, spec.name)]
        found += spread or [name]
    return list(dict.fromkeys(found))
