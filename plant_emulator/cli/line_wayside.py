"""`plant wayside`: arbiters, objects and axle counters of a line whose trains command
themselves.
"""

import argparse
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Final, TypeVar

from firmware_py.clock.clock import WallClock
from firmware_py.clock.executive import Executive, Task, run
from firmware_py.clock.realtime import collect_garbage, die_with_parent, enter_realtime
from firmware_py.interrupts import Interrupts
from firmware_py.ports import RadioPort
from firmware_py.radio.credentials import load_arbiter_signing_keys, load_credentials
from firmware_py.radio.line_keys import line_keys
from firmware_py.radio.zenoh_radio import SessionRole, open_radio
from firmware_py.settings import SettingsError
from firmware_py.storage.checked_store import CheckedStore
from firmware_py.storage.nvram import NvramState
from firmware_py.trackdb import load_line
from firmware_py.trackdb.areas import AreaMap, load_areas
from firmware_py.trackdb.version import database_version
from plant_emulator.cli.words import say
from plant_emulator.wayside.detection import Detection, Place, key_of, packed, subscription
from plant_emulator.wayside.line_centre import LineCentre
from plant_emulator.wayside.line_wayside import Disks, LineWayside, WaysideTruth
from plant_emulator.wayside.t2t_vocabulary import ArbiterMemory, CentreMemory, ObjectMemory
from plant_emulator.world import World
from zenoh_config.secured import WAYSIDE_NAME, train_name
from zenoh_config.sessions import check_secured
from zenoh_config.t2t import FIRST_ARBITER
from zenoh_config.term_grants import GrantSigner
from zenoh_config.timers import TIMER_SETS

ALL: Final = "all"
ROUTER: Final = "router"
TRACK: Final = "track"
ARBITER: Final = "arbiter"
BEAT_MS: Final = 5.0
FEED_MS: Final = 20.0
DOORS_MS: Final = 10.0
GARBAGE_MS: Final = 1000.0
REFUSED_MS: Final = 1000.0
REFUSED_EVERY: Final = 10
"""Minimum number of checks between two reports of the same refusal reason."""
ORDERS_PER_S: Final = 10
"""Maximum orders per second to one train. Sequence numbers start from the time of day, so they
exceed those of earlier starts."""
ORDERS_SPAN_S: Final = 2**28
AXLES: Final = 16
INBOX_MESSAGES: Final = 8192
"""Maximum number of messages between two steps: each train reports its place 50 times a second."""
NS_PER_S: Final = 1_000_000_000
M = TypeVar("M")


def serve_line(options: argparse.Namespace) -> int:
    """Serve until asked to end and return the exit code.

    Raises SettingsError, RadioError, OSError.
    """
    if options.parent is not None:
        die_with_parent(options.parent)
    _check_secured(options)
    _check_part(options)
    areas = load_areas(options.line)
    ending = Interrupts()
    with ending.caught(), ExitStack() as stack:
        clock = WallClock()
        device = _Line(options, areas, clock, stack)
        tasks = [Task("line", BEAT_MS, device.beat), Task("doors", DOORS_MS, device.doors)]
        tasks.append(Task("refused", REFUSED_MS, device.refused))
        if options.priority:
            enter_realtime(options.priority)
            tasks.append(Task("garbage", GARBAGE_MS, collect_garbage, offset_ms=GARBAGE_MS))
        end_ns = None
        if options.duration_s is not None:
            end_ns = clock.now_ns() + round(options.duration_s * NS_PER_S)
        what = "wayside" if options.part == ALL else options.part
        say(f"{what} of {areas.name}: {len(areas.areas)} areas, {options.line_radio}")
        run(
            [Executive(tasks, clock.now_ns())],
            clock,
            lambda now_ns: ending.asked or (end_ns is not None and now_ns >= end_ns),
        )
    return ending.exit_code


