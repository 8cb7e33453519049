"""`hil run line`: trains that command themselves on one line, under faults and observation."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from metro_hil.engine.errors import EngineError
from metro_hil.line.exercise.plan import HELP, Strike, second, train_at
from metro_hil.line.network.isolated_process import become_apart
from metro_hil.line.network.options import add_options
from metro_hil.line.network.topology import HELP as TOPOLOGY_HELP
from metro_hil.line.network.topology import TOPOLOGIES
from metro_hil.model.line_options import add_insecure
from metro_hil.model.run_options import EXIT_ENVIRONMENT, EXIT_FAILED, EXIT_INTERRUPTED, EXIT_OK
from zenoh_config.timers import TIMER_SETS

if TYPE_CHECKING:
    from metro_hil.line.exercise.real_time import RealLine, Settings
    from metro_hil.line.exercise.virtual import VirtualLine
    from metro_hil.model.run_folder import RunFolder

    Line = RealLine | VirtualLine

BENCHES: Final = ("processes", "lockstep")
EPILOG: Final = """\
Each fault option may be given several times. A process or link that is killed, stopped or cut
stays away for --down-for seconds; in lockstep, and with --service, a killed controller stays dead.
With --service seconds count from the entry of the first train, and a fault of a master waits until
one commands an area with another train in it. The folder keeps the
options (run.toml), the event log (story.txt), the table and the verdict (results.json), the
messages on the line's radio (`vobc line-log FOLDER`) and the logs of every train.
exit codes: 0 no train came too near, and none braked by emergency without need; 1 one did; 2 wrong
usage; 3 the run proves nothing, because its observer lagged or never saw an ordered takeover, or
bus, radio, rights or a process missing; 130 ended by Ctrl-C
"""


def add(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = verbs.add_parser(
        "line",
        help="run several trains that command themselves; the same as `hil run line`",
        description="Run several trains that command themselves on one line, the foremost first, "
        "each on its way to the second station ahead: real processes, one controller, plant and "
        "bus for each train and one wayside, over real zenoh; or whole trains in virtual time. "
        "Prints the events, injects the requested faults, and ends with a table.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--line", metavar="NAME|FILE", help="default: loop")
    parser.add_argument(
        "--service",
        metavar="FILE",
        help="instead of a line: trains on a network that make the trips of this service, until "
        "all have made them or --for is over",
    )
    parser.add_argument(
        "--trains",
        type=int,
        metavar="N",
        help="default: 4, with --service that of its file",
    )
    parser.add_argument("--for", type=float, default=90.0, dest="duration_s", metavar="SECONDS")
    parser.add_argument("--bench", choices=BENCHES, default="processes", help="default: processes")
    parser.add_argument(
        "--seed", type=int, default=1, help="seed in lockstep, and of the packet faults; default: 1"
    )
    parser.add_argument("--line-timers", choices=sorted(TIMER_SETS), default="A", help="default: A")
    parser.add_argument("--arbiters", type=int, choices=(1, 3, 5), default=1, help="default: 1")
    parser.add_argument(
        "--line-radio", metavar="ENDPOINT", help="address of the wayside; default: a free port"
    )
    parser.add_argument("--topology", choices=TOPOLOGIES, default="star", help=TOPOLOGY_HELP)
    parser.add_argument(
        "--priority",
        type=int,
        choices=range(100),
        default=40,
        metavar="0..99",
        help="priority of controllers, SCHED_FIFO where the rights allow it; 0: none; default: 40",
    )
    parser.add_argument(
        "--secure", type=Path, metavar="FOLDER", help="certificates and keys of `vobc demo-ca`"
    )
    add_insecure(parser)
    parser.add_argument("--out", metavar="FOLDER", help="default: a new one below runs/")
    parser.add_argument(
        "--watch", action="store_true", help="show the line in a browser while it runs"
    )
    parser.add_argument(
        "--commands",
        action="store_true",
        help="with --watch: let the page send commands of supervision, each after a confirmation",
    )
    group = parser.add_argument_group("what goes wrong")
    for strike, words in HELP.items():
        of_train = strike is Strike.RESTART_TRAIN
        group.add_argument(
            f"--{strike.value}",
            action="append",
            type=train_at if of_train else second,
            metavar="TRAIN@SECONDS" if of_train else "SECONDS",
            help=words,
        )
    add_options(parser)
    group.add_argument("--down-for", type=second, default=4.0, dest="down_s", metavar="SECONDS")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Raises UsageError and SettingsError for options that do not fit together."""
    from canlog.run_names import mark_latest
    from firmware_py.clock.clock import WallClock
    from metro_hil.cli.hil.line_settings import config_of, settings_of
    from metro_hil.model.run_folder import discard_unused, make_run_folder, write_config
    from metro_hil.watch.companion import WatchPage

    if options.service is not None:
        return _run_service(options)
    settings = settings_of(options)
    if settings.networks is not None and not options.apart:
        become_apart("metro_hil.cli.hil", [*options.typed, "--apart"])
    epoch_ns = WallClock().epoch_ns()
    folder = make_run_folder(options.out, epoch_ns, f"line_{settings.areas.name}")
    write_config(folder, config_of(options, settings), epoch_ns)
    mark_latest(folder.path)
    try:
        line = _line(options, settings, folder.path)
    except BaseException:
        discard_unused(folder)
        raise
    if not options.watch:
        return _run(line, settings, folder)
    with WatchPage(folder.path, *(["commands"] if options.commands else [])) as page:
        print(page.line, flush=True)
        code = _run(line, settings, folder)
        if code != EXIT_INTERRUPTED:
            page.stay(print)
    return code


