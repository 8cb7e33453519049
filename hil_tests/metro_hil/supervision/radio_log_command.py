"""`vobc line-log`: the messages of a line's radio, one by one, counted, or as a plot."""

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

from canlog.damage import LogError
from canlog.run_names import choose_run
from firmware_py.clock.clock import WallClock
from firmware_py.command_line import CommandParser
from firmware_py.interrupts import Interrupts
from firmware_py.radio.credentials import load_credentials
from firmware_py.radio.line_keys import line_keys
from firmware_py.radio.zenoh_radio import RadioError
from firmware_py.settings import SettingsError
from metro_hil.model.line_options import add_insecure
from metro_hil.model.run_options import EXIT_ENVIRONMENT, EXIT_INTERRUPTED, EXIT_OK, EXIT_USAGE
from metro_hil.supervision.access import refuse_insecure
from metro_hil.supervision.radio_log import (
    Chosen,
    RadioFigures,
    RadioLogFilter,
    figures_of,
    find_log,
    read_log,
    words_of,
)
from metro_hil.supervision.radio_log_filter import RadioLogSelection
from metro_hil.supervision.radio_log_live import LiveLine
from zenoh_config.codec import SafetyKey
from zenoh_config.secured import SUPERVISION_NAME
from zenoh_config.sessions import LINE_ENDPOINT
from zenoh_config.t2t import BROADCAST, SUPERVISION
from zenoh_config.t2t_keys import CHUNKS

NAMES: Final = {"wayside": 0, "supervision": SUPERVISION, "all": BROADCAST}
EPILOG: Final = """\
Kinds are Heartbeat or hb, AreaAuthority or aa, and so on (docs/design/train_to_train.md). Place is
for axles on the emulated rails, Refused for damaged messages. Addresses are T3, 65001, wayside,
supervision, all. Any zenoh tool receives the same live: z_sub -e ENDPOINT -k 'm/loop/**'
With --live, --stats and --plot cover the messages received until Ctrl-C or the end of --for.
exit codes: 0 done; 2 wrong usage or not a log; 3 no session, or a file cannot be written;
130 Ctrl-C without --stats and --plot
"""


def main(words: Sequence[str]) -> int:
    options = parser().parse_args(words)
    try:
        return _run(options)
    except (LogError, SettingsError, RadioError) as error:
        print(f"vobc: {error}", file=sys.stderr)
        return EXIT_USAGE


def _run(options: argparse.Namespace) -> int:
    _check_options(options)
    if options.live:
        refuse_insecure(options)
    secure = None
    if options.secure is not None:
        secure = load_credentials(options.secure, SUPERVISION_NAME, WallClock().epoch_ns())
    key = line_keys(secure)
    sieve = RadioLogSelection(_choice(options))
    if not options.live:
        path = find_log(choose_run(options.log, "vobc"))
        title = path.parent.name or path.name
        code = _report(options, sieve.pass_on(read_log(path, key)), title)
        _print_warnings(sieve, str(path), options)
        return code
    return _listen(options, sieve, key)


def _listen(options: argparse.Namespace, sieve: RadioLogSelection, key: SafetyKey) -> int:
    """Report until Ctrl-C or the end of --for, with figures of what was received by then."""
    interrupts = Interrupts()
    live = LiveLine(options.line, options.line_radio, options.secure, key)
    duration_s = float("inf") if options.duration_s is None else options.duration_s
    with interrupts.caught():
        entries = live.entries(duration_s, lambda: interrupts.asked)
        code = _report(options, sieve.pass_on(entries), options.line_radio)
    if not live.reached:
        print(f"vobc: {options.line_radio}: no session came up", file=sys.stderr)
        code = EXIT_ENVIRONMENT
    else:
        _print_warnings(sieve, options.line_radio, options)
    gathers = options.stats or options.plot is not None
    return EXIT_INTERRUPTED if interrupts.asked and not gathers else code


def _print_warnings(sieve: RadioLogSelection, where: str, options: argparse.Namespace) -> None:
    for words in sieve.doubts(secured=options.secure is not None):
        print(f"vobc: {where}: {words}", file=sys.stderr)


def _check_options(options: argparse.Namespace) -> None:
    """Raise SettingsError for options that contradict each other."""
    since_s, until_s, live = options.since, options.until, options.live
    for refused, words in (
        (options.log is not None and live, f"{options.log} and --live exclude each other"),
        (options.duration_s is not None and not live, "--for needs --live"),
        (not since_s < until_s, f"--since {since_s:g} is not before --until {until_s:g}"),
    ):
        if refused:
            raise SettingsError(f"line-log: {words}")


