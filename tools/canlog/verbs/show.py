"""`canlog show`: prints a log or a live bus frame by frame, with control cycles and verdicts."""

import argparse
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canlog.damage import LogError
from canlog.database import Bus
from canlog.frames import ERROR, EXTENDED, REMOTE, Frames
from canlog.lines import LineStyle, Writer
from canlog.reader import read, stream
from canlog.rows import from_rows
from canlog.run import RunFiles
from canlog.select import (
    NS_PER_S,
    RECEIVED,
    SENT,
    Selection,
    Selector,
    around,
    parse_data,
    parse_keys,
)
from canlog.table import Groups
from canlog.verbs.common import LOG_HELP, add_reading, bus_asked, count, read_options, seconds
from canlog.verdict_codes import JUDGED_BUS
from firmware_py.clock.clock import WallClock

if TYPE_CHECKING:
    from canlog.verdict import Judge
    from canlog.where import Where
    from firmware_py.ports import CanFrame

POLL_NS: Final = 20_000_000
NAME_WIDTH_MAX: Final = 24


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("log", type=Path, nargs="?", metavar="LOG", help=LOG_HELP)
    add_reading(parser)
    parser.add_argument("--follow", metavar="BUS", help="a live bus, such as socketcan:vcan0")
    choose = parser.add_argument_group("which frames")
    choose.add_argument("--message", action="append", default=[], metavar="PATTERN")
    choose.add_argument(
        "--id",
        action="append",
        default=[],
        metavar="HEX",
        help="an identifier, a range as 100-1FF, or value and mask as 100/7F0",
    )
    choose.add_argument("--direction", choices=(RECEIVED, SENT), default="")
    choose.add_argument(
        "--data", metavar="HEX", help="first data bytes, points for any digit, as 0A..FF"
    )
    choose.add_argument("--node", action="append", default=[], metavar="SENDER")
    choose.add_argument("--where", metavar="CONDITION", help="such as 'speed_mps > 10'")
    choose.add_argument("--from", dest="from_s", type=seconds, help="seconds since the start")
    choose.add_argument("--to", dest="to_s", type=seconds)
    choose.add_argument("--around", metavar="EVENT", help="part of an event's kind or text")
    choose.add_argument("--within", type=seconds, default=1.0, metavar="S", help="of --around")
    choose.add_argument("--rate", type=float, metavar="HZ", help="at most, of each message")
    choose.add_argument(
        "--rejected", action="store_true", help="only frames that the codec rejects"
    )
    choose.add_argument("--changed", action="store_true", help="only frames whose data changed")
    choose.add_argument("--limit", type=count, metavar="N", help="print at most N lines")
    look = parser.add_argument_group("how they look")
    look.add_argument("--absolute", action="store_true", help="date and time in UTC")
    look.add_argument("--raw", action="store_true", help="data in hexadecimal, too")
    look.add_argument("--bits", action="store_true", help="bit by bit, changes marked")
    look.add_argument("--trailer", action="store_true", help="alive counters and CRCs, too")
    look.add_argument("--color", choices=("auto", "always", "never"), default="auto")
    look.add_argument("--no-pager", action="store_true")


def run(given: argparse.Namespace) -> int:
    if given.log is not None and given.follow is not None:
        raise LogError(f"{given.log} and --follow {given.follow} exclude each other")
    bus = bus_asked(given)
    lines = _followed(given, bus) if given.follow else _logged(given, bus)
    if given.limit is not None:
        lines = islice(lines, given.limit)
    if given.follow or given.no_pager or not sys.stdout.isatty():
        for line in lines:
            print(line, flush=bool(given.follow))
    else:
        _page(lines)
    return 0


def _style(given: argparse.Namespace, bus: Bus, start_ns: int) -> LineStyle:
    auto = sys.stdout.isatty() and "NO_COLOR" not in os.environ
    longest = max((len(name) for name in bus.messages), default=0)
    return LineStyle(
        colour=given.color == "always" or (given.color == "auto" and auto),
        absolute=given.absolute,
        raw=given.raw,
        bits=given.bits,
        trailer=given.trailer,
        start_ns=start_ns,
        name_width=min(longest, NAME_WIDTH_MAX),
    )