def _run_service(options: argparse.Namespace) -> int:
    from firmware_py.radio.zenoh_radio import RadioError
    from metro_hil.cli.hil.line_settings import refuse_faults
    from metro_hil.line.exercise.plan import faults_of
    from metro_hil.line.turning import real_line
    from metro_hil.model.subprocesses import ChildError

    if not options.restart_train_at:
        refuse_faults(options, faults_of(options))
    try:
        return real_line.run(options)
    except (RadioError, ChildError) as error:
        raise EngineError(str(error)) from error


def _line(options: argparse.Namespace, settings: "Settings", folder: Path) -> "Line":
    from metro_hil.cli.hil.line_settings import radio_words
    from metro_hil.line.exercise.real_time import RealLine
    from metro_hil.line.exercise.record import told
    from metro_hil.line.exercise.virtual import VirtualLine

    def say(at_s: float, words: str) -> None:
        print(told(at_s, words), flush=True)

    if options.bench == "lockstep":
        return VirtualLine(settings, folder, say, seed=options.seed)
    print(radio_words(settings), flush=True)
    return RealLine(settings, folder, say)


def _run(line: "Line", settings: "Settings", folder: "RunFolder") -> int:
    from firmware_py.buses import BusError
    from firmware_py.radio.zenoh_radio import RadioError
    from firmware_py.storage.recorder import loss_text
    from firmware_py.storage.whole_file import write_whole
    from metro_hil.line.exercise.results import results_json
    from metro_hil.line.exercise.verdict import complaints, doubts
    from metro_hil.model.end_condition import DURATION, INTERRUPTED
    from metro_hil.model.subprocesses import ChildError
    from vobc.train_to_train.vocabulary import T2tConfig

    trains = len(settings.ways)
    reason = ""
    try:
        reason = DURATION if line.run() else INTERRUPTED
    except (BusError, RadioError, ChildError) as error:
        reason = str(error)
        raise EngineError(reason) from error
    finally:
        # An aborted run is recorded as well: its event log is worth reading.
        wrong = complaints(line.story, trains, behind_rear_m=T2tConfig().rollback_m)
        invalid = [*line.doubts, *doubts(line.story, trains)]
        if reason != DURATION:
            invalid.insert(0, f"it did not finish: {reason or 'broken off'}")
        results = results_json(
            *(line.story, trains),
            exit_reason=reason or "broken off",
            complaints=wrong,
            missed=line.dropped,
            carried=line.carried,
            second_of=line.record.second_of,
            doubts=invalid,
        )
        write_whole(folder.results, results)
    _show(line, trains, wrong)
    for words in invalid:
        print(f"invalid: {words}")
    print(f"run folder: {folder.path}")
    if line.record.lost_lines:
        raise EngineError(f"{folder.path}: {loss_text(line.record.lost_lines)}")
    if reason == INTERRUPTED:
        print("hil: interrupted; these are the results until then", file=sys.stderr)
        return EXIT_INTERRUPTED
    if invalid:
        print("invalid: the run proves nothing, neither for the trains nor against them")
        return EXIT_ENVIRONMENT
    return EXIT_FAILED if wrong else EXIT_OK


def _show(line: "Line", trains: int, wrong: Sequence[str]) -> None:
    from metro_hil.line.exercise.verdict import areas_words, carried_words, show

    show(line.story, trains)
    for words in areas_words(line.story):
        print(words)
    for way, counts in line.carried.items():
        print(f"{way}: {counts['sent']} packets, " + carried_words(counts))
    if line.dropped:
        print(f"the recorder missed {line.dropped} messages")
    for words in wrong:
        print(words)
