"""The plan of a line's run: which trains go where, and which faults strike when."""

import argparse
import enum
from dataclasses import dataclass
from typing import Final, NamedTuple

from firmware_py.trackdb import LineMap
from zenoh_config.t2t import LAST_TRAIN, NO_TRAIN

AHEAD: Final = 2
"""Number of stations from the start of each train to its end."""


class PlannedRun(NamedTuple):
    """Start and end of a train's run, as names of stations."""

    start: str
    end: str


def ways_of(line: LineMap, trains: int) -> list[PlannedRun]:
    """Return one train at each station, the foremost first.

    Raises ValueError for too many trains.
    """
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
    """Kinds of fault; the value is the name of the option."""

    KILL_MASTER = "kill-master-at"
    """SIGKILL for the controller that commands the rearmost area; it is started again."""
    STOP_MASTER = "stop-master-at"
    """SIGSTOP for that controller; it continues later."""
    CUT_MASTER = "cut-master-at"
    """Cut its radio in both directions."""
    MUTE_MASTER = "mute-master-at"
    """Lose all messages that it sends; it still receives."""
    DEAFEN_MASTER = "deafen-master-at"
    """Lose all messages to it; it still sends."""
    CRASH_WAYSIDE = "crash-arbiter-at"
    """SIGKILL for the wayside with all arbiters; it is started again."""
    RESTART_TRAIN = "restart-train-at"
    """SIGTERM for the controller of one train; it is started again."""


HELP: Final = {
    Strike.KILL_MASTER: "kill -9 the controller of the train that commands the rearmost area",
    Strike.STOP_MASTER: "stop that controller with SIGSTOP",
    Strike.CUT_MASTER: "cut the radio of that train both ways",
    Strike.MUTE_MASTER: "lose all that the master sends; controllers get own networks",
    Strike.DEAFEN_MASTER: "lose all that is sent to the master; likewise",
    Strike.CRASH_WAYSIDE: "kill -9 the wayside, arbiters and all",
    Strike.RESTART_TRAIN: "end the controller of a train, such as T3@20",
}


CUTS: Final = {
    Strike.CUT_MASTER: ("cut", "is cut"),
    Strike.MUTE_MASTER: ("mute", "lets nothing out"),
    Strike.DEAFEN_MASTER: ("deafen", "lets nothing in"),
}
"""Order to what carries the radio, and text for the event log."""
ONE_WAY: Final = (Strike.MUTE_MASTER, Strike.DEAFEN_MASTER)
"""Faults that need network namespaces for the controllers."""


@dataclass(frozen=True, slots=True)
class Fault:
    strike: Strike
    at_s: float
    train: int = NO_TRAIN
    """Only for RESTART_TRAIN."""


def second(text: str) -> float:
    """Parse an instant of the run, for argparse."""
    try:
        at_s = float(text)
    except ValueError:
        at_s = -1.0
    if not 0.0 < at_s < 1e6:
        raise argparse.ArgumentTypeError(f"{text} is not a number of seconds")
    return at_s


def train_at(text: str) -> tuple[int, float]:
    """Parse a train and an instant such as `T3@20`, for argparse."""
    train, at, seconds = text.removeprefix("T").partition("@")
    if not at or not (train.isascii() and train.isdecimal()) or not 0 < int(train) <= LAST_TRAIN:
        raise argparse.ArgumentTypeError(f"{text} is not a train and a second, such as T3@20")
    return int(train), second(seconds)


def faults_of(options: argparse.Namespace) -> list[Fault]:
    """Return the faults in the order in which they strike."""
    faults = []
    for strike in Strike:
        for each in getattr(options, strike.value.replace("-", "_")) or ():
            if strike is Strike.RESTART_TRAIN:
                faults.append(Fault(strike, each[1], each[0]))
            else:
                faults.append(Fault(strike, each))
    return sorted(faults, key=lambda each: each.at_s)
