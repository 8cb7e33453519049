"""`canlog transport`: reassembles multi-frame messages and prints each as a row."""

import argparse
import csv
import io
import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, Final

from canlog.bus_model import Bus
from canlog.frames import KEY_EXTENDED
from canlog.lines import NS_PER_S, value_texts
from canlog.reader import stream
from canlog.select import parse_key
from canlog.table import table_of
from canlog.transport.messages import Messages, TransportKind, TransportStatus
from canlog.transport.names import FAULTS, fault_text, uds_text
from canlog.transport.reassembly import Reassembler, TransportOptions, options_for
from canlog.verbs.common import add_log, bus_asked, count, read_options

BYTES_SHOWN: Final = 24
ROWS_SHOWN: Final = 6
FORMS: Final = ("text", "csv", "json")

Row = dict[str, Any]


def options(parser: argparse.ArgumentParser) -> None:
    add_log(parser)
    parser.add_argument("--protocol", choices=("all", "j1939", "isotp"), default="all")
    parser.add_argument(
        "--id",
        action="append",
        default=[],
        metavar="HEX",
        help="an identifier that carries ISO-TP; default: 700 to 7FF and 18DAxxxx, 18DBxxxx",
    )
    parser.add_argument(
        "--extended-address", action="store_true", help="an address byte precedes the ISO-TP data"
    )
    parser.add_argument("--limit", type=count, metavar="N", help="print at most N rows")
    parser.add_argument("--as", dest="form", choices=FORMS, default="text")


def run(given: argparse.Namespace) -> int:
    """Print the messages. Raises LogError."""
    bus, source = bus_asked(given), stream(given.log, read_options(given))
    wanted = replace(
        options_for(bus),
        j1939=given.protocol != "isotp",
        isotp=given.protocol != "j1939",
        isotp_keys=tuple(parse_key(text) for text in given.id),
        address_bytes=int(given.extended_address),
    )
    rows = _rows(source, bus, wanted)
    if given.limit is not None:
        rows = (row for row, _ in zip(rows, range(given.limit), strict=False))
    _print(rows, given.form)
    for each in source.warnings:
        print(f"canlog: warning: {each}", file=sys.stderr)
    return 0


def _rows(source: Any, bus: Bus, wanted: TransportOptions) -> Iterator[Row]:
    """Yield the messages of each block in order of their last frames."""
    reassembler = Reassembler(wanted)
    start_ns: int | None = None
    for frames in source:
        if start_ns is None and len(frames):
            start_ns = int(frames.at_ns[0])
        yield from _of_parts(reassembler.feed(frames), start_ns or 0, bus)
    yield from _of_parts(reassembler.finish(), start_ns or 0, bus)


def _of_parts(parts: list[Messages], start_ns: int, bus: Bus) -> Iterator[Row]:
    found = [_row(part, at, start_ns, bus) for part in parts for at in range(len(part))]
    yield from sorted(found, key=lambda row: int(row["frames"][-1]))


def _row(part: Messages, at: int, start_ns: int, bus: Bus) -> Row:
    key, group = int(part.key[at]), int(part.group[at])
    status, data = TransportStatus(int(part.status[at])), part.payload(at)
    channel = part.channels[int(part.channel[at])]
    told: Row = {
        "at_s": (int(part.at_ns[at]) - start_ns) / NS_PER_S,
        "channel": channel,
        "id": f"{key & ~KEY_EXTENDED:08X}" if key & KEY_EXTENDED else f"{key:03X}",
        "kind": TransportKind(int(part.kind[at])).name.lower(),
        "pgn": None if group < 0 else group,
        "source": key & 0xFF if key & KEY_EXTENDED else None,
        "destination": key >> 8 & 0xFF if key & KEY_EXTENDED else None,
        "status": status.name.lower(),
        "length": len(data),
        "data": data.hex().upper(),
        "frames": [row + 1 for row in part.frames(at)],
    }
    if status != TransportStatus.WHOLE:
        told["text"] = ""
    elif group < 0:
        told["text"] = uds_text(data)
    else:
        told["text"] = group_text(bus.on(channel), group, data)
    return told


def group_text(bus: Bus, group: int, data: bytes) -> str:
    """Describe a J1939 message: its fault codes, or its signals in a DBC file."""
    if group in FAULTS:
        return f"{FAULTS[group]} {fault_text(data)}"
    spec = bus.by_group.get(group)
    if spec is None:
        return ""
    table = table_of(spec, [data])
    texts = [f"{each.name} {value_texts(table, each)[0]}" for each in spec.signals
             if table.valid(each.name)[0]]  # fmt: skip
    return f"{spec.name} {', '.join(texts)}"


def _print(rows: Iterator[Row], form: str) -> None:
    if form == "json":
        print(json.dumps(list(rows), indent=1))
    elif form == "csv":
        out = io.StringIO()
        writer: Any = None
        for row in rows:
            if writer is None:
                writer = csv.DictWriter(out, list(row), lineterminator="\n")
                writer.writeheader()
            writer.writerow(row | {"frames": " ".join(str(each) for each in row["frames"])})
        sys.stdout.write(out.getvalue())
    else:
        for row in rows:
            print(_line(row))


def _line(row: Row) -> str:
    way = f"PGN {row['pgn']} " if row["pgn"] is not None else ""
    if row["source"] is not None:
        way += f"{row['source']:02X}->{row['destination']:02X} "
    numbers = row["frames"]
    shown = ", ".join(str(each) for each in numbers[:ROWS_SHOWN])
    frames = f"frames {shown}{', ...' if len(numbers) > ROWS_SHOWN else ''}"
    head = f"{row['at_s']:15.9f}  {row['channel']}  {row['id']:>8}  {way}{row['kind']}"
    if row["status"] != "whole":
        return f"{head}  INCOMPLETE {row['status'].replace('_', ' ')}  ({frames})"
    data = row["data"] if row["length"] <= BYTES_SHOWN else f"{row['data'][: 2 * BYTES_SHOWN]}..."
    text = f"  {row['text']}" if row["text"] else ""
    return f"{head}  [{row['length']}] {data}{text}  ({frames})"
