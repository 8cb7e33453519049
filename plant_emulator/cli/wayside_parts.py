"""The parts of one line's wayside that a program serves, with their memories on disk."""

import argparse
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Final, TypeVar

from firmware_py.clock.clock import WallClock
from firmware_py.radio.credentials import (
    Credentials,
    load_arbiter_signing_keys,
    load_credentials,
)
from firmware_py.radio.line_keys import line_keys
from firmware_py.settings import SettingsError
from firmware_py.storage.checked_store import CheckedStore
from firmware_py.storage.nvram import NvramState
from firmware_py.trackdb import LineMap
from firmware_py.trackdb.areas import AreaMap
from firmware_py.trackdb.version import database_version
from plant_emulator.cli.words import say
from plant_emulator.wayside.line_centre import LineCentre
from plant_emulator.wayside.line_wayside import Disks, LineWayside
from plant_emulator.wayside.t2t_vocabulary import ArbiterMemory, CentreMemory, ObjectMemory
from zenoh_config.secured import WAYSIDE_NAME
from zenoh_config.t2t import FIRST_ARBITER
from zenoh_config.term_grants import GrantSigner
from zenoh_config.timers import TIMER_SETS

ALL: Final = "all"
ROUTER: Final = "router"
TRACK: Final = "track"
ARBITER: Final = "arbiter"
ORDERS_PER_S: Final = 10
"""Maximum orders per second to one train. Sequence numbers start from the time of day, so they
exceed those of earlier starts."""
ORDERS_SPAN_S: Final = 2**28
REFUSED_EVERY: Final = 10
"""Minimum number of checks between two reports of the same refusal reason."""
NS_PER_S: Final = 1_000_000_000
M = TypeVar("M")


def credentials_of(options: argparse.Namespace, clock: WallClock) -> Credentials | None:
    """Credentials of the program on a secured line; None on another. Raises SettingsError."""
    if options.secure is None:
        return None
    listens = options.part in (ALL, ROUTER)
    name = WAYSIDE_NAME if listens else options.part
    return load_credentials(options.secure, name, clock.epoch_ns(), listens=listens)


class LineParts:
    """Arbiters, objects, track and centre of one line, or those that the program serves."""

    def __init__(
        self,
        options: argparse.Namespace,
        areas: AreaMap,
        line: LineMap,
        folder: Path | None,
        clock: WallClock,
        secure: Credentials | None,
    ) -> None:
        """Args:
        folder: of the memories; None: they are lost at the end.

        Raises SettingsError.
        """
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
        boot, key = clock.epoch_ns() // NS_PER_S, line_keys(secure)
        decrees_path = folder and folder / "decrees" if serves_track else None
        decrees = CheckedStore(decrees_path, CentreMemory)
        self.centre = LineCentre(
            line,
            boot=boot,
            memory=readable(decrees, CentreMemory()),
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
        self.wayside = LineWayside(
            *(TIMER_SETS[options.line_timers], areas, disks),
            boot=boot,
            start_ns=clock.now_ns(),
            centre=self.centre if serves_track else None,
            key=key,
            database=database_version(line),
            arbiters=every,
            serves_track=serves_track,
            signers=_signers(options, arbiters),
        )
        self._masters: dict[tuple[int, int], tuple[int, int]] = {}
        """Holder and term, by arbiter and area."""
        self._failed = 0
        self._refused = RefusalNotes()

    def print_refused(self, where: str = "") -> None:
        """Print refused messages, so that a wrongly configured line becomes visible."""
        for words in self._refused.looks(self.wayside.refused(), self.wayside.sources):
            say(f"{where}{words}")

    def print_grants(self, where: str = "") -> None:
        """Print each grant when it changes.

        Args:
            where: text before the area, such as the name of its line.
        """
        for address, arbiter in self.wayside.arbiters.items():
            for lease in arbiter.memory.areas:
                now = (lease.holder, lease.promised)
                if self._masters.get((address, lease.area)) != now:
                    self._masters[address, lease.area] = now
                    say(
                        f"arbiter {address}: {where}area {lease.area} to train {lease.holder}, "
                        f"term {lease.promised}"
                    )
        for who in self.wayside.failed[self._failed :]:
            say(f"{who} is silent from now on: its memory cannot be written")
        self._failed = len(self.wayside.failed)


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


def _signers(options: argparse.Namespace, arbiters: Iterable[int]) -> dict[int, GrantSigner] | None:
    """Return what signs the grants of each served arbiter; None on a line that is not secured.

    Raises SettingsError.
    """
    if options.secure is None:
        return None
    numbers = [address - FIRST_ARBITER + 1 for address in arbiters]
    keys = load_arbiter_signing_keys(options.secure, numbers)
    return {FIRST_ARBITER + number - 1: GrantSigner(key) for number, key in keys.items()}


def readable(store: CheckedStore[M], fresh: M) -> M:
    """Read a memory that must not be forgotten.

    Raises SettingsError if it is unreadable.
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
