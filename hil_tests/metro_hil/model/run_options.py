"""The options of `vobc run`."""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from firmware_py.command_line import CommandParser
from firmware_py.trackdb.circuit import split_route
from firmware_py.trackdb.one_track import DIRECTIONS
from metro_hil.model.known_names import DESK, DRIVERS, FAULTS, LAWS, LINE_ENDPOINT, STAGES
from metro_hil.model.line_options import DEFAULT_ARBITERS, DEFAULT_TIMERS
from metro_hil.model.line_options import add_options as add_t2t_options
from metro_hil.model.line_options import train_number as train_number

DESCRIPTION = "The on-board controller of a metro train, on a bench or on a bus."

EXTERNAL = "external"
BROWSER = "browser"
"""Mode of the desk whose keys come from the page of the run."""
ELSEWHERE = (EXTERNAL, "none")
PLANTS = ("auto", "none")
DESKS = ("auto", "manual", "off", BROWSER, *ELSEWHERE)

LINE_DEFAULTS = {"line": "changping", "consist": "typeB4", "params": "typeB4"}
"""Defaults with --trains and without --traffic; a traffic file has its own."""

EXIT_OK = 0
EXIT_FAILED = 1
EXIT_USAGE = 2
EXIT_ENVIRONMENT = 3
EXIT_INTERRUPTED = 130

OTHER_VERBS = {
    "check": "judge line, train and parameters together, without a run",
    "device": "run the bare controller on a bus, for a plant or a real train",
    "export": "write a line as railML 3 or TTOBench",
    "import": "turn a line, network or train of another format into files of this project",
    "host": "run a controller of your own, in any language, in real time on a bus",
    "network": "check, show or draw the tracks of a network or a line",
    "explain": "show what the controller of a run decided, why, and from which frames",
    "watch": "show a run in a browser, while it goes on or afterwards",
    "tune": "re-tune a control law and write a parameter file",
    "timetable": "find a timetable that saves energy on a whole line",
    "design-curve": "design the power-limited running curve of one hop",
    "line-log": "show messages of trains and wayside: frame by frame, counted, as a plot",
    "demo-ca": "make certificates and the other files of a secured line, for demonstrations",
}
"""Help texts of verbs that are separate programs."""
SHIPPED_VERBS = {
    "lines": "list the lines that ship",
    "consists": "list the trains that ship",
    "show": "print a shipped file of a line, a consist or the controller's parameters",
}
"""Help texts of the verbs that print what ships."""
LINE_VERBS = {
    "line": "show areas, track and trains of a line",
    "master": "show which train commands each area, and why",
    "switch-master": "let another train command an area",
    "out-of-service": "withdraw a train from commanding areas",
    "remove-train": "take a silent train off the line, so that others stop waiting behind it",
    "hold": "keep a train at the present or next platform",
    "skip": "let a train pass the next station",
    "emergency-brake": "apply a train's emergency brake and hold it",
    "restrict": "limit the speed of all trains on a stretch",
    "close": "close a stretch to all trains",
}
"""Help texts of the verbs that supervise a line whose trains command themselves."""
SERVICE_VERBS = {
    "up": "start all programs of a line: its wayside, and bus, plant and controller of each train",
    "down": "end all programs of the line that is up",
    "status": "list the programs of the line that is up, and which of them ended",
    "restart": "start programs of the line again; those that run are ended first",
}
"""Help texts of the verbs of `vobc line` that start and end processes."""
EPILOG = """\
exit codes: 0 the train arrived, or the given duration is over; 1 the run failed; 2 wrong usage or
configuration; 3 bus, rights, disk or a process missing; 130 ended by Ctrl-C (results are written)
"""


