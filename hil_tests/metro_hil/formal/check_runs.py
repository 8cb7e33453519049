"""Checks logs of a line's radio, or simulated runs, against the TLA+ model of the protocol."""

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, Final

from canlog.damage import LogError
from canlog.run_names import choose_run
from firmware_py.clock.clock import WallClock
from firmware_py.command_line import CommandParser
from firmware_py.radio.credentials import load_credentials
from firmware_py.radio.line_keys import line_keys
from firmware_py.settings import SettingsError
from firmware_py.storage.recorder import SerialDirection
from firmware_py.trackdb.areas import load_areas
from metro_hil.formal.conformance import Conformance
from metro_hil.simulation.batch import cpu_ns
from metro_hil.simulation.generate import Draw, draw
from metro_hil.simulation.line_world import LineWorld
from metro_hil.simulation.network_faults import FaultScale
from metro_hil.simulation.railway_events import RailwayEvents
from metro_hil.simulation.run import Phases, run_seed
from metro_hil.simulation.wire import RealCodec
from metro_hil.supervision.radio_log import find_log, read_log
from zenoh_config.codec import SafetyKey
from zenoh_config.messages import Refused
from zenoh_config.secured import SUPERVISION_NAME
from zenoh_config.t2t import T2tMessage

EXIT_OK: Final = 0
EXIT_DEVIATES: Final = 1
EXIT_USAGE: Final = 2
EXIT_NO_EVIDENCE: Final = 3
HEAD_LINES: Final = 2000
"""Number of lines of a log in which a train that recorded it has sent something."""
SHOWN: Final = 5
"""Greatest number of deviations that are printed for one run."""
COMMAND: Final = ("granted_by_majority", "roster_kept", "lease_runs")
"""Without a judgement of these guards no master has commanded, so the run shows nothing."""
EPILOG: Final = """\
A log must hold all messages of its line from the start on, as those of `hil run line` do.
exit codes: 0 every message is one that the model allows; 1 one is not; 2 wrong usage or not a log;
3 the run shows no master at work
"""


class Overheard(RealCodec):
    """The radio of a simulated line; it also gives each message to a listener when it is sent."""

    def __init__(self, listen: Callable[[Any], None]) -> None:
        super().__init__()
        self._listen = listen

    def seal(self, message: T2tMessage) -> bytes:
        self._listen(message)
        return super().seal(message)


def simulated(seed: int, drawn: Draw, phases: Phases) -> tuple[Conformance, str]:
    """Play one seed and judge its messages. The text names an invariant that the run broke."""
    conformance = Conformance(drawn.cast.line)
    world = LineWorld(seed, drawn, codec=Overheard(conformance.take))
    scale = FaultScale(*drawn.faults_s, foul_share=drawn.foul_share)
    result = run_seed(seed, world, scale, phases, cpu_ns, [RailwayEvents(world, seed)])
    return conformance, result.what


def logged(path: Path, line: str | None, key: SafetyKey) -> Conformance:
    """Judge the messages of a log. Raises SettingsError for a log or line that cannot be read.

    Without a line, its name is that in the keys of the messages.
    """
    log, conformance, refused = find_log(path), None, 0
    if _is_of_one_train(log):
        raise SettingsError(f"{log}: it holds the messages of one train; name the log of the line")
    for entry in read_log(log, key):
        refused += isinstance(entry.heard, Refused)
        if isinstance(entry.heard, T2tMessage):
            if conformance is None:
                conformance = Conformance(load_areas(line or entry.chunks[1]))
            conformance.take(entry.heard)
    conformance = conformance or Conformance()
    conformance.refused = refused
    return conformance


def _is_of_one_train(log: Path) -> bool:
    """Whether a train recorded the log: then some messages are its own, which it sent."""
    try:
        with log.open(encoding="utf-8") as file:
            return any(f",{SerialDirection.TX.value}," in line for line in islice(file, HEAD_LINES))
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not text"
        raise SettingsError(f"{log}: cannot be read: {reason}") from error


def report(name: str, judged: Conformance) -> int:
    """Print the result of one run and return its exit code."""
    looked = sum(judged.looked.values())
    head = f"{name}: {judged.messages} messages, {looked} guards judged"
    unseen = [guard for guard in COMMAND if not judged.looked[guard]]
    if judged.deviations:
        print(f"{head}: {len(judged.deviations)} deviations from the model")
        for guard, what in judged.deviations[:SHOWN]:
            print(f"  {guard}: {what}")
        return EXIT_DEVIATES
    if unseen:
        refused = f"; {judged.refused} messages could not be read" if judged.refused else ""
        print(f"{head}: no evidence: {unseen[0]} was never judged{refused}")
        return EXIT_NO_EVIDENCE
    print(f"{head}: the model allows each")
    return EXIT_OK


def main(argv: Sequence[str] | None = None) -> int:
    options = _parser().parse_args(argv)
    try:
        codes = [report(name, judged) for name, judged in _runs(options)]
    except (LogError, SettingsError) as error:
        print(f"check_runs: {error}", file=sys.stderr)
        return EXIT_USAGE
    return max(codes, key=(EXIT_OK, EXIT_NO_EVIDENCE, EXIT_DEVIATES).index)


def _runs(options: argparse.Namespace) -> Iterator[tuple[str, Conformance]]:
    if options.seeds is None:
        secure = None
        if options.secure is not None:
            secure = load_credentials(options.secure, SUPERVISION_NAME, WallClock().epoch_ns())
        path = choose_run(options.log, "vobc")
        yield str(path), logged(path, options.line, line_keys(secure))
        return
    for seed in options.seeds:
        judged, what = simulated(seed, draw(seed, None), Phases(options.minutes * 60.0))
        yield f"seed {seed}" + (f" ({what})" if what else ""), judged


def _seeds(text: str) -> range:
    first, _, last = text.partition("..")
    if not (first.isdecimal() and last.isdecimal() and int(first) <= int(last)):
        raise argparse.ArgumentTypeError(f"{text} is not a range such as 1..20")
    return range(int(first), int(last) + 1)


def _minutes(text: str) -> float:
    try:
        minutes = float(text)
    except ValueError:
        minutes = 0.0
    if not 0.0 < minutes < 1e4:
        raise argparse.ArgumentTypeError(f"{text} is not a number of minutes")
    return minutes


def _parser() -> argparse.ArgumentParser:
    parser = CommandParser(
        prog="python -m metro_hil.formal.check_runs",
        description=__doc__,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("log", nargs="?", type=Path, metavar="RUN|FILE", help="default: last run")
    parser.add_argument("--line", metavar="NAME|FILE", help="of the log; default: as its keys say")
    parser.add_argument("--secure", type=Path, metavar="FOLDER", help="of a secured line")
    parser.add_argument("--seeds", type=_seeds, metavar="A..B", help="play these seeds instead")
    parser.add_argument("--minutes", type=_minutes, default=1.0, help="of faults, for each seed")
    return parser


if __name__ == "__main__":
    sys.exit(main())
