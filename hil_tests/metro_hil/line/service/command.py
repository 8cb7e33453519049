"""`vobc line up`, `down`, `status` and `restart`: a line of real processes, run by hand."""

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import msgspec

from canlog.run_names import mark_latest
from firmware_py.buses import BusError
from firmware_py.buses.hub_control import hub_status
from firmware_py.clock.clock import WallClock
from firmware_py.command_line import CommandParser, suggestion
from firmware_py.interrupts import Interrupts
from firmware_py.radio.credentials import Credentials, load_credentials
from firmware_py.radio.line_keys import line_keys
from firmware_py.radio.zenoh_radio import RadioError, SessionRole, open_radio
from firmware_py.settings import SettingsError, is_path
from firmware_py.storage.whole_file import write_whole
from firmware_py.trackdb import LineMap, load_line
from firmware_py.trackdb.areas import AreaMap, load_areas
from firmware_py.trackdb.circuit import load_network, load_path, split_route, with_route
from firmware_py.trackdb.network import TrackNetwork
from metro_hil.line.exercise.plan import ways_of
from metro_hil.line.service.plan import BUS, LineSetup, LineUp, chosen, programs_of, wayside_parts
from metro_hil.line.service.programs import ProgramFiles, end_all
from metro_hil.line.turning.plan import plan_fleet
from metro_hil.model.line_options import add_insecure, train_number
from metro_hil.model.run_folder import RunFolder, RunFolderError, make_run_folder, write_config
from metro_hil.model.run_options import (
    EXIT_ENVIRONMENT,
    EXIT_INTERRUPTED,
    EXIT_OK,
    EXIT_USAGE,
    SERVICE_VERBS,
    parse,
)
from metro_hil.model.service import line_of_service
from metro_hil.supervision.access import refuse_insecure
from metro_hil.supervision.console import SupervisionConsole
from metro_hil.supervision.view import LineView
from plant_emulator.wayside.route_objects import divided, shared_tracks
from zenoh_config import t2t_keys
from zenoh_config.codec import SafetyKey
from zenoh_config.secured import SUPERVISION_NAME, WAYSIDE_NAME, train_name
from zenoh_config.sessions import LINE_ENDPOINT
from zenoh_config.timers import TIMER_SETS

NOTE: Final = "line-up.json"
"""File in the run folder with the programs of the line."""
RUNS: Final = Path("runs")
START_S: Final = 60.0
"""Time for all programs to start and for a train to take command, on a busy machine."""
LOOK_S: Final = 0.3
POLL_NS: Final = 50_000_000
NS_PER_S: Final = 1_000_000_000
EPILOG: Final = """\
exit codes: 0 done, and every program runs; 2 wrong usage or configuration; 3 the line is up already
or not up, or a program ended; 130 ended by Ctrl-C
"""


class ServiceError(Exception):
    """The line cannot be served; the text says why and what to do."""


def main(words: Sequence[str]) -> int:
    """Run `up`, `down`, `status` or `restart` and return the exit code."""
    options = parser().parse_args(words)
    try:
        if options.action == "up":
            return _up(options)
        folder, up = _only_one(options.out)
        if options.action == "down":
            return _down(folder, up)
        if options.action == "restart":
            return _restart(folder, up, options.names)
        return _status(folder, up)
    except (SettingsError, RunFolderError) as error:
        return _complain(error, EXIT_USAGE)
    except (ServiceError, BusError, RadioError) as error:
        return _complain(error, EXIT_ENVIRONMENT)


