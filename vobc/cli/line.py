"""Command line, radio session and memory of a train in train-to-train control."""

import argparse
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Final

from firmware_py.clock.clock import WallClock
from firmware_py.radio.credentials import Credentials, load_arbiter_keys, load_credentials
from firmware_py.radio.line_keys import line_keys
from firmware_py.radio.recorded_radio import LaterRecordedRadio
from firmware_py.radio.zenoh_radio import SessionRole, ZenohRadio, open_peer, open_radio
from firmware_py.settings import SettingsError
from firmware_py.storage.checked_store import CheckedStore
from firmware_py.storage.nvram import NvramState
from firmware_py.storage.recorder import RadioLog
from firmware_py.trackdb import LineMap
from firmware_py.trackdb.areas import AreaMap, load_areas
from firmware_py.trackdb.version import database_version
from vobc.config import VobcConfig
from vobc.process.line_command import LineCommand, commanded
from vobc.process.line_silence import LineSilence
from vobc.train_to_train.train import TrainCore
from vobc.train_to_train.vocabulary import T2tConfig, TrainMemory
from vobc.wire.line_radio import LineRadio
from zenoh_config import t2t_keys
from zenoh_config.secured import train_name
from zenoh_config.sessions import check_secured
from zenoh_config.t2t import FIRST_ARBITER, LAST_TRAIN
from zenoh_config.term_grants import GrantCheck
from zenoh_config.timers import TIMER_SETS

AXLES: Final = 16
"""Number of axles of four cars."""
NS_PER_S: Final = 1_000_000_000
ANYWHERE: Final = ""
LINE_LOG: Final = "line.log"
"""File name in a run folder."""


def add(top: argparse.ArgumentParser) -> None:
    group = top.add_argument_group("train-to-train control")
    group.add_argument(
        "--line-radio",
        metavar="ENDPOINT",
        help="endpoint of the line's wayside; without it a zone controller commands the train",
    )
    group.add_argument(
        "--line-peer",
        nargs="?",
        const=ANYWHERE,
        metavar="ENDPOINT",
        help="talk to other such trains directly, not through the wayside; they reach this "
        "one at ENDPOINT; default: the address towards the wayside, any port",
    )
    group.add_argument(
        "--secure", metavar="FOLDER", help="certificates and keys; see `vobc demo-ca`"
    )
    group.add_argument(
        "--insecure",
        action="store_true",
        help="allow a line without certificates at an address that other machines reach",
    )
    group.add_argument(
        "--train", type=_address, metavar="N", help="address of the train on the radio"
    )
    group.add_argument(
        "--line-memory", metavar="FILE", help="file for terms and start counts that must survive"
    )
    group.add_argument(
        "--line-timers",
        choices=sorted(TIMER_SETS),
        default="A",
        help="set of timers; default: %(default)s",
    )
    group.add_argument(
        "--arbiters",
        type=_odd,
        default=1,
        metavar="1|3|5",
        help="number of arbiters of the line; default: 1",
    )


def addressed(config: VobcConfig, options: argparse.Namespace) -> VobcConfig:
    """Configuration with the given train address and the line's maximum age of authorities."""
    if options.train is not None:
        config = replace(config, address=options.train)
    if options.line_radio is not None:
        config = commanded(config, TIMER_SETS[options.line_timers])
    return config


def check_radio(options: argparse.Namespace) -> None:
    """Raises SettingsError for an invalid combination of options."""
    own = () if options.line_peer in (None, ANYWHERE) else (options.line_peer,)
    for endpoint in (*(() if options.line_radio is None else (options.line_radio,)), *own):
        try:
            check_secured(endpoint, secured=options.secure is not None, insecure=options.insecure)
        except ValueError as error:
            raise SettingsError(f"--line-radio {error}") from error
    if options.line_peer is None:
        return
    if options.line_radio is None:
        raise SettingsError("--line-peer: peers find each other at the wayside; --line-radio?")
    if options.secure is not None:
        raise SettingsError(
            "--line-peer: not with --secure: the wayside looks at who may say what, and what peers "
            "say to each other does not go through it"
        )


def areas_of(options: argparse.Namespace, line: LineMap) -> AreaMap | None:
    """Areas of the line. None: a zone controller commands the train. Raises SettingsError."""
    if options.line_radio is None:
        return None
    return reachable_areas(options.line, line)