def _choice(options: argparse.Namespace) -> RadioLogFilter:
    return RadioLogFilter(
        kinds=frozenset(options.kind),
        sources=frozenset(options.source),
        destinations=frozenset(options.to),
        areas=frozenset(options.area),
        since_s=options.since,
        until_s=options.until,
    )


def _report(options: argparse.Namespace, chosen: Iterator[Chosen], title: str) -> int:
    """Print message by message, or figures and a plot."""
    if not options.stats and options.plot is None:
        for entry, start_s in chosen:
            print(words_of(entry, start_s), flush=True)
        return EXIT_OK
    figures = figures_of(chosen)
    if options.stats:
        print("\n".join(stats_words(figures)))
    return EXIT_OK if options.plot is None else _draw(figures, options.plot, title)


def _draw(figures: RadioFigures, path: Path, title: str) -> int:
    from metro_hil.supervision.radio_log_plot import draw

    try:
        draw(figures, path, title)
    except (OSError, ValueError) as error:
        print(f"vobc: --plot {path}: {error}", file=sys.stderr)
        return EXIT_ENVIRONMENT
    print(f"plot: {path}")
    return EXIT_OK


def stats_words(figures: RadioFigures) -> list[str]:
    """Return message counts by sender, and how long trains waited, as text."""
    said = [f"{'writer':>14} {'kind':<16} {'messages':>9} {'per s':>7} {'bytes':>6}"]
    span_s = max(figures.end_s - figures.start_s, 1e-9)
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


def parser() -> argparse.ArgumentParser:
    """The command line of `vobc line-log`."""
    top = CommandParser(
        prog="vobc line-log",
        description=__doc__,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    top.add_argument(
        "log",
        nargs="?",
        type=Path,
        metavar="RUN|FILE",
        help="folder of a run or part of its name, or a log; default: the last run",
    )
    top.add_argument(
        "--live", action="store_true", help="listen to the line instead, until Ctrl-C or --for"
    )
    top.add_argument("--stats", action="store_true", help="counts, latencies, ages, terms")
    top.add_argument("--plot", type=Path, metavar="FILE", help="latency, age and terms, as .png")
    group = top.add_argument_group("selection; each may be a list with commas")
    group.add_argument("--kind", type=_kinds, default=(), metavar="KIND")
    group.add_argument("--source", type=_addresses, default=(), metavar="WHO")
    group.add_argument("--to", type=_addresses, default=(), metavar="WHO")
    group.add_argument("--area", type=_numbers, default=(), metavar="N")
    group.add_argument("--since", type=float, default=float("-inf"), metavar="SECONDS")
    group.add_argument("--until", type=float, default=float("inf"), metavar="SECONDS")
    top.add_argument(
        "--for", type=_seconds, dest="duration_s", metavar="SECONDS", help="with --live"
    )
    top.add_argument("--line", default="loop", metavar="NAME|FILE", help="with --live")
    top.add_argument("--line-radio", default=LINE_ENDPOINT, metavar="ENDPOINT")
    top.add_argument(
        "--secure",
        type=Path,
        metavar="FOLDER",
        help="certificates of a secured line; see `vobc demo-ca`",
    )
    add_insecure(top)
    return top


def _seconds(text: str) -> float:
    try:
        duration_s = float(text)
    except ValueError:
        duration_s = 0.0
    if not duration_s > 0.0:
        raise argparse.ArgumentTypeError(f"{text} is not a duration")
    return duration_s


def _kinds(text: str) -> tuple[str, ...]:
    names = {kind.__name__ for kind in CHUNKS} | set(CHUNKS.values())
    names |= {"TrainStatus", "TrainOrders", "ts", "or", "Place", "x", "Refused"}
    for each in text.split(","):
        if each not in names:
            raise argparse.ArgumentTypeError(f"{each} is not a kind of message")
    return tuple(text.split(","))


def _addresses(text: str) -> tuple[int, ...]:
    found = []
    for each in text.split(","):
        number = str(NAMES.get(each, each.removeprefix("T")))
        if not (number.isascii() and number.isdecimal()) or int(number) > BROADCAST:
            raise argparse.ArgumentTypeError(
                f"{each} is not an address such as T3, wayside, supervision, 65001"
            )
        found.append(int(number))
    return tuple(found)


def _numbers(text: str) -> tuple[int, ...]:
    if not all(each.isascii() and each.isdecimal() for each in text.split(",")):
        raise argparse.ArgumentTypeError(f"{text} is not a list of numbers")
    return tuple([int(each) for each in text.split(",")])