@dataclass(frozen=True, slots=True)
class RunOptions:
    """Options of one run as the user gave them; None where the default depends on other options."""

    lockstep: bool
    bus: str
    plant: str
    tags: str
    radio: str
    line: str
    consist: str
    params: str
    load_ratio: float | None
    odometer_error: float | None
    start: str | None
    end: str | None
    seed: int
    duration_s: float | None
    cycle_ms: float
    out: str | None
    priority: int
    json: bool
    desk: str = "auto"
    """Mode of the plant's desk; external: `plant desk` is the desk; none: no desk."""
    driver: str | None = None
    desk_recording: str | None = None
    ato: str | None = None
    """Control law of ATO; None for that of the parameters."""
    output: str | None = None
    """Output stage of ATO; None for that of the parameters."""
    trains: int | None = None
    """Number of trains on the line in lockstep; None for a single train without network."""
    supply: str | None = None
    """Supply network that feeds the trains."""
    traffic: str | None = None
    logs: bool = True
    """Whether each of several trains writes logs."""
    masters: bool = False
    """Whether the trains of a service command themselves."""
    kill_master_at_s: float | None = None
    cut_master_at_s: float | None = None
    train: int | None = None
    """Number of this train among trains that command themselves."""
    line_radio: str | None = None
    """Address on which the line's wayside listens."""
    line_peer: str | None = None
    """Address at which other peers reach this one, or empty; None for no direct connection."""
    secure: str | None = None
    """Folder with certificates and keys of a secured line."""
    insecure: bool = False
    """The user allows a line without certificates where other machines reach it."""
    line_timers: str | None = None
    """Set of timers; must be that of the wayside, as must the number of arbiters."""
    arbiters: int | None = None
    watch: bool = False
    """Whether to serve a page of the run while it goes on."""
    allow_faults: bool = False
    """Whether viewers of the page may start and stop faults."""
    memory: str | None = None
    """Folder of the controller's memory with --train; None: the run folder."""
    and_back: str | None = None
    """Route by which the train drives back after it changed ends at the last station; empty for
    the other direction, None for a run one way."""
    service: str | None = None
    """File of a service, whose trips the train makes one after the other."""
    plot: bool | None = None
    """Whether a plot is drawn; None: unless --json is given."""
    hops: bool = False
    """Whether running time and energy of each hop are printed."""

    @property
    def is_networked(self) -> bool:
        """Whether this is one train of a network in real time."""
        return self.train is not None and self.service is not None

    @property
    def by_hand(self) -> tuple[str, ...]:
        """What a viewer of the page may do while the train runs: desk, faults or both."""
        allowed = {DESK: self.desk == BROWSER, FAULTS: self.allow_faults}
        return tuple(name for name, given in allowed.items() if given)


