"""`vobc line-log`: what trains and wayside said to each other: frame by frame, counted, drawn."""

import argparse
import os
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

from firmware_py.clock import WallClock
from firmware_py.radio.credentials import load_credentials
from firmware_py.radio.zenoh_radio import RadioError, Role, open_radio
from firmware_py.settings import SettingsError
from firmware_py.trackdb.areas import load_areas
from metro_hil.line_desk.log import (
    NS_PER_S,
    Choice,
    Entry,
    Figures,
    entry_of,
    figures_of,
    find_log,
    read_log,
    words_of,
)
from metro_hil.options import EXIT_ENVIRONMENT, EXIT_OK, EXIT_USAGE
from zenoh_config import t2t_keys
from zenoh_config.codec import BENCH_KEY, safety_key
from zenoh_config.secured import SUPERVISION_NAME
from zenoh_config.sessions import LINE_ENDPOINT
from zenoh_config.t2t import BROADCAST, SUPERVISION
from zenoh_config.t2t_keys import CHUNKS

POLL_NS: Final = 50_000_000
INBOX_MESSAGES: Final = 1 << 16
NAMES: Final = {"wayside": 0, "supervision": SUPERVISION, "all": BROADCAST}
EPILOG: Final = """\
Kinds are Heartbeat or hb, AreaAuthority or aa, and so on (docs/train_to_train.md), Place for the
axles in the emulated rails, Refused for what is damaged. Addresses are T3, 65001, wayside,
supervision, all. On the live bus any tool of zenoh reads the same: z_sub -e ENDPOINT -k 'm/loop/**'
exit codes: 0; 2 wrong usage or a log that is none; 3 nothing can be heard or written; 130 by Ctrl-C
"""


def main(words: Sequence[str]) -> int:
    options = _parser().parse_args(words)
    try:
        return _run(options)
    except (SettingsError, RadioError) as error:
        print(f"vobc: {error}", file=sys.stderr)
        return EXIT_USAGE
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_OK
    except KeyboardInterrupt:
        return 130


def _run(options: argparse.Namespace) -> int:
    if (options.log is None) is not options.live:
        raise SettingsError("line-log: a FOLDER or FILE is needed, or --live")
    key = BENCH_KEY
    if options.secure is not None:
        secure = load_credentials(options.secure, SUPERVISION_NAME, WallClock().epoch_ns())
        key = safety_key(secure.key_hex)
    choice = Choice(
        kinds=frozenset(options.kind),
        sources=frozenset(options.source),
        destinations=frozenset(options.to),
        areas=frozenset(options.area),
        since_s=options.since,
        until_s=options.until,
    )
    if options.live:
        return _show(_live(options, key), choice)
    path = find_log(options.log)
    if not options.stats and options.plot is None:
        return _show(read_log(path, key), choice)
    figures = figures_of(_chosen(read_log(path, key), choice))
    if options.stats:
        print("\n".join(stats_words(figures)))
    if options.plot is not None:
        from metro_hil.line_desk.log_plot import draw

        try:
            draw(figures, options.plot, path.parent.name or path.name)
        except (OSError, ValueError) as error:
            print(f"vobc: --plot {options.plot}: {error}", file=sys.stderr)
            return EXIT_ENVIRONMENT
        print(f"plot: {options.plot}")
    return EXIT_OK


def _chosen(entries: Iterator[Entry], choice: Choice) -> Iterator[Entry]:
    start_s = None
    for entry in entries:
        start_s = entry.at_s if start_s is None else start_s
        if choice.takes(entry, start_s):
            yield entry


def _show(entries: Iterator[Entry], choice: Choice) -> int:
    start_s = None
    for entry in entries:
        start_s = entry.at_s if start_s is None else start_s
        if choice.takes(entry, start_s):
            print(words_of(entry, start_s), flush=True)
    return EXIT_OK


def _live(options: argparse.Namespace, key: bytes) -> Iterator[Entry]:
    """Until Ctrl-C."""
    clock, secure = WallClock(), None
    if options.secure is not None:
        secure = load_credentials(options.secure, SUPERVISION_NAME, clock.epoch_ns())
    topics = t2t_keys.of_line(load_areas(options.line).name)
    with open_radio(
        *(Role.TRAIN, options.line_radio, topics, clock),
        inbox_messages=INBOX_MESSAGES,
        secure=secure,
    ) as port:
        while True:
            clock.wait_until(clock.now_ns() + POLL_NS)
            for message in port.receive(clock.now_ns()):
                yield entry_of(message.stamp_ns / NS_PER_S, message.key, message.payload, key)


