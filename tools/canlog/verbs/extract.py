"""`canlog extract`: writes physical values of each message as Parquet, CSV, Arrow, npz or MF4."""

import argparse
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from canlog.bus_model import (
    CHANNEL_SIGN,
    ORIGIN_SIGN,
    Bus,
    LogPart,
    MessageSpec,
    part_names,
)
from canlog.damage import Damage, Damages
from canlog.exports import Export, SignalsMf4, TableFiles
from canlog.formats.mf4_write import in_order
from canlog.frames import Frames, empty
from canlog.reader import Log, Stream, read
from canlog.table import Groups, Table, exported, merged
from canlog.transport.tables import LongTables
from canlog.verbs.common import add_log, bus_asked, read_options
from firmware_py.storage.whole_file import whole_file

FORMS: Final = ("parquet", "csv", "npz", "arrow", "mf4")
WHOLE: Final = "npz"
"""The one format that needs all rows at once."""
BLOCK_FRAMES: Final = 1 << 16
"""Frames per block; decoded signals need several times the memory of their frames."""


def options(parser: argparse.ArgumentParser) -> None:
    add_log(parser)
    parser.add_argument("-o", dest="out", type=Path, required=True, metavar="DIR")
    parser.add_argument(
        "--as",
        dest="form",
        choices=FORMS,
        default="parquet",
        help="mf4 is one file, signals.mf4, with a group for each message; default: parquet",
    )
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
    source = Stream(given.log, replace(read_options(given), block_frames=BLOCK_FRAMES))
    unknown: dict[int, int] = {}
    # Only at the end is it known which messages are on several channels; the files get their names
    # then.
    with tempfile.TemporaryDirectory(dir=given.out, prefix=".canlog-") as folder:
        scratch = Path(folder)
        export = SignalsMf4(scratch) if given.form == "mf4" else TableFiles(scratch, given.form)
        for line in _export(source, export, bus, wanted, unknown, given.out):
            print(line)
    _report(bus, unknown, source.warnings)
    return 0


def _export(
    source: Stream,
    export: Export,
    bus: Bus,
    wanted: Sequence[str],
    unknown: dict[int, int],
    folder: Path,
) -> Iterator[str]:
    """Write all tables, and count by key the frames that no DBC file defines."""
    long, parts = LongTables(bus), dict[LogPart, None]()
    frames: Any = in_order(source, Damages()) if isinstance(export, SignalsMf4) else source
    for block in frames:
        for part, table in _tables(block, bus, long, unknown):
            if not wanted or set(part.texts) & set(wanted):
                parts[part] = None
                export.add(part, table)
    for name in wanted:
        if not any(name in part.texts for part in parts):
            part = LogPart(name, "")
            parts[part] = None
            export.add(part, Groups(empty()).table(_known(bus, name)))
    yield from export.close(part_names(parts), folder)
    for group, count in sorted(long.unknown.items()):
        print(f"canlog: {count} messages of PGN {group} are in no DBC file", file=sys.stderr)


def _tables(
    frames: Frames, bus: Bus, long: LongTables, unknown: dict[int, int]
) -> Iterator[tuple[LogPart, Table]]:
    """Yield the tables of one block: those of its frames, and of messages reassembled from them."""
    groups = Groups(frames)
    keys: dict[LogPart, tuple[MessageSpec, list[int]]] = {}
    for key, channel in groups.places:
        spec = bus.on(channel).spec_at(key)
        if spec is None and not long.carries(key):
            unknown[key] = unknown.get(key, 0) + groups.count(key, channel=channel)
        elif spec is not None:
            part = LogPart(spec.name, channel, spec.origin(key))
            keys.setdefault(part, (spec, []))[1].append(key)
    reassembled = long.feed(frames)
    for part, (spec, mine) in keys.items():
        table = groups.table(spec, part.channel, mine)
        yield part, merged([table, reassembled.pop(part)] if part in reassembled else [table])
    yield from reassembled.items()


def _known(bus: Bus, name: str) -> MessageSpec:
    """Return the message of a name. Raises LogError if no DBC file defines it."""
    channel, sign, rest = name.rpartition(CHANNEL_SIGN)
    plain = rest.partition(ORIGIN_SIGN)[0]
    if sign:
        return bus.on(channel).message(plain)
    for each in bus.by_channel.values():
        if plain in each.messages:
            return each.messages[plain]
    return bus.message(plain)


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
        table, part = log.fresh_table(name), log.part_of(name)
        path = given.out / f"{name.replace(CHANNEL_SIGN, '.')}.{WHOLE}"
        columns: dict[str, Any] = {"at_ns": table.at_ns}
        columns |= {column: np.array(value) for column, value in part.columns.items()}
        for signal in table.names:
            columns[signal] = exported(table[signal])
            columns[f"{signal}.valid"] = table.valid(signal)
        with whole_file(path) as file:
            np.savez_compressed(file, **columns)
        print(f"{path}: {len(table)} rows")
    _report(bus, {key: len(log.rows(key)) for key in log.unknown}, log.warnings)


def _names(log: Log, wanted: Sequence[str]) -> list[str]:
    """Return names of messages in the log; a message on several channels or from several sources
    has several.
    """
    if not wanted:
        return list(log.messages)
    found: list[str] = []
    for name in wanted:
        spread = [each for each in log.messages if log.asked_as(name, each)]
        found += spread or [name]
    return list(dict.fromkeys(found))