def parser() -> argparse.ArgumentParser:
    top = CommandParser(prog="vobc line", description=__doc__)
    verbs = top.add_subparsers(dest="action", required=True, metavar="VERB")
    parsers = {
        verb: verbs.add_parser(
            verb,
            help=words,
            description=f"{words[0].upper()}{words[1:]}.",
            epilog=EPILOG,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        for verb, words in SERVICE_VERBS.items()
    }
    up = parsers["up"]
    up.add_argument("--line", metavar="NAME|FILE", help="default: loop")
    up.add_argument(
        "--service",
        metavar="FILE",
        help="instead of a line: trains on a network that make the trips of this service",
    )
    up.add_argument(
        "--trains",
        type=int,
        metavar="N",
        help="number of trains, one at each station, each on its way to the second station ahead; "
        "default: 4, with --service that of its file",
    )
    up.add_argument("--line-timers", choices=sorted(TIMER_SETS), default="A", help="default: A")
    up.add_argument("--arbiters", type=int, choices=(1, 3, 5), default=3, help="default: 3")
    up.add_argument(
        "--line-radio",
        default=LINE_ENDPOINT,
        metavar="ENDPOINT",
        help="address of the wayside; default: %(default)s",
    )
    up.add_argument("--secure", type=Path, metavar="FOLDER", help="see `vobc demo-ca`")
    add_insecure(up)
    up.add_argument(
        "--attended",
        type=train_number,
        action="append",
        default=[],
        metavar="TRAIN",
        help="a person works the desk of this train by `plant desk`; may be given several times",
    )
    up.add_argument(
        "--priority",
        type=int,
        choices=range(100),
        default=40,
        metavar="0..99",
        help="priority of controllers, SCHED_FIFO where the rights allow it; 0: none; default: 40",
    )
    up.add_argument("--out", metavar="FOLDER", help="run folder; default: a new one below runs/")
    for verb in ("down", "status", "restart"):
        parsers[verb].add_argument(
            "--out",
            metavar="FOLDER",
            help="run folder of the line; default: that of the line that is up",
        )
    parsers["restart"].add_argument(
        "names",
        nargs="+",
        metavar="PROGRAM",
        help="such as arbiter1, T1/plant, T1/controller, or T1 for its controller",
    )
    return top


def _up(options: argparse.Namespace) -> int:
    setup, line = _planned(options)
    for path, each in _lines_up():
        if each.line_name == line.name or each.endpoint == setup.endpoint:
            raise ServiceError(
                f"line {each.line_name} is up already at {each.endpoint}, run folder {path}; "
                "`vobc line down` ends it"
            )
    clock = WallClock()
    folder = make_run_folder(options.out, clock.epoch_ns(), f"{line.name}_up")
    programs = programs_of(setup, folder.path.resolve())
    write_config(folder, {"setup": msgspec.to_builtins(setup), "line": line}, clock.epoch_ns())
    up = LineUp(line.name, setup.endpoint, programs)
    write_whole(folder.path / NOTE, msgspec.json.encode(up))
    mark_latest(folder.path)
    files = [ProgramFiles(folder.path, each) for each in programs]
    interrupts = Interrupts()
    with interrupts.caught():
        try:
            done = _Start(setup, folder, files, clock, interrupts).run(_divided(setup))
        except BaseException:
            end_all(files[::-1], clock)
            raise
        if not done:
            end_all(files[::-1], clock)
            return _complain("interrupted; every program of the line is ended", EXIT_INTERRUPTED)
    _print_next(up, options)
    return EXIT_OK


def _planned(options: argparse.Namespace) -> tuple[LineSetup, LineMap | TrackNetwork]:
    """Check the options. Raises SettingsError."""
    refuse_insecure(options)
    if options.service is not None:
        return _network_setup(options)
    options.line = options.line or "loop"
    options.trains = 4 if options.trains is None else options.trains
    line = load_line(options.line)
    return _setup(options, line), line


def _network_setup(options: argparse.Namespace) -> tuple[LineSetup, TrackNetwork]:
    """Check the options of trains on a network. Raises SettingsError."""
    given = {"--line": options.line, "--attended": options.attended}
    for name, value in given.items():
        if value:
            raise SettingsError(f"{name}: not with --service, whose trains run by themselves")
    words = ["run", "--service", options.service, "--train", "1"]
    words += [] if options.trains is None else ["--trains", str(options.trains)]
    plan = plan_fleet(parse(words))
    line = line_of_service(options.service)
    routes = dict.fromkeys(str(split_route(each.trip.line)[1]) for each in plan.trips)
    setup = LineSetup(
        str(Path(line).resolve()) if is_path(line) else line,
        *(options.line_radio, options.line_timers, options.arbiters, options.priority, []),
        secure=_secured(options, plan.trains),
        insecure=options.insecure,
        service=str(Path(options.service).resolve()),
        routes=[*routes],
        trains=plan.trains,
    )
    return setup, plan.network


def _divided(setup: LineSetup) -> AreaMap:
    """The areas of the line, or of the path of a service on which its trains begin."""
    if not setup.routes:
        return load_areas(setup.line)
    paths = [load_path(with_route(setup.line, route)) for route in setup.routes]
    return divided(load_network(setup.line), paths[0], shared_tracks(paths))


def _setup(options: argparse.Namespace, line: LineMap) -> LineSetup:
    """Check the options. Raises SettingsError."""
    load_areas(options.line)
    try:
        ways = ways_of(line, options.trains)
    except ValueError as error:
        raise SettingsError(str(error)) from error
    secure = _secured(options, options.trains)
    name = str(Path(options.line).resolve()) if is_path(options.line) else options.line
    of_line = (options.line_radio, options.line_timers, options.arbiters)
    return LineSetup(
        name, *of_line, options.priority, ways, secure, options.insecure, options.attended
    )


def _secured(options: argparse.Namespace, trains: int) -> str | None:
    """The folder of a secured line, with the files of all programs. Raises SettingsError."""
    if options.secure is None:
        return None
    _, *parts = wayside_parts(options.arbiters)
    names = [train_name(number) for number in range(1, trains + 1)]
    for name in (WAYSIDE_NAME, *parts, SUPERVISION_NAME, *names):
        epoch_ns, listens = WallClock().epoch_ns(), name == WAYSIDE_NAME
        load_credentials(options.secure, name, epoch_ns, listens=listens)
    return str(options.secure.resolve())


class _Start:
    """Starts the programs one group after the other, and waits until trains command the line."""

    def __init__(
        self,
        setup: LineSetup,
        folder: RunFolder,
        files: Sequence[ProgramFiles],
        clock: WallClock,
        interrupts: Interrupts,
    ) -> None:
        self._setup, self._folder, self._files = setup, folder, files
        self._clock, self._interrupts = clock, interrupts

    def run(self, areas: AreaMap) -> bool:
        """Return whether the line came up; False after an interrupt. Raises ServiceError."""
        buses = [each for each in self._files if each.program.name.endswith(f"/{BUS}")]
        others = [each for each in self._files if each not in buses]
        _say(f"starting {len(self._files)} programs, run folder {self._folder.path}")
        for each in buses:
            each.start()
        names = [each.program.arguments[0] for each in buses]
        if not self._wait(lambda: all(hub_status(name) for name in names), buses):
            return False
        for each in others:
            each.start()
        return self._commanded(areas)

    def _commanded(self, areas: AreaMap) -> bool:
        """Wait until a train commands, and report which."""
        secure, key = self._credentials()
        view = LineView(areas, key)
        with open_radio(
            *(SessionRole.TRAIN, self._setup.endpoint),
            *(t2t_keys.of_supervision(areas.name), self._clock),
            secure=secure,
        ) as port:
            console = SupervisionConsole(self._clock, view, port, key)

            def commanded() -> bool:
                console.listen(LOOK_S)
                return bool(view.commands)

            if not self._wait(commanded, self._files):
                return False
        for area, command in sorted(view.commands.items()):
            _say(f"area {area}: train {command.heartbeat.source} commands")
        return True

    def _credentials(self) -> tuple[Credentials | None, SafetyKey]:
        if self._setup.secure is None:
            return None, line_keys(None)
        secure = load_credentials(self._setup.secure, SUPERVISION_NAME, self._clock.epoch_ns())
        return secure, line_keys(secure)

    def _wait(self, done: Callable[[], bool], files: Sequence[ProgramFiles]) -> bool:
        """Wait. Raises ServiceError if one of the programs ends, or nothing comes in time."""
        end_ns = self._clock.now_ns() + round(START_S * NS_PER_S)
        while not self._interrupts.asked:
            if done():
                return True
            for each in files:
                if each.pid() is None:
                    raise ServiceError(f"{each.program.name} ended: {each.last_words()}")
            if self._clock.now_ns() > end_ns:
                raise ServiceError(
                    f"no train commands the line after {START_S:g} s; the logs are in "
                    f"{self._folder.path}"
                )
            self._clock.wait_until(self._clock.now_ns() + POLL_NS)
        return False


def _print_next(up: LineUp, options: argparse.Namespace) -> None:
    where = "" if options.line in ("loop", None) else f" --line {options.line}"
    where += "" if options.service is None else f" --service {options.service}"
    where += "" if up.endpoint == LINE_ENDPOINT else f" --line-radio {up.endpoint}"
    where += "" if options.secure is None else f" --secure {options.secure}"
    where += " --insecure" if options.insecure else ""
    web = "`--web`" if options.service is None else "`--web --route ROUTE` one path"
    _say(f"`vobc line --watch{where}` shows areas and trains, {web} in a browser")
    _say("`vobc line status` lists the programs, `vobc line down` ends them")


def _lines_up() -> list[tuple[Path, LineUp]]:
    """Return the lines below runs/ of which a program runs, with their run folders."""
    found = []
    for note in sorted(RUNS.glob(f"*/{NOTE}")):
        # `runs/latest` is a link to one of the others.
        if not note.parent.is_symlink():
            up = _noted(note)
            if any(each.pid() is not None for each in _files_of(note.parent, up)):
                found.append((note.parent, up))
    return found


def _noted(note: Path) -> LineUp:
    try:
        return msgspec.json.decode(note.read_bytes(), type=LineUp)
    except (OSError, msgspec.MsgspecError) as error:
        raise SettingsError(f"{note}: not the file of a line that was brought up") from error


def _only_one(out: str | None) -> tuple[Path, LineUp]:
    """Return the line that the user means. Raises ServiceError, SettingsError."""
    if out is not None:
        return Path(out), _noted(Path(out) / NOTE)
    found = _lines_up()
    if not found:
        raise ServiceError(f"no line is up below {RUNS.resolve()}; `vobc line up` brings one up")
    if len(found) > 1:
        listed = ", ".join(str(path) for path, _ in found)
        raise ServiceError(f"several lines are up; choose one with --out: {listed}")
    return found[0]


def _files_of(folder: Path, up: LineUp) -> list[ProgramFiles]:
    return [ProgramFiles(folder, each) for each in up.programs]


def _down(folder: Path, up: LineUp) -> int:
    """End the controllers first, so that the plants receive their safe output, and buses last."""
    clock, files = WallClock(), _files_of(folder, up)
    buses = [each for each in files if each.program.name.endswith(f"/{BUS}")]
    ended = end_all([each for each in files if each not in buses], clock) + end_all(buses, clock)
    if ended == 0:
        raise ServiceError(f"line {up.line_name} is not up; its logs are in {folder}")
    _say(f"line {up.line_name}: {ended} programs ended; logs: {folder}")
    return EXIT_OK


def _status(folder: Path, up: LineUp) -> int:
    _say(f"line {up.line_name}, wayside at {up.endpoint}, run folder {folder}")
    running = 0
    for each in _files_of(folder, up):
        pid = each.pid()
        running += pid is not None
        name = each.program.name
        if pid is not None:
            bus = f", embedded:{each.program.arguments[0]}" if name.endswith(f"/{BUS}") else ""
            _say(f"  {name:16} running, process {pid}{bus}")
        else:
            _say(f"  {name:16} ended; last output: {each.last_words() or 'none'}")
    if running < len(up.programs):
        missing = len(up.programs) - running
        return _complain(
            f"{missing} of {len(up.programs)} programs ended; `vobc line restart PROGRAM` starts "
            "one again",
            EXIT_ENVIRONMENT,
        )
    return EXIT_OK


def _restart(folder: Path, up: LineUp, names: Sequence[str]) -> int:
    wanted = []
    for name in names:
        program = chosen(up.programs, name)
        if program is None:
            known = [each.name for each in up.programs]
            listed = suggestion(name, known) or f"; `vobc line status` lists all {len(known)}"
            raise SettingsError(f"{name}: no program of line {up.line_name}{listed}")
        wanted.append(ProgramFiles(folder, program))
    clock = WallClock()
    end_all(wanted, clock)
    for each in wanted:
        each.start()
        _say(f"{each.program.name}: started, process {each.pid()}")
    return EXIT_OK


def _say(words: str) -> None:
    print(words, flush=True)


def _complain(words: object, code: int) -> int:
    print(f"vobc: {words}", file=sys.stderr)
    return code
