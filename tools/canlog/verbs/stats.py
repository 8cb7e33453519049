"""`canlog stats`: statistics of every message and of the bus, as tables, JSON, CSV or JUnit."""

import argparse
import csv
import io
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final
from xml.sax.saxutils import quoteattr

from rich.console import Console
from rich.table import Table as TextTable

from canlog.reader import Stream, stream
from canlog.rules import Broken, FailRule, Judged, broken, parse_rule, untold
from canlog.stats import Statistics, gather
from canlog.stats_rows import (
    Row,
    absent,
    absent_count,
    absent_rows,
    bus_rows,
    message_rows,
    signal_rows,
    transport_rows,
    unjudged,
)
from canlog.verbs.common import add_log, bus_asked, count, read_options

FORMATS: Final = ("text", "json", "csv", "junit")
EXIT_OK: Final = 0
EXIT_BROKEN: Final = 1
TABLE: Final = (
    *("id", "message", "frames", "period_ms", "gap_ms_p50", "gap_ms_p99", "gap_ms_max"),
    *("jitter_ms", "missing", "extra", "stale", "lost", "rejected", "latency_ms"),
)
DETAILS: Final = (
    *("crc_errors", "counter_errors", "twin_errors", "invalid_values", "wrong_length"),
    *("short", "undefined", "out_of_range", "backwards"),
)
"""Numbers that are printed on their own line if they are not 0."""
TRANSPORT: Final = (
    *("channel", "id", "protocol", "pgn", "way", "messages", "incomplete", "parts", "bytes"),
    *("interval_ms_p50", "interval_ms_max", "message"),
)
WIDE: Final = 200
LEFT: Final = ("channel", "id", "protocol", "way", "message", "signal", "unit")
"""Columns of text, which are aligned to the left."""
BAD: Final = ("missing", "extra", "stale", "lost", "rejected", "incomplete")
"""Numbers that colour their row if they are not 0."""
NAMES_SHOWN: Final = 8


def options(parser: argparse.ArgumentParser) -> None:
    add_log(parser)
    parser.add_argument("--as", dest="form", choices=FORMATS, default="text")
    parser.add_argument(
        "--fail-on",
        action="append",
        default=[],
        metavar="RULE",
        help="exit with 1 if it is true or finds nothing to judge, as in 'missing > 0', "
        "'DOOR_*: crc_errors > 0', 'bus_load_ratio_max > 0.7' or 'damaged > 0'",
    )
    parser.add_argument(
        "--signals", action="store_true", help="show the ranges of all signals, too"
    )
    parser.add_argument("--baudrate", type=count, default=0, help="bits/s; default: the DBC file's")
    parser.add_argument(
        "--data-baudrate", type=count, default=0, help="bits/s of the fast part of CAN FD"
    )


def run(given: argparse.Namespace) -> int:
    rules = [parse_rule(text) for text in given.fail_on]
    source = stream(given.log, read_options(given))
    rates = {"baudrate": given.baudrate, "data_baudrate": given.data_baudrate}
    found = gather(source, bus_asked(given), **rates)
    damaged = sum(each.count for each in source.warnings)
    rows = message_rows(found), bus_rows(found)
    never, transport = absent_rows(found), transport_rows(found)
    judged = Judged(*rows, damaged, absent_count(found), never, transport)
    held = HeldRules(rules, broken(rules, judged), untold(rules, judged))
    _print(given, found, judged, source, held)
    return EXIT_BROKEN if held.breaches or held.untold else EXIT_OK


@dataclass(frozen=True, slots=True)
class HeldRules:
    """Rules, their breaches, and rules that had nothing to judge, which fail, too."""

    rules: Sequence[FailRule]
    breaches: Sequence[Broken]
    untold: Mapping[str, str]


def _print(
    given: argparse.Namespace,
    found: Statistics,
    judged: Judged,
    source: Stream,
    held: HeldRules,
) -> None:
    warnings = source.warnings
    if given.form == "json":
        told: dict[str, Any] = {"log": str(given.log), "buses": judged.buses}
        told |= {"messages": judged.messages, "signals": signal_rows(found)}
        told |= {"transport": judged.transport}
        told |= {"absent": absent(found), "not_judged": unjudged(found)}
        told["warnings"] = [str(each) for each in warnings]
        told["skipped"] = dict(source.skipped)
        told["broken"] = [str(each) for each in held.breaches]
        told["nothing_to_judge"] = dict(held.untold)
        print(json.dumps(told, indent=2))
    elif given.form == "csv":
        sys.stdout.write(csv_text(signal_rows(found) if given.signals else judged.messages))
    elif given.form == "junit":
        sys.stdout.write(junit_text(str(given.log), held))
    else:
        _print_text(found, judged, with_signals=given.signals)
        for line in (*(f"warning: {each}" for each in warnings), *map(str, held.breaches)):
            print(line)
        for kind, number in source.skipped.items():
            print(f"skipped: {number} x {kind}")
    for rule, why in held.untold.items():
        print(f"canlog: --fail-on {rule!r}: {why}, which is not a pass", file=sys.stderr)
    if given.form != "text":
        for each in warnings:
            print(f"canlog: warning: {each}", file=sys.stderr)


