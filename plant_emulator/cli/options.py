"""The command line of `plant`."""

import argparse
from typing import Final

from firmware_py.command_line import CommandParser
from plant_emulator.cli.names import (
    BY_HAND,
    DRIVERS,
    LAST_TRAIN,
    LINE_ENDPOINT,
    MODES,
    TIMERS,
    WAYSIDE_ENDPOINT,
)

AUTO: Final = "auto"
INSECURE: Final = "allow a line without certificates at an address that other machines reach"
PARTS: Final = ("all", "router", "track", *[f"arbiter{n}" for n in range(1, 6)])
"""Parts of a wayside that can be programs of their own."""
PRIORITY: Final = 70
"""Real-time priority, below the controller's: a train may be a little late, the controller may
not."""
PRIORITY_MAX: Final = 99

DESCRIPTION: Final = "A train without a controller, on a bus, a serial line and a radio."
EPILOG: Final = """\
The train stands braked until a controller sends commands. The plant ends with Ctrl-C, or with the
process that started it.
exit codes: 0 ended by SIGTERM or after --duration; 1 the plant failed; 2 wrong usage or
configuration; 3 bus, serial line, radio or disk missing; 130 ended by Ctrl-C
"""


DESK_EPILOG: Final = """\
Without --play and --driver you drive by keyboard, and the terminal shows the desk; q leaves it.
The train brakes when the desk stops sending. Recordings are described in docs/guide/desk.md.
exit codes: 0 left, or after --duration; 1 it failed; 2 wrong usage or a recording that cannot be
played; 3 bus or terminal missing, or another desk on the bus
"""
ELSEWHERE: Final = ("external", "none")


