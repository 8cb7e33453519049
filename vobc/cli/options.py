"""Command line, and all checks that are possible before a device is opened."""

import argparse
from dataclasses import dataclass
from typing import Final

from firmware_py import rendezvous
from firmware_py.buses import BusError, parse_spec, resolve_auto
from firmware_py.command_line import CommandParser
from firmware_py.radio.credentials import Credentials
from firmware_py.radio.zenoh_radio import DEFAULT_ENDPOINT
from firmware_py.settings import SettingsError
from firmware_py.storage.nvram import Nvram, NvramRecord
from firmware_py.trackdb import LineMap, load_line
from firmware_py.trackdb.areas import AreaMap
from vobc.ato.laws import STRATEGIES
from vobc.ato.settings.output import STAGES
from vobc.cli import line as line_options
from vobc.cli.whereabouts import Whereabouts, whereabouts
from vobc.config import CYCLE_MS_MAX, CYCLE_MS_MIN, VobcConfig, load_config, plan_mission
from vobc.plausible import check_plausible
from vobc.vocabulary import Mission, OdometryRecord

AUTO: Final = "auto"
NS_PER_S: Final = 1_000_000_000
PRIORITY_MAX: Final = 99

DESCRIPTION: Final = (
    "The bare controller in real time on a bus, for a plant or a real train. `python -m vobc` is "
    "the same program."
)

EPILOG: Final = """\
The controller keeps the brakes on until all its inputs arrive, and lists the missing ones.
`python -m vobc grant` is the same controller in virtual time, run by a bench in lockstep.
exit codes: 0 ended by SIGTERM or after --duration; 1 the controller failed and braked; 2 wrong
usage or configuration; 3 bus, rights or a folder missing; 130 ended by Ctrl-C
"""


def parser(*, is_command: bool = False) -> argparse.ArgumentParser:
    """The command line of `vobc device`, or of `python -m vobc`, which is a command of its own."""
    top = CommandParser(
        prog="python -m vobc" if is_command else "vobc device",
        is_command=is_command,
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    top.add_argument(
        "--bus", default=AUTO, metavar="SPEC", help="CAN bus: auto, socketcan:can0, ..."
    )
    top.add_argument(
        "--tags",
        default=AUTO,
        metavar="DEVICE",
        help="line of the tag reader, such as /dev/ttyUSB0",
    )
    top.add_argument(
        "--radio", default=AUTO, metavar="ENDPOINT", help="radio, such as tcp/HOST:PORT"
    )
    top.add_argument(
        "--line", default="florence", metavar="NAME|FILE", help="line map; default: florence"
    )
    top.add_argument(
        "--consist", default="florence4", metavar="NAME|FILE", help="parameters of the train"
    )
    top.add_argument(
        "--ato", choices=sorted(STRATEGIES), help="control law; default: that of the parameters"
    )
    top.add_argument(
        "--output",
        choices=STAGES,
        help="how a demand reaches the train; default: that of the parameters",
    )
    top.add_argument(
        "--from",
        dest="start",
        metavar="STATION",
        help="where the train stands; ignored if its memory has another place",
    )
    top.add_argument(
        "--to",
        dest="end",
        metavar="STATION",
        help="last stop; default: the last station of the line",
    )
    top.add_argument(
        "--stops",
        type=_names,
        metavar="A,B,...",
        help="stations to stop at; default: all on the way",
    )
    top.add_argument(
        "--cycle-ms",
        type=_cycle_ms,
        metavar="MS",
        help="cycle time; default: that of the parameters",
    )
    top.add_argument("--duration", type=_seconds, metavar="SECONDS", help="end after this time")
    top.add_argument("--priority", type=_priority, default=80, help="SCHED_FIFO priority; 0: none")
    top.add_argument(
        "--out", metavar="FOLDER", help="folder for cycles.csv, events.jsonl and others"
    )
    top.add_argument(
        "--nvram", metavar="FILE", help="memory file; default: none, nothing survives a power cycle"
    )
    top.add_argument("--parent", type=int, metavar="PID", help="end when this process ends")
    line_options.add(top)
    return top


@dataclass(frozen=True, slots=True)
class DevicePlan:
    """Results of all checks before the first device is opened."""

    config: VobcConfig
    line: LineMap
    mission: Mission
    nvram: Nvram
    start: OdometryRecord | None
    bus: str
    tags: str
    radio: str
    areas: AreaMap | None = None
    """Areas for train-to-train control."""
    line_radio: str | None = None
    secure: Credentials | None = None
    """Credentials of the train on a secured line."""
    note: str = ""
    """Note for the user before the start."""


def plan(options: argparse.Namespace, epoch_ns: int) -> DevicePlan:
    """Check the options. Raises SettingsError or BusError.

    A board without a memory uses the time of day as its boot count. The count must grow with each
    start; otherwise the wayside would refuse the messages of the new incarnation as out of order.
    """
    config = load_config(
        options.consist, cycle_ms=options.cycle_ms, law=options.ato, stage=options.output
    )
    line_options.check_radio(options)
    config = line_options.addressed(config, options)
    line = load_line(options.line).for_train(config.train.length_m)
    check_plausible(config, line)
    areas = line_options.areas_of(options, line)
    nvram = Nvram(options.nvram, NvramRecord(boot_count=epoch_ns // NS_PER_S))
    place = whereabouts(config, line, nvram, options.start, options.nvram)
    mission = _mission(line, place, options)
    bus = _bus(options.bus)
    name = parse_spec(bus).name
    tags, radio = options.tags, options.radio
    if tags == AUTO:
        tags = str(rendezvous.tags_link(name))
    if radio == AUTO and options.line_radio is not None:
        # On such a line the centre is part of the wayside.
        radio = options.line_radio
    elif radio == AUTO:
        radio = rendezvous.read_radio(name) or DEFAULT_ENDPOINT
    secure = line_options.credentials_of(options, config, epoch_ns)
    return DevicePlan(
        *(config, line, mission, nvram, place.start, bus, tags, radio, areas),
        line_radio=options.line_radio,
        secure=secure,
        note=place.note,
    )


def _mission(line: LineMap, place: Whereabouts, options: argparse.Namespace) -> Mission:
    try:
        return plan_mission(line, place.first, options.end, options.stops)
    except SettingsError as error:
        # The mission may not be possible from the place in the memory.
        raise SettingsError("; ".join(filter(None, (str(error), place.note)))) from error


def _bus(wanted: str) -> str:
    if wanted != AUTO:
        return wanted
    choice = resolve_auto()
    if choice.spec is None:
        raise BusError(f"no bus: {choice.reason}; `vcan up` makes one")
    return choice.spec


def _cycle_ms(text: str) -> float:
    return _number(text, CYCLE_MS_MIN, CYCLE_MS_MAX)


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


def _seconds(text: str) -> float:
    return _number(text, 0.0, 1e9)


def _number(text: str, least: float, most: float) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not least <= value <= most:
        raise argparse.ArgumentTypeError(f"{text} is not a number in {least:g}..{most:g}")
    return value


def _priority(text: str) -> int:
    if not text.isdecimal() or int(text) > PRIORITY_MAX:
        raise argparse.ArgumentTypeError(f"{text} is not a whole number in 0..{PRIORITY_MAX}")
    return int(text)