class _Line:
    def __init__(
        self, options: argparse.Namespace, areas: AreaMap, clock: WallClock, stack: ExitStack
    ) -> None:
        folder = None if options.memory is None else Path(options.memory)
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
        part, every = options.part, range(FIRST_ARBITER, FIRST_ARBITER + options.arbiters)
        serves_track = part in (ALL, TRACK)
        arbiters = {
            address: CheckedStore(folder and folder / f"arbiter{address}", ArbiterMemory)
            for number, address in enumerate(every, start=1)
            if part in (ALL, f"{ARBITER}{number}")
        }
        objects = {
            site.number: CheckedStore(folder and folder / f"object{site.number}", ObjectMemory)
            for site in areas.objects
            if serves_track
        }
        boot, secure = clock.epoch_ns() // NS_PER_S, None
        listens = part in (ALL, ROUTER)
        if options.secure is not None:
            name = WAYSIDE_NAME if listens else part
            secure = load_credentials(options.secure, name, clock.epoch_ns(), listens=listens)
        key = line_keys(secure)
        decrees_path = folder and folder / "decrees" if serves_track else None
        decrees = CheckedStore(decrees_path, CentreMemory)
        line = load_line(options.line)
        centre = LineCentre(
            line,
            boot=boot,
            memory=_readable(decrees, CentreMemory()),
            first_sequence=boot % ORDERS_SPAN_S * ORDERS_PER_S,
            key=key,
        )
        disks = Disks(
            {a: _found(each, ArbiterMemory(boot)) for a, each in arbiters.items()},
            {n: _found(each, ObjectMemory(boot)) for n, each in objects.items()},
            lambda address, memory: arbiters[address].put(memory),
            lambda number, memory: objects[number].put(memory),
            decrees.put,
        )
        timers = TIMER_SETS[options.line_timers]
        self._wayside = LineWayside(
            *(timers, areas, disks),
            boot=boot,
            start_ns=clock.now_ns(),
            centre=centre if serves_track else None,
            key=key,
            database=database_version(line),
            arbiters=every,
            serves_track=serves_track,
            signers=_signers(options, arbiters),
        )
        self._centre = centre
        self._detection = Detection(areas)
        counters = (subscription(areas.name),) if serves_track else ()
        topics = () if part == ROUTER else (*self._wayside.subscriptions, *counters)
        self._port = open_radio(
            SessionRole.WAYSIDE if listens else SessionRole.TRAIN,
            options.line_radio,
            topics,
            clock,
            inbox_messages=INBOX_MESSAGES,
            secure=secure,
        )
        stack.callback(self._port.close)
        self._masters: dict[tuple[int, int], tuple[int, int]] = {}
        """Holder and term, by arbiter and area."""
        self._failed = 0
        self._refused = RefusalNotes()

    def beat(self, now_ns: int) -> None:
        heard = self._detection.on_message(self._port.receive(now_ns))
        truth = WaysideTruth(self._detection.axles() if heard else {}, self._detection.occupied())
        for key, payload in self._wayside.step(now_ns, heard, truth):
            self._port.send(now_ns, key, payload)
        self._print_grants()

    def refused(self, now_ns: int) -> None:
        """Report refused messages, so that a wrongly configured line becomes visible."""
        for words in self._refused.looks(self._wayside.refused(), self._wayside.sources):
            say(words)

    def doors(self, now_ns: int) -> None:
        self._centre.step_doors(now_ns)

    def _print_grants(self) -> None:
        """Print each grant when it changes."""
        for address, arbiter in self._wayside.arbiters.items():
            for lease in arbiter.memory.areas:
                now = (lease.holder, lease.promised)
                if self._masters.get((address, lease.area)) != now:
                    self._masters[address, lease.area] = now
                    say(
                        f"arbiter {address}: area {lease.area} to train {lease.holder}, "
                        f"term {lease.promised}"
                    )
        for who in self._wayside.failed[self._failed :]:
            say(f"{who} is silent from now on: its memory cannot be written")
        self._failed = len(self._wayside.failed)


def _signers(options: argparse.Namespace, arbiters: Iterable[int]) -> dict[int, GrantSigner] | None:
    """Return what signs the grants of each served arbiter; None on a line that is not secured.

    Raises SettingsError.
    """
    if options.secure is None:
        return None
    numbers = [address - FIRST_ARBITER + 1 for address in arbiters]
    keys = load_arbiter_signing_keys(options.secure, numbers)
    return {FIRST_ARBITER + number - 1: GrantSigner(key) for number, key in keys.items()}


class RefusalNotes:
    """Reports each refusal reason when it first appears, and then periodically with its count."""

    def __init__(self) -> None:
        self._looks = 0
        self._reported: dict[str, tuple[int, int]] = {}
        """Count and number of the check at the last report, by reason."""

    def looks(
        self, counts: Mapping[str, int], sources: Mapping[str, str] | None = None
    ) -> list[str]:
        """Return the lines to report now; counts only grow.

        Args:
            sources: name of the last sender, by reason.
        """
        self._looks += 1
        said = []
        for reason, count in counts.items():
            before, at = self._reported.get(reason, (0, -REFUSED_EVERY))
            if count > before and self._looks - at >= REFUSED_EVERY:
                self._reported[reason] = (count, self._looks)
                more = count - before
                last = "" if sources is None else f"; the last from {sources.get(reason, '?')}"
                said.append(f"refused: {more} message{'s' if more > 1 else ''}, {reason}{last}")
        return said


def _readable(store: CheckedStore[M], fresh: M) -> M:
    """Read the stored commands.

    Raises SettingsError if they are unreadable, because a command must not be forgotten.
    """
    found = _found(store, fresh)
    if found is None:
        raise SettingsError(f"{store.detail}; remove the file and give the commands again")
    return found


def _found(store: CheckedStore[M], fresh: M) -> M | None:
    """Return the stored memory, a fresh one if none exists, or None if it is unreadable."""
    if store.state is NvramState.ABSENT:
        return fresh
    if store.value is None:
        say(store.detail)
    return store.value


def _check_part(options: argparse.Namespace) -> None:
    """Raise SettingsError for a part that the line does not have."""
    part = options.part
    if part.startswith(ARBITER) and int(part.removeprefix(ARBITER)) > options.arbiters:
        raise SettingsError(f"--part {part}: the line has --arbiters {options.arbiters}")


def _check_secured(options: argparse.Namespace) -> None:
    """Raise SettingsError if others can reach a line that is not secured."""
    try:
        check_secured(
            options.line_radio, secured=options.secure is not None, insecure=options.insecure
        )
    except ValueError as error:
        raise SettingsError(f"--line-radio {error}") from error


def feed_of(
    options: argparse.Namespace, line_name: str, world: World, clock: WallClock, stack: ExitStack
) -> Executive:
    """Return the executive that reports the train's true place to the line's axle counters."""
    _check_secured(options)
    secure = None
    if options.secure is not None:
        secure = load_credentials(options.secure, train_name(options.train), clock.epoch_ns())
    port: RadioPort = open_radio(SessionRole.TRAIN, options.line_radio, (), clock, secure=secure)
    stack.callback(port.close)
    key = key_of(line_name, options.train)

    def tell(now_ns: int) -> None:
        place = Place(world.front_m, world.front_m - world.length_m, AXLES, now_ns)
        port.send(now_ns, key, packed(place))

    return Executive([Task("rails", FEED_MS, tell)], clock.now_ns())