def _wanted(given: argparse.Namespace, bus: Bus, start_ns: int, run_: RunFiles | None) -> Selection:
    spans: tuple[tuple[int, int], ...] | None = None
    if given.within < 0.0:
        raise LogError(f"--within {given.within:g}: is not negative")
    if given.from_s is not None or given.to_s is not None:
        if None not in (given.from_s, given.to_s) and given.to_s < given.from_s:
            raise LogError(f"--from {given.from_s:g} --to {given.to_s:g}: nothing lies between")
        first_s = given.from_s if given.from_s is not None else -1e9
        last_s = given.to_s if given.to_s is not None else 1e9
        spans = ((start_ns + round(first_s * NS_PER_S), start_ns + round(last_s * NS_PER_S)),)
    if given.around is not None:
        if spans is not None:
            raise LogError("--around takes --within, not --from and --to")
        spans = around(_instants_ns(given, run_), given.within)
    if given.rate is not None and not given.rate > 0.0:
        raise LogError(f"--rate {given.rate}: has to be positive")
    return Selection(
        names=tuple(given.message),
        keys=tuple(parse_keys(text) for text in given.id),
        nodes=tuple(given.node),
        where=_where(given.where, bus),
        spans_ns=spans,
        rate_hz=given.rate,
        rejected=given.rejected,
        direction=given.direction,
        data=parse_data(given.data) if given.data is not None else None,
        changed=given.changed,
    )


def _where(text: str | None, bus: Bus) -> "Where | None":
    if not text:
        return None
    from canlog.where import Where

    return Where(text, bus)


def _judge_of(bus: Bus) -> "Judge | None":
    """Return this project's codec for its own bus; other logs are shown without loading it."""
    if bus.name != JUDGED_BUS:
        return None
    from canlog.verdict import Judge

    return Judge()


def _instants_ns(given: argparse.Namespace, run_: RunFiles | None) -> list[int]:
    if run_ is None:
        raise LogError(f"--around: {given.log} is no run folder, so it has no events")
    pattern = re.compile(re.escape(given.around).replace("_", "[ _]"), re.IGNORECASE)
    found = [
        event.at_ns
        for event in run_.events
        if pattern.search(event.kind) or pattern.search(event.words)
    ]
    if not found:
        kinds = ", ".join(sorted({event.kind for event in run_.events})) or "no events"
        raise LogError(f"--around {given.around}: no such event; the run has {kinds}")
    return found


def _logged(given: argparse.Namespace, bus: Bus) -> Iterator[str]:
    """Yield the lines of a log. A run folder is read whole, any other log block by block."""
    judge = _judge_of(bus)
    if given.log.is_dir():
        log = read(given.log, bus, read_options(given))
        run_, start_ns = log.run, log.run.start_ns if log.run else log.start_ns
        blocks, source = iter([log.frames]), None
    else:
        source = stream(given.log, read_options(given))
        log, run_, blocks = None, None, iter(source)
        first = next(blocks, None)
        start_ns = int(first.at_ns[0]) if first is not None and len(first) else 0
        blocks = chain([] if first is None else [first], blocks)
    selector = Selector(_wanted(given, bus, start_ns, run_), bus)
    writer = Writer(bus, _style(given, bus, start_ns))
    for frames in blocks:
        groups = Groups(frames)
        code = judge.feed(frames, groups) if judge else None
        rows = selector.rows(frames, groups, code)
        cycle, sent = (run_.cycle_of, run_.sent) if run_ else (None, None)
        yield from writer.lines(frames, rows, code, cycle, sent)
    for each in log.warnings if log is not None else source.warnings if source else ():
        print(f"canlog: warning: {each}", file=sys.stderr)


def _followed(given: argparse.Namespace, bus: Bus) -> Iterator[str]:
    """Yield the lines of a live bus until the user interrupts."""
    from firmware_py.buses import BusError, open_can

    clock = WallClock()
    try:
        port = open_can(given.follow, clock=clock, node="canlog")
    except BusError as error:
        raise LogError(str(error)) from error
    start_ns = clock.epoch_ns()
    judge = _judge_of(bus)
    selector = Selector(_wanted(given, bus, start_ns, None), bus)
    writer = Writer(bus, _style(given, bus, start_ns))
    try:
        while True:
            received = port.receive(clock.now_ns())
            if received:
                frames = _block(received, given.follow, clock.epoch_offset_ns)
                groups = Groups(frames)
                code = judge.feed(frames, groups) if judge else None
                yield from writer.lines(frames, selector.rows(frames, groups, code), code)
            clock.wait_until(clock.now_ns() + POLL_NS)
    finally:
        port.close()


def _block(received: "Sequence[CanFrame]", bus: str, offset_ns: int) -> Frames:
    channel = bus.partition(":")[2]
    rows = [
        (
            frame.stamp_ns + offset_ns,
            frame.can_id,
            EXTENDED * frame.extended | REMOTE * frame.remote | ERROR * frame.error,
            channel,
            frame.data,
        )
        for frame in received
    ]
    return from_rows(rows)


def _page(lines: Iterator[str]) -> None:
    """Print the lines through $PAGER, or else less."""
    words = os.environ.get("PAGER", "less -RFX").split()
    if not words or shutil.which(words[0]) is None:
        for line in lines:
            print(line)
        return
    with subprocess.Popen(words, stdin=subprocess.PIPE, text=True) as pager:  # noqa: S603
        assert pager.stdin is not None
        try:
            for line in lines:
                pager.stdin.write(line + "\n")
        except BrokenPipeError:
            return