def reachable_areas(name: str, line: LineMap) -> AreaMap:
    """Raises SettingsError for a line without areas, or if no authority reaches one of the
    stops.
    """
    areas, kept = load_areas(name), T2tConfig()
    if line.rollback_m > kept.rollback_m:
        raise SettingsError(
            f"line {line.name}: rollback_m {line.rollback_m:g} is more than the "
            f"{kept.rollback_m:g} m that trains which command themselves keep free behind a train"
        )
    room_m = kept.behind_axle_m
    for station in line.stations:
        if not areas.start_m <= station.stop_m <= areas.end_m - room_m:
            raise SettingsError(
                f"line {line.name}: station {station.name}: stop_m {station.stop_m:g} is out of "
                f"reach: its areas begin at {areas.start_m:g} m and end at {areas.end_m:g} m, and "
                f"no authority comes nearer to that end than {room_m:g} m"
            )
    return areas


def open_line(
    options: argparse.Namespace,
    config: VobcConfig,
    line: LineMap,
    areas: AreaMap,
    clock: WallClock,
    stack: ExitStack,
    secure: Credentials | None,
    log: RadioLog | None,
) -> LineCommand:
    """Open the session. The stack closes it and the log of its messages.

    Raises RadioError for an invalid endpoint. Without a memory file the time of day counts the
    starts, and acknowledged terms are lost at the end.
    """
    path = None if options.line_memory is None else Path(options.line_memory)
    store = CheckedStore(path, TrainMemory)
    memory = store.value
    if store.state is NvramState.ABSENT:
        memory = TrainMemory(boot=clock.epoch_ns() // NS_PER_S if path is None else 0)
    arbiters = tuple(range(FIRST_ARBITER, FIRST_ARBITER + options.arbiters))
    core = TrainCore(
        T2tConfig(
            timers=TIMER_SETS[options.line_timers],
            arbiters=arbiters,
            grants=None if secure is None else grant_check(options.secure, options.arbiters),
        ),
        areas,
        address=config.address,
        memory=memory,
        start_ns=clock.now_ns(),
    )
    key = line_keys(secure)
    radio = LineRadio(core, line.name, store.put, key=key, database=database_version(line))
    port = _port(options, radio, t2t_keys.token_of(line.name, config.address), clock, secure)
    silence = LineSilence(options.line_radio)
    if log is None:
        stack.callback(port.close)
        return LineCommand(radio, port, config, line, axles=AXLES, silence=silence)
    recorded = LaterRecordedRadio(port, log)
    stack.callback(recorded.close)
    return LineCommand(
        *(radio, recorded, config, line),
        axles=AXLES,
        write_down=recorded.write_down,
        silence=silence,
    )


def grant_check(folder: Path | str, arbiters: int) -> GrantCheck:
    """Checks the grants of the arbiters of a secured line, by the keys in a folder. Raises
    SettingsError.
    """
    keys = load_arbiter_keys(folder, arbiters)
    return GrantCheck({FIRST_ARBITER + number - 1: key for number, key in keys.items()})


def _port(
    options: argparse.Namespace,
    radio: LineRadio,
    token: str,
    clock: WallClock,
    secure: Credentials | None,
) -> ZenohRadio:
    if options.line_peer is None:
        return open_radio(
            *(SessionRole.TRAIN, options.line_radio, radio.subscriptions, clock),
            secure=secure,
            token=token,
        )
    listens_at = None if options.line_peer == ANYWHERE else options.line_peer
    return open_peer(options.line_radio, listens_at, radio.subscriptions, clock, token=token)


def credentials_of(
    options: argparse.Namespace, config: VobcConfig, epoch_ns: int
) -> Credentials | None:
    """Credentials of this train on a secured line. Raises SettingsError."""
    if options.secure is None:
        return None
    return load_credentials(options.secure, train_name(config.address), epoch_ns)


def _address(text: str) -> int:
    number = text.removeprefix("T")
    if not (number.isascii() and number.isdecimal()) or not 0 < int(number) <= LAST_TRAIN:
        raise argparse.ArgumentTypeError(
            f"{text} is not a train; trains are 1..{LAST_TRAIN}, or T1 ..."
        )
    return int(number)


def _odd(text: str) -> int:
    if text not in ("1", "3", "5"):
        raise argparse.ArgumentTypeError(f"{text} is not 1, 3 or 5")
    return int(text)