def parser() -> argparse.ArgumentParser:
    """The command line of `vobc`."""
    top = CommandParser(prog="vobc", is_command=True, description=DESCRIPTION)
    verbs = top.add_subparsers(dest="verb", required=True, metavar="VERB")
    run = verbs.add_parser(
        "run",
        help="drive the train",
        description="Drive a train over a CAN bus from station to station and report how it went.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    for verb, words in {**OTHER_VERBS, **SHIPPED_VERBS, **LINE_VERBS}.items():
        verbs.add_parser(verb, help=words, add_help=False)
    _add_journey(run)
    _add_desk(run)
    _add_wires(run)
    _add_line(run)
    add_t2t_options(run)
    _add_rest(run)
    return top


def _add_journey(run: argparse.ArgumentParser) -> None:
    group = run.add_argument_group("the journey")
    group.add_argument(
        "--line", metavar="NAME|FILE", help="default: florence; changping with --trains"
    )
    group.add_argument(
        "--from", dest="start", metavar="STATION", help="default: the first of the line"
    )
    group.add_argument("--to", dest="end", metavar="STATION", help="default: the last of the line")
    group.add_argument(
        "--direction",
        choices=DIRECTIONS,
        help="run the line up (towards growing chainage, the default) or down",
    )
    group.add_argument(
        "--and-back",
        nargs="?",
        const="",
        metavar="ROUTE",
        help="at the last station, change ends and drive back, with --lockstep; on a network by "
        "this route",
    )
    group.add_argument(
        "--service",
        metavar="FILE",
        help="make the trips of this service one after the other, with --lockstep or --train",
    )
    group.add_argument(
        "--consist",
        metavar="NAME|FILE",
        help="the real train of the plant; default: florence4, with --trains that of the line",
    )
    group.add_argument(
        "--params",
        metavar="NAME|FILE",
        help="what the controller believes of its train; default: florence4, with --trains as the "
        "consist of the line",
    )
    group.add_argument(
        "--ato",
        choices=LAWS,
        help="control law of the automatic operation; default: the parameters'",
    )
    group.add_argument(
        "--output",
        choices=STAGES,
        help="how its demand reaches the train; default: the parameters'",
    )
    group.add_argument(
        "--load-ratio",
        type=_ratio,
        metavar="0..1",
        help="share of the full passenger load; default: the consist's",
    )
    group.add_argument(
        "--odometer-error",
        type=_odometer_error,
        metavar="RATIO",
        help="systematic error of the tachos, such as 0.05; default: sampled by the consist",
    )
    group.add_argument(
        "--seed", type=_seed, default=1, help="seed of all noise in the run; default: 1"
    )
    group.add_argument(
        "--duration",
        dest="duration_s",
        type=_seconds,
        metavar="SECONDS",
        help="end the run after this time",
    )


def _add_desk(run: argparse.ArgumentParser) -> None:
    group = run.add_argument_group("the desk of the emulated train")
    group.add_argument(
        "--desk",
        choices=DESKS,
        default="auto",
        help="its mode; external: `plant desk` is the desk, in real time; browser: the page of the "
        "run, as with --watch; none: no desk",
    )
    group.add_argument(
        "--driver", choices=list(DRIVERS), help="driver model that drives, with --desk manual"
    )
    group.add_argument("--desk-recording", metavar="FILE", help="recording of a desk to play back")


def _add_wires(run: argparse.ArgumentParser) -> None:
    group = run.add_argument_group("the wires")
    group.add_argument(
        "--lockstep",
        action="store_true",
        help="controller and plant in one process in virtual time, as fast as it goes",
    )
    group.add_argument(
        "--bus",
        default="auto",
        metavar="SPEC",
        help="auto, socketcan:vcan0, socketcan:can0, embedded:vcan0; default: auto",
    )
    group.add_argument(
        "--plant",
        type=_plant,
        default="auto",
        metavar="PLANT",
        help="auto: start the plant emulator when no plant answers on a virtual bus; none: wait; "
        "command:WORDS or fmu:MAPPING: a program or FMU that emulates parts of the train",
    )
    group.add_argument(
        "--tags", default="auto", metavar="DEVICE", help="tag reader, such as /dev/ttyUSB0"
    )
    group.add_argument(
        "--radio", default="auto", metavar="ENDPOINT", help="wayside, such as tcp/127.0.0.1:7447"
    )


def _add_line(run: argparse.ArgumentParser) -> None:
    group = run.add_argument_group("several trains on one line, with --lockstep")
    group.add_argument(
        "--trains",
        type=_trains,
        metavar="N",
        help="number of trains, each on its own bus, on one supply network; with --service on one "
        "track network",
    )
    group.add_argument(
        "--traffic", metavar="NAME|FILE", help="headway, dwells, places; default: the line's"
    )
    group.add_argument(
        "--supply",
        metavar="NAME|FILE",
        help="network: strong, weak; default: the traffic's, and with --service a source for each "
        "train",
    )
    group.add_argument(
        "--no-logs", dest="logs", action="store_false", help="no folder for each train: faster"
    )
    group.add_argument(
        "--masters",
        action="store_true",
        help="the trains of --service command themselves: masters issue all authorities",
    )
    for name, what in (
        ("kill", "the controller of a master dies then; the run ends a minute later"),
        ("cut", "the radio of a master is cut then, for 0.4 s"),
    ):
        group.add_argument(
            f"--{name}-master-at", dest=f"{name}_master_at_s", type=_second, metavar="S", help=what
        )


def _add_rest(run: argparse.ArgumentParser) -> None:
    group = run.add_argument_group("the controller and the results")
    group.add_argument(
        "--cycle-ms",
        type=_cycle_ms,
        default=50.0,
        metavar="MS",
        help="control cycle, 5 to 200; default: 50",
    )
    group.add_argument(
        "--priority",
        type=_priority,
        default=80,
        metavar="1..99",
        help="SCHED_FIFO priority where the rights allow it; 0: ordinary scheduling; default: 80",
    )
    group.add_argument(
        "--watch",
        action="store_true",
        help="serve a page that shows the run in a browser, and print its address",
    )
    group.add_argument(
        "--allow-faults",
        action="store_true",
        help="let a viewer of that page start, change and stop faults; with --lockstep, virtual "
        "time then goes no faster than real time",
    )
    group.add_argument(
        "--plot",
        action=argparse.BooleanOptionalAction,
        help="draw the run; default: yes, with --json no",
    )
    group.add_argument(
        "--hops",
        action="store_true",
        help="print running time and energy of each hop, with several trains their means",
    )
    group.add_argument("--out", metavar="DIR", help="run folder; default: a new one below runs/")
    group.add_argument(
        "--json",
        action="store_true",
        help="end with one JSON object on standard output, everything else on standard error",
    )


def parse(argv: Sequence[str]) -> RunOptions:
    """Parse the command line. Raises SystemExit as argparse does."""
    top = parser()
    chosen = vars(top.parse_args(argv))
    del chosen["verb"]
    problem = service_problem(chosen)
    if problem:
        top.error(problem)
    direction = chosen.pop("direction")
    several = chosen["trains"] is not None and chosen["service"] is None
    for name, alone in (("line", "florence"), ("consist", "florence4"), ("params", "florence4")):
        of_line = LINE_DEFAULTS[name] if chosen["traffic"] is None else ""
        chosen[name] = chosen[name] or (of_line if several else alone)
    if direction is not None:
        if split_route(chosen["line"])[1] is not None:
            top.error(f"--direction: --line {chosen['line']} names one already; leave one out")
        if several:
            top.error("--direction: not with --trains, where the line's traffic file decides it")
        chosen["line"] = f"{chosen['line']}:{direction}"
    chosen["watch"] = chosen["watch"] or chosen["allow_faults"] or chosen["desk"] == BROWSER
    options = RunOptions(**chosen)
    problem = (
        wires_problem(options)
        or desk_problem(options)
        or by_hand_problem(options)
        or line_problem(options)
        or trains_problem(options)
        or trips_problem(options)
        or masters_problem(options)
    )
    if problem:
        top.error(problem)
    return options if options.train is None else _of_line(options)


def _of_line(options: RunOptions) -> RunOptions:
    """Fill in the wayside's defaults where the user gave no value."""
    return replace(
        options,
        line_radio=options.line_radio or LINE_ENDPOINT,
        line_timers=options.line_timers or DEFAULT_TIMERS,
        arbiters=options.arbiters or DEFAULT_ARBITERS,
    )


def wires_problem(options: RunOptions) -> str:
    """Error text if a wire does not fit --lockstep or its absence; else empty."""
    foreign = options.plant not in PLANTS
    if foreign and options.trains is not None:
        return "--plant: a plant of your own needs a single train, so leave out --trains"
    if options.plant.startswith("nodes:") and not options.lockstep:
        return "--plant nodes: needs --lockstep, because the nodes act in virtual time"
    wires = {
        "--bus": options.bus,
        "--plant": "auto" if foreign else options.plant,
        "--tags": options.tags,
        "--radio": options.radio,
    }
    asked = [name for name, wire in wires.items() if wire != "auto"]
    if not (options.lockstep and asked):
        return ""
    return f"{asked[0]}: not with --lockstep, which runs controller and train in one process"


def trains_problem(options: RunOptions) -> str:
    """Error text if an option does not fit --trains, or needs it; else empty."""
    if options.trains is None:
        alone = {
            "--supply": options.supply is not None,
            "--traffic": options.traffic is not None,
            "--no-logs": not options.logs,
        }
        if options.service is not None:
            # Its file names the number of trains.
            del alone["--no-logs"], alone["--supply"]
        asked = [name for name, given in alone.items() if given]
        return f"{asked[0]}: only with --trains" if asked else ""
    if options.service is not None and options.traffic:
        return "--traffic: not with --service, whose file gives the headway"
    if options.watch:
        return "--watch: not with --trains; `vobc watch` shows the folder of one of the trains"
    if not (options.lockstep or options.is_networked):
        return (
            "--trains: with --lockstep only; in real time `plant run --trains` serves the trains, "
            "and each has a `vobc run --bus` of its own"
        )
    fixed = {
        "--from": options.start is not None,
        "--to": options.end is not None,
        "--desk": options.desk != "auto",
        "--driver": options.driver is not None,
        "--desk-recording": options.desk_recording is not None,
    }
    asked = [name for name, given in fixed.items() if given]
    return (
        f"{asked[0]}: not with --trains, where the line's traffic file decides it" if asked else ""
    )


def service_problem(chosen: Mapping[str, object]) -> str:
    """Error text if an option says what the file of --service says; else empty."""
    if chosen["service"] is None:
        return ""
    given = {
        "--line": chosen["line"] is not None,
        "--from": chosen["start"] is not None,
        "--to": chosen["end"] is not None,
        "--direction": chosen["direction"] is not None,
        "--and-back": chosen["and_back"] is not None,
    }
    asked = [name for name, is_given in given.items() if is_given]
    return f"{asked[0]}: not with --service, whose file decides it" if asked else ""


def trips_problem(options: RunOptions) -> str:
    """Error text if an option does not fit a run of several trips; else empty."""
    if options.and_back is None and options.service is None:
        return ""
    name = "--and-back" if options.service is None else "--service"
    if options.is_networked:
        return networked_problem(options)
    if not options.lockstep:
        return (
            f"{name}: with --lockstep only; in real time start one run for each direction, or one "
            "for each train of a network by --train and --service"
        )
    if options.trains is not None and options.service is None:
        return f"{name}: not with --trains, where the line's traffic file decides it"
    if options.watch:
        return f"{name}: not with --watch; `vobc watch` shows the run that goes on"
    if options.plant != "auto":
        return f"{name}: with the emulated train only, because it must be turned round"
    if options.duration_s is not None:
        return f"{name}: not with --duration, because the train must arrive to go on"
    return ""


def networked_problem(options: RunOptions) -> str:
    """Error text if an option does not fit one train of a network in real time; else empty."""
    given = {
        "--bus": options.bus != "auto",
        "--plant": options.plant != "auto",
        "--tags": options.tags != "auto",
        "--radio": options.radio != "auto",
        "--desk": options.desk != "auto",
        "--driver": options.driver is not None,
        "--desk-recording": options.desk_recording is not None,
        "--watch": options.watch,
        "--duration": options.duration_s is not None,
        "--line-peer": options.line_peer is not None,
        "--memory": options.memory is not None,
        "--supply": options.supply is not None,
        "--kill-master-at": options.kill_master_at_s is not None,
        "--cut-master-at": options.cut_master_at_s is not None,
    }
    asked = [name for name, is_given in given.items() if is_given]
    return (
        f"{asked[0]}: not with --train and --service, where one program has train and controller"
        if asked
        else ""
    )


def masters_problem(options: RunOptions) -> str:
    """Error text if an option does not fit trains of a service that command themselves."""
    strikes = {
        "--kill-master-at": options.kill_master_at_s is not None,
        "--cut-master-at": options.cut_master_at_s is not None,
    }
    asked = [name for name, given in strikes.items() if given]
    if asked and not options.masters:
        return f"{asked[0]}: only with --masters"
    if len(asked) > 1:
        return f"{asked[0]} and {asked[1]}: one of them for each run"
    if options.masters and options.service is None:
        return (
            "--masters: only with --service; `hil run line` runs trains that command themselves on "
            "a line in one direction"
        )
    return ""


def desk_problem(options: RunOptions) -> str:
    """Error text if the desk's options contradict each other; else empty."""
    if options.desk == EXTERNAL and options.lockstep:
        return (
            "--desk external: `plant desk` cannot drive in virtual time; leave out --lockstep, or "
            "drive with --desk browser"
        )
    if options.driver and options.desk_recording:
        return "--desk-recording: not together with --driver"
    if (options.driver or options.desk_recording) and options.desk in (BROWSER, *ELSEWHERE):
        asked = "--driver" if options.driver else "--desk-recording"
        why = "a viewer drives" if options.desk == BROWSER else "the plant has no desk"
        return f"{asked}: {why} with --desk {options.desk}"
    return ""


def by_hand_problem(options: RunOptions) -> str:
    """Error text if a person at the page cannot act on this run; else empty."""
    if options.allow_faults and options.trains is not None:
        return (
            "--allow-faults: not with --trains, where each train has a page of its own afterwards"
        )
    if options.allow_faults and options.plant != "auto":
        return "--allow-faults: only with the train of the bench; leave out --plant"
    if options.desk == BROWSER and options.lockstep and options.plant != "auto":
        return "--desk browser: with --lockstep only at the desk of the bench; leave out --plant"
    return ""


def line_problem(options: RunOptions) -> str:
    """Error text if an option does not fit trains that command themselves; else empty."""
    of_train = {
        "--line-radio": options.line_radio,
        "--line-peer": options.line_peer,
        "--secure": options.secure,
        "--line-timers": options.line_timers,
        "--arbiters": options.arbiters,
        "--memory": options.memory,
        "--insecure": options.insecure or None,
    }
    asked = [name for name, given in of_train.items() if given is not None]
    if asked and options.train is None:
        return f"{asked[0]}: needs --train, such as --train T1"
    if options.train is not None and options.lockstep:
        return "--train: in virtual time `hil run line --bench lockstep` runs a whole line"
    if options.line_peer is not None and options.secure is not None:
        return "--line-peer: not with --secure, because peers bypass the wayside and its rules"
    if options.line_radio is None:
        return ""
    from zenoh_config.sessions import check_endpoint, check_secured

    try:
        check_endpoint(options.line_radio)
        check_secured(
            options.line_radio, secured=options.secure is not None, insecure=options.insecure
        )
    except ValueError as error:
        return f"--line-radio {error}"
    return ""


def _number(text: str, low: float, high: float, what: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number") from None
    if not low <= value <= high:
        raise argparse.ArgumentTypeError(f"{text} is not {what}")
    return value


def _plant(text: str) -> str:
    kind, _, rest = text.partition(":")
    if text in PLANTS or (kind in ("command", "fmu", "nodes") and rest):
        return text
    raise argparse.ArgumentTypeError(
        f"{text!r} is none of auto, none, command:WORDS, fmu:MAPPING and nodes:FILE"
    )


def _ratio(text: str) -> float:
    return _number(text, 0.0, 1.0, "within 0..1")


def _odometer_error(text: str) -> float:
    return _number(text, -0.2, 0.2, "within -0.2..0.2")


def _seconds(text: str) -> float:
    return _number(text, 0.1, 1e7, "a duration of 0.1 s or more")


def _cycle_ms(text: str) -> float:
    return _number(text, 5.0, 200.0, "within 5..200 ms")


def _whole(text: str, low: int, high: int) -> int:
    try:
        value = int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number") from None
    if not low <= value <= high:
        raise argparse.ArgumentTypeError(f"{text} is not within {low}..{high}")
    return value


def _seed(text: str) -> int:
    return _whole(text, 0, 2**63 - 1)


def _priority(text: str) -> int:
    return _whole(text, 0, 99)


def _second(text: str) -> float:
    return _number(text, 0.05, 1e6, "a second of the run, from 0.05 on")


def _trains(text: str) -> int:
    return _whole(text, 1, 99)