def stats_words(figures: Figures) -> list[str]:
    """Who said how much, and how long trains waited."""
    said = [f"{'writer':>14} {'kind':<16} {'messages':>9} {'per s':>7} {'bytes':>6}"]
    span_s = max(figures.span_s, 1e-9)
    for (who, kind), count in sorted(figures.counts.items()):
        size = figures.sizes[who, kind] // count
        said.append(f"{who:>14} {kind:<16} {count:>9} {count / span_s:>7.1f} {size:>6}")
    said.append(f"refused: {figures.refused}")
    for number, train in sorted(figures.trains.items()):
        latencies_ms, ages_ms = sorted(train.latency_ms), sorted(train.age_ms)
        said.append(
            f"T{number}: {len(latencies_ms)} authorities, latency p50 {_at(latencies_ms, 0.5):.0f} "
            f"ms, p99 {_at(latencies_ms, 0.99):.0f} ms, greatest {latencies_ms[-1]:.0f} ms; "
            f"age when replaced p50 {_at(ages_ms, 0.5):.0f} ms, greatest {ages_ms[-1]:.0f} ms"
        )
    for area, changes in sorted(figures.terms.items()):
        terms = ", ".join([f"{at_s:.2f} s term {term} T{who}" for at_s, term, who in changes])
        said.append(f"area {area}: {terms}")
    return said


def _at(values: list[float], share: float) -> float:
    return values[min(len(values) - 1, int(len(values) * share))]


def _parser() -> argparse.ArgumentParser:
    top = argparse.ArgumentParser(
        prog="vobc line-log",
        description=__doc__,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    top.add_argument("log", nargs="?", type=Path, metavar="FOLDER|FILE", help="of a run")
    top.add_argument("--live", action="store_true", help="listen to the line instead")
    top.add_argument("--stats", action="store_true", help="counts, latencies, ages, terms")
    top.add_argument("--plot", type=Path, metavar="FILE", help="latency, age and terms, as .png")
    group = top.add_argument_group("what is looked at; each may be a list with commas")
    group.add_argument("--kind", type=_kinds, default=(), metavar="KIND")
    group.add_argument("--source", type=_addresses, default=(), metavar="WHO")
    group.add_argument("--to", type=_addresses, default=(), metavar="WHO")
    group.add_argument("--area", type=_numbers, default=(), metavar="N")
    group.add_argument("--since", type=float, default=float("-inf"), metavar="SECONDS")
    group.add_argument("--until", type=float, default=float("inf"), metavar="SECONDS")
    top.add_argument("--line", default="loop", metavar="NAME|FILE", help="with --live")
    top.add_argument("--line-radio", default=LINE_ENDPOINT, metavar="ENDPOINT")
    top.add_argument("--secure", metavar="FOLDER", help="of a secured line; see `vobc demo-ca`")
    return top


def _kinds(text: str) -> tuple[str, ...]:
    names = {kind.__name__ for kind in CHUNKS} | set(CHUNKS.values())
    names |= {"TrainStatus", "TrainOrders", "ts", "or", "Place", "x", "Refused"}
    for each in text.split(","):
        if each not in names:
            raise argparse.ArgumentTypeError(f"{each} is no kind of message")
    return tuple(text.split(","))


def _addresses(text: str) -> tuple[int, ...]:
    found = []
    for each in text.split(","):
        number = str(NAMES.get(each, each.removeprefix("T")))
        if not (number.isascii() and number.isdecimal()) or int(number) > BROADCAST:
            raise argparse.ArgumentTypeError(f"{each} is nobody; T3, wayside, supervision, 65001")
        found.append(int(number))
    return tuple(found)


def _numbers(text: str) -> tuple[int, ...]:
    if not all(each.isascii() and each.isdecimal() for each in text.split(",")):
        raise argparse.ArgumentTypeError(f"{text} is no list of numbers")
    return tuple([int(each) for each in text.split(",")])
