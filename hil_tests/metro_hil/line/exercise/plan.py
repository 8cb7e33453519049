"""What a run of a line is to be: which trains go where, and what goes wrong when."""

import argparse
import enum
from dataclasses import dataclass
from typing import Final, NamedTuple

from firmware_py.trackdb import LineMap
from zenoh_config.t2t import LAST_TRAIN, NOBODY

AHEAD: Final = 2
"""Stations that each train goes on."""


class PlannedRun(NamedTuple):
    """Where a train starts and where it goes, by the names of stations."""

    start: str
    end: str


def ways_of(line: LineMap, trains: int) -> list[PlannedRun]:
    """One train at each station, the foremost first. Raises ValueError where there are too few."""
    stations = [each.name for each in line.stations]
    room = len(stations) - AHEAD
    if not 1 <= trains <= room:
        raise ValueError(
            f"--trains {trains}: the line {line.name} has room for 1 to {room}, each at a station "
            f"with two more ahead of the foremost"
        )
    return [
        PlannedRun(stations[at], stations[at + AHEAD])
        for at in range(room - 1, room - 1 - trains, -1)
    ]


class Strike(enum.Enum):
    """What goes wrong. The value is the option's name."""

    KILL_MASTER = "kill-master-at"
    """SIGKILL for the controller of the train that commands the rearmost area; it comes back."""
    STOP_MASTER = "stop-master-at"
    """SIGSTOP for it; it goes on where it was."""
    CUT_MASTER = "cut-master-at"
    """Its radio carries nothing either way."""
    MUTE_MASTER = "mute-master-at"
    """Nothing that it sends comes through; what is sent to it does."""
    DEAFEN_MASTER = "deafen-master-at"
    """Nothing that is sent to it comes through; what it sends does."""
    CRASH_WAYSIDE = "crash-arbiter-at"
    """SIGKILL for the wayside with all arbiters; it comes back."""
    RESTART_TRAIN = "restart-train-at"
    """SIGTERM for the controller of one train; it comes back."""


HELP: Final = {
    Strike.KILL_MASTER: "kill -9 the controller of the train that commands the rearmost area",
    Strike.STOP_MASTER: "SIGSTOP it",
    Strike.CUT_MASTER: "cut its radio both ways",
    Strike.MUTE_MASTER: "let nothing through that it sends; it gets a network of its own",
    Strike.DEAFEN_MASTER: "let nothing through that is sent to it; likewise",
    Strike.CRASH_WAYSIDE: "kill -9 the wayside, arbiters and all",
    Strike.RESTART_TRAIN: "end the controller of a train, such as T3@20",
}


ONE_WAY: Final = (Strike.MUTE_MASTER, Strike.DEAFEN_MASTER)
"""What takes networks of their own."""


@dataclass(frozen=True, slots=True)
class Fault:
    strike: Strike
    at_s: float
    train: int = NOBODY
    """Only for RESTART_TRAIN."""


def second(text: str) -> float:
    """An instant of the run, for argparse."""
    try:
        at_s = float(text)
    except ValueError:
        at_s = -1.0
    if not 0.0 < at_s < 1e6:
        raise argparse.ArgumentTypeError(f"{text} is not a number of seconds")
    return at_s


def train_at(text: str) -> tuple[int, float]:
    """`T3@20`, for argparse."""
    train, at, seconds = text.removeprefix("T").partition("@")
    if not at or not (train.isascii() and train.isdecimal()) or not 0 < int(train) <= LAST_TRAIN:
        raise argparse.ArgumentTypeError(f"{text} is no train and second, such as T3@20")
    return int(train), second(seconds)


def faults_of(options: argparse.Namespace) -> list[Fault]:
    """In the order in which they strike."""
    faults = []
    for strike in Strike:
        for each in getattr(options, strike.value.replace("-", "_")) or ():
            if strike is Strike.RESTART_TRAIN:
                faults.append(Fault(strike, each[1], each[0]))
            else:
                faults.append(Fault(strike, each))
    return sorted(faults, key=lambda each: each.at_s)
