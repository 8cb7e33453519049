"""Command-line options of trains that command themselves."""

import argparse
from typing import Final

from metro_hil.model.known_names import LAST_TRAIN, LINE_ENDPOINT, TIMERS

LINE_ARBITERS: Final = (1, 3, 5)
DEFAULT_ARBITERS: Final = 1
DEFAULT_TIMERS: Final = "A"


def add_options(run: argparse.ArgumentParser) -> None:
    """Add the options. Their default is None, because without --train none of them has a
    meaning."""
    group = run.add_argument_group(
        "trains that command themselves",
        "The wayside of the line is `plant wayside`; the train gets a bus of its own.",
    )
    group.add_argument("--train", type=train_number, metavar="TRAIN", help="such as T1")
    group.add_argument(
        "--line-radio", metavar="ENDPOINT", help=f"with --train; default: {LINE_ENDPOINT}"
    )
    group.add_argument(
        "--line-peer",
        nargs="?",
        const="",
        metavar="ENDPOINT",
        help="connect to other trains that have this option directly; they reach this one at "
        "ENDPOINT, by default the address on the way to the wayside and any port",
    )
    group.add_argument("--secure", metavar="FOLDER", help="certificates; see `vobc demo-ca`")
    add_insecure(group)
    group.add_argument(
        "--line-timers",
        choices=TIMERS,
        help=f"must be those of the wayside; default: {DEFAULT_TIMERS}",
    )
    group.add_argument(
        "--arbiters",
        type=int,
        choices=LINE_ARBITERS,
        help=f"number of arbiters of the wayside; default: {DEFAULT_ARBITERS}",
    )
    group.add_argument(
        "--memory",
        metavar="FOLDER",
        help="folder for the controller's place, terms and number of starts, which then also "
        "outlive the run; default: the run folder",
    )


def add_insecure(parser: argparse._ActionsContainer) -> None:
    parser.add_argument(
        "--insecure",
        action="store_true",
        help="allow a line without certificates at an address that other machines reach",
    )


def train_number(text: str) -> int:
    """Parse `T3` or `3`, for argparse."""
    number = text.removeprefix("T")
    if not (number.isascii() and number.isdecimal()) or not 0 < int(number) <= LAST_TRAIN:
        raise argparse.ArgumentTypeError(f"{text} is no train; they are 1..{LAST_TRAIN}, or T1 ...")
    return int(number)
