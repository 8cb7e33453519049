"""`hil run line`: trains that command themselves on one line, struck by faults and watched."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Final

from metro_hil.engine.errors import EngineError, UsageError
from metro_hil.line_networks.apart import become_apart
from metro_hil.line_networks.options import add_options, networks_of
from metro_hil.options import EXIT_FAILED, EXIT_INTERRUPTED, EXIT_OK
from metro_hil.t2t_run.plan import HELP, ONE_WAY, Strike, faults_of, second, train_at, ways_of

if TYPE_CHECKING:
    from metro_hil.t2t_run.real import Settings

BENCHES: Final = ("processes", "lockstep")
EPILOG: Final = """\
Faults may be asked for several times. What is killed, stopped or cut stays away for --down-for
seconds; in lockstep a killed controller stays dead. The folder keeps what was said on the line's
radio (`vobc line-log FOLDER`) and the logs of every train.
exit codes: 0 nobody came too near and nobody braked by emergency without need; 1 somebody did;
2 wrong usage; 3 bus, radio, rights or a process missing; 130 ended by Ctrl-C
"""


def add(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = verbs.add_parser(
        "line",
        help="run several trains that command themselves; the same as `hil run line`",
        description="Run several trains that command themselves on one line, the foremost first, "
        "each on its way to the second station ahead: real processes, one controller, plant and "
        "bus for each train and one wayside, over real zenoh; or whole trains in virtual time. "
        "Tells what happens, strikes as asked, and ends with a table.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--line", default="loop", metavar="NAME|FILE", help="default: %(default)s")
    parser.add_argument("--trains", type=int, default=4, metavar="N", help="default: %(default)s")
    parser.add_argument("--for", type=float, default=90.0, dest="duration_s", metavar="SECONDS")
    parser.add_argument("--bench", choices=BENCHES, default="processes", help="default: processes")
    parser.add_argument(
        "--seed", type=int, default=1, help="in lockstep, and of packets' fates; default: 1"
    )
    parser.add_argument("--line-timers", choices=("A", "B"), default="A", help="default: A")
    parser.add_argument("--arbiters", type=int, choices=(1, 3, 5), default=1, help="default: 1")
    parser.add_argument(
        "--line-radio", metavar="ENDPOINT", help="of the wayside; default: a free port"
    )
    parser.add_argument(
        "--priority",
        type=int,
        choices=range(100),
        default=40,
        metavar="0..99",
        help="of controllers, SCHED_FIFO where the rights allow it; 0: none; default: 40",
    )
    parser.add_argument(
        "--secure", type=Path, metavar="FOLDER", help="certificates and keys by `vobc demo-ca`"
    )
    parser.add_argument("--out", metavar="FOLDER", help="default: a new one below runs/")
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
    """Raises UsageError and SettingsError for what does not fit together."""
    from firmware_py.buses import BusError
    from firmware_py.clock import WallClock
    from firmware_py.radio.zenoh_radio import RadioError
    from metro_hil.children import ChildError
    from metro_hil.run_folder import make_run_folder

    settings = _settings(options)
    if settings.networks is not None and not options.apart:
        become_apart("metro_hil.hil_command", [*options.words, "--apart"])
    folder = make_run_folder(options.out, WallClock().epoch_ns(), f"line_{settings.areas.name}")
    try:
        return _run(options, settings, folder.path)
    except (BusError, RadioError, ChildError) as error:
        raise EngineError(str(error)) from error


def _settings(options: argparse.Namespace) -> "Settings":
    from firmware_py.radio.zenoh_radio import pick_endpoint
    from firmware_py.trackdb import load_line
    from firmware_py.trackdb.areas import load_areas
    from metro_hil.line_networks.ether_process import OWN_ENDPOINT
    from metro_hil.t2t_run.real import Settings
    from metro_hil.t2t_run.virtual import NOT_HERE
    from zenoh_config.sessions import check_endpoint

    areas, line = load_areas(options.line), load_line(options.line)
    faults = faults_of(options)
    try:
        ways = ways_of(line, options.trains)
        if options.line_radio is not None:
            check_endpoint(options.line_radio)
    except ValueError as error:
        raise UsageError(str(error)) from error
    if not options.duration_s > 0.0:
        raise UsageError(f"--for {options.duration_s:g}: not a duration")
    for each in faults:
        if each.train > options.trains:
            raise UsageError(f"--{each.strike.value} T{each.train}: there is no such train")
        if options.bench == "lockstep" and each.strike in NOT_HERE:
            raise UsageError(f"--{each.strike.value}: not in lockstep")
    networks = networks_of(options, needed=any(each.strike in ONE_WAY for each in faults))
    if networks is not None:
        for given, words in (
            (options.bench == "lockstep", "--bench lockstep has no network"),
            (options.line_radio is not None, "--line-radio does not go with networks of their own"),
            (options.secure is not None, "--secure does not go with networks of their own"),
        ):
            if given:
                raise UsageError(words)
    return Settings(
        line=line,
        areas=areas,
        line_name=options.line,
        ways=ways,
        endpoint=options.line_radio or (pick_endpoint() if networks is None else OWN_ENDPOINT),
        timers=options.line_timers,
        arbiters=options.arbiters,
        faults=faults,
        down_s=options.down_s,
        duration_s=options.duration_s,
        priority=options.priority,
        secure=options.secure,
        networks=networks,
    )


def _run(options: argparse.Namespace, settings: "Settings", folder: Path) -> int:
    from metro_hil.t2t_run.real import RealLine
    from metro_hil.t2t_run.record import told
    from metro_hil.t2t_run.verdict import areas_words, carried_words, complaints, show
    from metro_hil.t2t_run.virtual import VirtualLine
    from vobc.t2t.vocabulary import T2tConfig

    def say(at_s: float, words: str) -> None:
        print(told(at_s, words), flush=True)

    line: RealLine | VirtualLine
    if options.bench == "lockstep":
        line = VirtualLine(settings, folder, say, seed=options.seed)
    else:
        print(f"line radio: {settings.endpoint}; look with `vobc line --watch --line-radio ...`")
        line = RealLine(settings, folder, say)
    over = line.run()
    trains = len(settings.ways)
    show(line.story, trains)
    for words in areas_words(line.story):
        print(words)
    for way, counts in line.carried.items():
        print(f"{way}: {counts['sent']} packets, " + carried_words(counts))
    if line.dropped:
        print(f"the recorder missed {line.dropped} messages")
    wrong = complaints(line.story, trains, behind_rear_m=T2tConfig().rollback_m)
    for words in wrong:
        print(words)
    print(f"run folder: {folder}")
    if not over:
        return EXIT_INTERRUPTED
    return EXIT_FAILED if wrong else EXIT_OK
