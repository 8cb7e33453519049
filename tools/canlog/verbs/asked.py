"""Options of the subcommands that draw: a log, a time span, an output file."""

import argparse
from dataclasses import replace
from pathlib import Path

from canlog.damage import LogError
from canlog.reader import Log, read
from canlog.run import NS_PER_S
from canlog.verbs.common import add_log, bus_asked, read_options, seconds
from canlog.views.span import TimeSpan, zero_of


def log_options(parser: argparse.ArgumentParser, *, span: bool = True) -> None:
    add_log(parser)
    if span:
        parser.add_argument(
            "--from", dest="from_s", type=seconds, metavar="S", help="seconds since the log began"
        )
        parser.add_argument("--to", dest="to_s", type=seconds, metavar="S")


def read_asked(given: argparse.Namespace, *, on_disk: bool = False) -> Log:
    return read(given.log, bus_asked(given), replace(read_options(given), on_disk=on_disk))


def name_asked(given: argparse.Namespace) -> str:
    """Return the title for a picture of the log."""
    path: Path = given.log
    return path.name or str(path.resolve())


def span_asked(log: Log, given: argparse.Namespace) -> TimeSpan:
    """Return the requested span. Raises LogError if it is empty or outside of the log."""
    zero_ns = zero_of(log)
    start_ns, end_ns = log.start_ns, log.end_ns
    if given.from_s is not None:
        start_ns = max(start_ns, zero_ns + round(given.from_s * NS_PER_S))
    if given.to_s is not None:
        end_ns = min(end_ns, zero_ns + round(given.to_s * NS_PER_S))
    if end_ns < start_ns:
        there = f"{(log.start_ns - zero_ns) / NS_PER_S:g} to {(log.end_ns - zero_ns) / NS_PER_S:g}"
        raise LogError(f"--from, --to: nothing between them; {log.path} goes from {there} s")
    return TimeSpan(zero_ns, start_ns, end_ns)


def output_path(text: str, suffixes: tuple[str, ...]) -> Path:
    """Check an output path. Raises LogError for another suffix or a folder that does not exist."""
    path = Path(text)
    if path.suffix.lower() not in suffixes:
        raise LogError(f"-o {path}: must end in {' or '.join(suffixes)}")
    if not path.parent.is_dir():
        raise LogError(f"-o {path}: there is no folder {path.parent}")
    return path