def parser() -> argparse.ArgumentParser:
    """Return the parser of `plant` and its verbs."""
    top: argparse.ArgumentParser = CommandParser(
        prog="plant", is_command=True, description=DESCRIPTION
    )
    verbs = top.add_subparsers(dest="verb", required=True, metavar="VERB")
    verbs.add_parser("consists", help="list the trains that ship with the plant")
    plant = verbs.add_parser(
        "run",
        help="serve a train in real time",
        description="Serve a train and its wayside in real time, for a controller that connects.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    _add_train(plant.add_argument_group("the train and its line"))
    _add_wires(plant.add_argument_group("the wires"))
    _add_faults(plant.add_argument_group("faults"))
    _add_line(plant.add_argument_group("trains that command themselves"))
    _add_trains(plant.add_argument_group("several trains on one line"))
    plant.add_argument(
        "--wayside",
        action="store_true",
        help="serve the wayside of a line instead of a train, with the options of `plant wayside`",
    )
    _add_desk(verbs)
    _add_wayside(verbs)
    return top


def _add_line(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--line-radio",
        metavar="ENDPOINT",
        help="report the train's place to the axle counters of `plant wayside` there",
    )
    group.add_argument("--secure", metavar="FOLDER", help="certificates of a secured line")
    group.add_argument("--insecure", action="store_true", help=INSECURE)
    group.add_argument("--train", type=_train, default=1, metavar="N", help="number of the train")


def _add_trains(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--trains",
        type=_train,
        metavar="N",
        help="serve this many trains, each on its own bus (default: embedded:train#), "
        "on the network of the line, whose timetable gives their places",
    )
    group.add_argument(
        "--supply", metavar="NAME|FILE", help="network: strong, weak; default: that of the line"
    )
    group.add_argument(
        "--traffic", metavar="NAME|FILE", help="trains, headway, dwells; default: that of the line"
    )


def _add_wayside(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    wayside = verbs.add_parser(
        "wayside",
        help="serve the wayside of a line whose trains command themselves",
        description="Serve arbiters, objects, axle counters and centre of a line whose trains "
        "command themselves, in real time, and print each grant of an area.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    wayside.add_argument("--line", default="loop", metavar="NAME|FILE", help="default: loop")
    wayside.add_argument(
        "--routes",
        type=_routes,
        metavar="A,B,...",
        help="the line is a network, and trains run over these of its routes: each is a line of "
        "masters, and the interlocking sets the routes",
    )
    wayside.add_argument(
        "--line-radio", default=LINE_ENDPOINT, metavar="ENDPOINT", help="default: %(default)s"
    )
    wayside.add_argument(
        "--secure", metavar="FOLDER", help="certificates and keys; see `vobc demo-ca`"
    )
    wayside.add_argument("--insecure", action="store_true", help=INSECURE)
    wayside.add_argument(
        "--part",
        choices=PARTS,
        default="all",
        help="serve only this part; the others are programs of their own, and all but the router "
        "connect to the router at --line-radio; default: all in one",
    )
    wayside.add_argument("--line-timers", choices=list(TIMERS), default="A")
    wayside.add_argument("--arbiters", type=int, choices=(1, 3, 5), default=1)
    wayside.add_argument(
        "--priority",
        type=_priority,
        default=0,
        metavar="0..99",
        help="SCHED_FIFO where the rights allow it; 0, the default: none",
    )
    wayside.add_argument("--parent", type=int, metavar="PID", help="end when that process ends")
    wayside.add_argument(
        "--memory", metavar="FOLDER", help="folder for data that must survive a power cut"
    )
    wayside.add_argument(
        "--duration",
        dest="duration_s",
        type=_seconds,
        metavar="SECONDS",
        help="end after this time",
    )


def _routes(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


def _add_train(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--line", metavar="NAME|FILE", help="default: florence; changping with --trains"
    )
    group.add_argument(
        "--consist",
        metavar="NAME|FILE",
        help="see `plant consists`; default: florence4, with --trains that of the line",
    )
    group.add_argument("--seed", type=_seed, default=1, help="seed of all noise; default: 1")
    group.add_argument(
        "--load-ratio",
        type=_ratio,
        metavar="0..1",
        help="load by passengers; default: that of the consist",
    )
    group.add_argument(
        "--odometer-error",
        type=_odometer_error,
        metavar="RATIO",
        help="fixed error instead of a random one; 0.05 counts 5 %% too much",
    )
    group.add_argument(
        "--from",
        dest="start",
        metavar="STATION",
        help="station where it starts; default: the first",
    )
    group.add_argument(
        "--to", dest="end", metavar="STATION", help="station to which it may run; default: the last"
    )
    group.add_argument(
        "--desk",
        choices=[*MODES, *ELSEWHERE],
        default="auto",
        help="mode of the desk; external: `plant desk` is the desk, none: no desk; default: auto",
    )
    group.add_argument("--driver", choices=list(DRIVERS), help="a driver model drives")
    group.add_argument(
        "--desk-recording",
        metavar="FILE",
        help="recording to replay at the desk, see docs/guide/desk.md",
    )


def _add_desk(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    desk = verbs.add_parser(
        "desk",
        help="drive a train by hand",
        description="Serve the driver's desk of a train whose plant runs with --desk external.",
        epilog=DESK_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    desk.add_argument(
        "--bus",
        default=AUTO,
        metavar="SPEC",
        help="auto, socketcan:vcan0, embedded:vcan0; default: auto",
    )
    who = desk.add_mutually_exclusive_group()
    who.add_argument("--play", metavar="FILE", help="a recording drives instead of the keyboard")
    who.add_argument("--driver", choices=list(DRIVERS), help="a driver model drives")
    who.add_argument(
        "--keys", metavar="FILE", help="take the keys from a file that grows, one name a line"
    )
    desk.add_argument("--parent", type=int, metavar="PID", help="end when that process ends")
    desk.add_argument("--record", metavar="FILE", help="record the desk, for --play")
    desk.add_argument(
        "--mode",
        choices=list(MODES),
        default="manual",
        help="initial position of the key; default: manual",
    )
    desk.add_argument(
        "--duration",
        dest="duration_s",
        type=_seconds,
        metavar="SECONDS",
        help="end after this time",
    )


def _add_wires(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--bus",
        default=AUTO,
        metavar="SPEC",
        help="auto, socketcan:vcan0, embedded:vcan0; default: auto",
    )
    group.add_argument(
        "--tags",
        default=AUTO,
        metavar="DEVICE",
        help="serial line of the tag reader; auto: a new pseudo-terminal",
    )
    group.add_argument(
        "--radio",
        default=AUTO,
        metavar="ENDPOINT",
        help=f"endpoint of this train's wayside; auto: {WAYSIDE_ENDPOINT}, or a free port; "
        "with --line-radio none, because the line's wayside answers",
    )
    group.add_argument("--out", metavar="FOLDER", help="folder for truth.csv and plant.json")
    group.add_argument(
        "--duration",
        dest="duration_s",
        type=_seconds,
        metavar="SECONDS",
        help="end after this time",
    )
    group.add_argument(
        "--priority",
        type=_priority,
        default=PRIORITY,
        metavar="0..99",
        help=f"SCHED_FIFO where the rights allow it; 0: none; default: {PRIORITY}",
    )
    group.add_argument("--parent", type=int, metavar="PID", help="end when that process ends")


def _add_faults(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--faults",
        metavar="FILE",
        help="scenario file; its [[fault]] tables are applied, the rest is ignored",
    )
    group.add_argument(
        "--by-hand",
        nargs="+",
        choices=BY_HAND,
        default=(),
        metavar="WHAT",
        help="desk, faults or both: take keys and acts from files that grow in the folder --out, "
        "and record them there; see docs/guide/watch.md",
    )
    group.add_argument(
        "--truth-feed",
        metavar="PATH",
        help="Unix datagram socket that receives the truth at every step and changes of faults",
    )


def _number(text: str, least: float, most: float) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not least <= value <= most:
        raise argparse.ArgumentTypeError(f"{text} is not a number in {least:g}..{most:g}")
    return value


def _ratio(text: str) -> float:
    return _number(text, 0.0, 1.0)


def _odometer_error(text: str) -> float:
    return _number(text, -0.2, 0.2)


def _seconds(text: str) -> float:
    return _number(text, 0.0, 1.0e9)


def _whole(text: str, most: int) -> int:
    if not (text.isascii() and text.isdecimal()) or int(text) > most:
        raise argparse.ArgumentTypeError(f"{text} is not a whole number in 0..{most}")
    return int(text)


def _seed(text: str) -> int:
    return _whole(text, 2**63 - 1)


def _train(text: str) -> int:
    number = text.removeprefix("T")
    if not (number.isascii() and number.isdecimal()) or not 0 < int(number) <= LAST_TRAIN:
        raise argparse.ArgumentTypeError(f"{text} is not a train; write 1..{LAST_TRAIN}, or T1 ...")
    return int(number)


def _priority(text: str) -> int:
    return _whole(text, PRIORITY_MAX)