def csv_text(rows: Sequence[Row]) -> str:
    """Return rows with a head, in RFC 4180 format except for line ends."""
    out = io.StringIO()
    if rows:
        writer = csv.DictWriter(out, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    return out.getvalue()


def junit_text(log: str, held: HeldRules) -> str:
    """Return a test suite with a case for each rule, for CI servers."""
    failed = {each.rule for each in held.breaches} | set(held.untold)
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<testsuite name={quoteattr("canlog " + log)} tests="{len(held.rules)}"'
        f' failures="{len(failed)}">',
    ]
    for rule in held.rules:
        mine = [str(each) for each in held.breaches if each.rule == rule.text]
        lines.append(f"  <testcase classname={quoteattr(log)} name={quoteattr(rule.text)}>")
        if mine:
            lines.append(f"    <failure message={quoteattr('; '.join(mine))}/>")
        if rule.text in held.untold:
            lines.append(f"    <failure message={quoteattr(held.untold[rule.text])}/>")
        lines.append("  </testcase>")
    return "\n".join([*lines, "</testsuite>"]) + "\n"


def _print_text(found: Statistics, judged: Judged, *, with_signals: bool) -> None:
    messages, buses = judged.messages, judged.buses
    console = Console(highlight=False, width=None if sys.stdout.isatty() else WIDE)
    for bus in buses:
        console.print(
            f"{bus['channel']}: {bus['bus_frames']} frames in {bus['span_s']:.3f} s, load"
            f" {bus['bus_load_ratio']:.1%} (at most {bus['bus_load_ratio_max']:.1%} in 100 ms) at"
            f" {bus['baudrate']} bit/s, {bus['error_frames']} error, {bus['remote_frames']} remote,"
            f" {bus['unknown_frames']} unknown frames",
            markup=False,
        )
        _print_table(console, TABLE, [row for row in messages if row["channel"] == bus["channel"]])
    if judged.transport:
        console.print("reassembled messages:", markup=False)
        _print_table(console, TRANSPORT, [_transport_text(row) for row in judged.transport])
    if with_signals:
        columns = ("message", "signal", "unit", "frames", "least", "most", "out_of_range")
        _print_table(console, columns, signal_rows(found))
    shares = [
        (row["message"], name, row[name]) for row in messages for name in DETAILS if row[name]
    ]
    for message, name, number in shares:
        console.print(f"{message}: {name.replace('_', ' ')}: {number}", markup=False)
    for row in judged.transport:
        if row["incomplete"]:
            why = ", ".join(f"{name.replace('_', ' ')} {n}" for name, n in row["reasons"].items())
            console.print(f"{_sender(row)}: incomplete: {why}", markup=False)
    if names := absent(found):
        console.print(f"never seen: {_listed(names)}", markup=False)
    alike: dict[tuple[str, str], list[str]] = {}
    for row in unjudged(found):
        alike.setdefault((row["what"], row["why"]), []).append(row["message"])
    for (what, why), names in alike.items():
        console.print(f"not judged: {what} of {_listed(names)}: {why}", markup=False)


def _sender(row: Row) -> str:
    """Return the name of a sender's messages, or else the group or the identifier."""
    name = row["message"] or ("PGN " + str(row["pgn"]) if row["pgn"] is not None else row["id"])
    return f"{name} from {row['source']:02X}" if row["source"] is not None else str(name)


def _transport_text(row: Row) -> Row:
    """Return a row as people read it: addresses in hexadecimal, sizes as a range."""
    ways = ("" if row[end] is None else f"{row[end]:02X}" for end in ("source", "destination"))
    least, most = row["bytes_min"], row["bytes_max"]
    services = ", ".join(f"{name} {n}" for name, n in row["services"].items())
    return row | {
        "message": row["message"] or services,
        "way": "->".join(ways) if row["source"] is not None else "",
        "bytes": least if least == most else f"{least}-{most}",
    }


def _listed(names: Sequence[str]) -> str:
    shown = ", ".join(names[:NAMES_SHOWN])
    return f"{shown} and {len(names) - NAMES_SHOWN} more" if len(names) > NAMES_SHOWN else shown


def _print_table(console: Console, columns: Sequence[str], rows: Sequence[Row]) -> None:
    table = TextTable(box=None, header_style="bold", pad_edge=False)
    for name in columns:
        left = name in LEFT
        table.add_column(name, justify="left" if left else "right", no_wrap=True)
    for row in rows:
        bad = any(row.get(name) for name in BAD)
        table.add_row(*(_text(row[name]) for name in columns), style="yellow" if bad else None)
    console.print(table)


def _text(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.6g}" if isinstance(value, float) else str(value)
