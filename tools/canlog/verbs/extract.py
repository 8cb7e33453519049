"""`canlog extract`: a table of physical values for each message, as Parquet, CSV or npz."""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from canlog.read import CHANNEL_SIGN, Log, read
from canlog.table import Table, exported
from canlog.verbs.common import add_log, bus_asked, read_options
from firmware_py.storage.whole_file import whole_file

SUMMARY: Final = "a table of physical values for each message, with exact time and units"
FORMS: Final = ("parquet", "csv", "npz", "arrow")


def options(parser: argparse.ArgumentParser) -> None:
    add_log(parser)
    parser.add_argument("-o", dest="out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--as", dest="form", choices=FORMS, default="parquet")
    parser.add_argument("--message", action="append", metavar="NAME", help="only this one")


def run(given: argparse.Namespace) -> int:
    log = read(given.log, bus_asked(given), replace(read_options(given), on_disk=True))
    names = _names(log, given.message)
    given.out.mkdir(parents=True, exist_ok=True)
    for name in names:
        # Not that of the log, which keeps what it has decoded.
        table = log.fresh_table(name)
        path = given.out / f"{name.replace(CHANNEL_SIGN, '.')}.{given.form}"
        with whole_file(path) as part:
            _write(table, log.channel_of(name), part, given.form)
        print(f"{path}: {len(table)} rows")
    _tell(log)
    return 0


def _tell(log: Log) -> None:
    for key in log.unknown:
        print(
            f"canlog: {len(log.rows(key))} frames {log.bus.name_of(key)} are in no DBC file",
            file=sys.stderr,
        )
    for each in log.warnings:
        print(f"canlog: warning: {each}", file=sys.stderr)


def _names(log: Log, wanted: Sequence[str] | None) -> list[str]:
    """Messages of the log; of a name that several channels have, that of each channel."""
    if not wanted:
        return list(log.messages)
    found: list[str] = []
    for name in wanted:
        spread = [each for each, spec in log.messages.items() if name in (each, spec.name)]
        found += spread or [name]
    return list(dict.fromkeys(found))


def _write(table: Table, channel: str, path: Path, form: str) -> None:
    if form == "npz":
        columns: dict[str, Any] = {"at_ns": table.at_ns, "channel": np.array(channel)}
        for name in table.names:
            columns[name] = exported(table[name])
            columns[f"{name}.valid"] = table.valid(name)
        np.savez_compressed(path, **columns)
        return
    import pyarrow as pa
    import pyarrow.csv
    import pyarrow.feather
    import pyarrow.parquet

    arrow = table.arrow(channel)
    if form == "csv":
        pa.csv.write_csv(arrow, path)
    elif form == "arrow":
        pa.feather.write_feather(arrow, str(path))
    else:
        pa.parquet.write_table(arrow, path)
