"""The centre of a line whose trains command themselves: keeps what supervision decrees. Pure.

Decrees about trains go to them as the orders that answer each of their statuses; those about the
track go to the masters with what the track tells them. What is decreed is stored before it is
answered or acted on, and it stays until it is taken back.
"""

from collections import Counter
from collections.abc import Iterable
from dataclasses import replace
from typing import Final

from firmware_py.ports import RadioMessage
from firmware_py.trackdb import LineMap
from plant_emulator.wayside.centre import NORMAL, Centre
from plant_emulator.wayside.order_gate import OrderGate
from plant_emulator.wayside.platform_doors import PlatformDoors
from plant_emulator.wayside.t2t_vocabulary import CentreMemory, LeaseMemory, WaysideStepped
from zenoh_config.codec import BENCH_KEY
from zenoh_config.messages import (
    RESTRICTIONS_MAX,
    WAYSIDE,
    RefusedReason,
    SpeedRestriction,
    TrainStatus,
)
from zenoh_config.t2t import BROADCAST, LAST_TRAIN, NOBODY, ROSTER_MAX, SUPERVISION, T2tMessage
from zenoh_config.t2t_codec import LEASES_MAX, SILENT_MAX
from zenoh_config.t2t_supervision import (
    Decree,
    DecreeAnswer,
    DecreeKind,
    LeaseNote,
    LeaseReason,
    LineState,
    RosterPlace,
    TrainDecree,
)
from zenoh_config.timers import NS_PER_MS

TELL_NS: Final = 500 * NS_PER_MS
SILENT_NS: Final = 1000 * NS_PER_MS
DECREE_AGE_NS: Final = 3000 * NS_PER_MS
"""From what the desk heard of the line until its decree is heard here, at most."""
PASSED_M: Final = 20.0
"""So far beyond a stopping point a train has skipped it."""
NO_LIMIT_MPS: Final = 1.0
"""Stands with a closed stretch, whose limit means nothing."""
OF_TRACK: Final = (DecreeKind.RESTRICT, DecreeKind.LIFT, DecreeKind.CLOSE, DecreeKind.OPEN)
CHANGES: Final = {
    DecreeKind.HOLD: ("hold", True),
    DecreeKind.LET_GO: ("hold", False),
    DecreeKind.SKIP: ("skip", True),
    DecreeKind.CALL: ("skip", False),
    DecreeKind.EMERGENCY: ("emergency", True),
    DecreeKind.RELEASE: ("emergency", False),
}


class LineCentre:
    """Trains are known from their first status on, at most as many as an area has room for."""

    def __init__(
        self,
        line: LineMap,
        *,
        boot: int,
        memory: CentreMemory | None = None,
        first_sequence: int = 0,
        key: bytes = BENCH_KEY,
    ) -> None:
        """Args:
        first_sequence: of orders; above everything that was said before this start.
        memory: as it was stored.
        """
        self.memory = memory or CentreMemory()
        self.refusals: Counter[RefusedReason] = Counter()
        """Of statuses and decrees."""
        self.leases: dict[int, LeaseNote] = {}
        """By area, as arbiters were seen to grant them."""
        self._heard_ns: dict[int, int] = {}
        """By train: when it told its status last; before, when it was seen on a roster first."""
        self._rosters: dict[int, LeaseMemory] = {}
        """By area, where arbiters were seen to keep the newest roster."""
        self._line, self._boot, self._key = line, boot, key
        self._first_sequence = first_sequence
        self._gate = OrderGate(WAYSIDE)
        self._centres: dict[int, tuple[Centre, PlatformDoors]] = {}
        self._skipping_m: dict[int, float] = {}
        """By train: the stopping point that it is to pass."""
        self._statuses: dict[int, TrainStatus] = {}
        self._answered = (0, 0, DecreeAnswer.NONE)
        self._sequence = 0
        self._tell_ns = 0

    @property
    def restrictions(self) -> tuple[SpeedRestriction, ...]:
        return self.memory.restrictions

    @property
    def closed(self) -> tuple[SpeedRestriction, ...]:
        return self.memory.closed

    def answer(
        self, message: RadioMessage, status: TrainStatus, now_ns: int
    ) -> tuple[str, bytes] | None:
        """Key and payload of the orders to a train that tells its status."""
        train = status.train
        if train not in self._centres:
            if len(self._centres) >= ROSTER_MAX or train > LAST_TRAIN:
                self.refusals[RefusedReason.WRONG_SOURCE] += 1
                return None
            # Of their own for each train: a train asks for the doors that it stands at, and for
            # no others, and no two trains stand at one platform.
            doors = PlatformDoors(self._line)
            centre = Centre(self._line, doors, first_sequence=self._first_sequence, key=self._key)
            self._centres[train] = centre, doors
            self._tell_ns = 0
        centre, _ = self._centres[train]
        decreed = self._of(train)
        centre.standing = replace(
            NORMAL, hold=decreed.hold, skip_next=decreed.skip, emergency=decreed.emergency
        )
        centre.releases = decreed.releases
        answer = centre.answer(message, now_ns)
        if answer is not None:
            self._statuses[train] = status
            self._heard_ns[train] = now_ns
        return answer

    def step_doors(self, now_ns: int) -> None:
        """Every 10 ms: platform doors move."""
        for _, doors in self._centres.values():
            doors.step(now_ns)

    def step(self, now_ns: int, heard: Iterable[T2tMessage]) -> WaysideStepped[CentreMemory]:
        """What is decreed from now on is in `restrictions`, `closed` and in the next orders."""
        before, answered = self.memory, self._answered
        for message in heard:
            if isinstance(message, Decree):
                self._on_message(message, now_ns)
        self._end_skips()
        changed = self.memory is not before
        if not changed and self._answered == answered and now_ns < self._tell_ns:
            return WaysideStepped(None, ())
        self._tell_ns = now_ns + TELL_NS
        return WaysideStepped(self.memory if changed else None, (self._state(now_ns),))

    def not_stored(self, before: CentreMemory, now_ns: int) -> LineState:
        """Take back what the disk did not take, and say so."""
        self.memory = before
        boot, sequence, _ = self._answered
        self._answered = (boot, sequence, DecreeAnswer.NOT_STORED)
        return self._state(now_ns)

    def granted(self, before: LeaseMemory | None, now: LeaseMemory, now_ns: int) -> None:
        """What an arbiter keeps of an area, and what it kept before; the first to say so counts."""
        kept = self._rosters.get(now.area, now)
        version = (now.roster_term, now.roster_version)
        if version >= (kept.roster_term, kept.roster_version):
            self._rosters[now.area] = now
            for entry in now.roster:
                self._heard_ns.setdefault(entry.train, now_ns)
        known = self.leases.get(now.area)
        if not now.holder or (known is not None and known.granted_term >= now.promised):
            return
        if before is None or not before.holder:
            reason = LeaseReason.FIRST
        elif now.holder == before.holder:
            reason = LeaseReason.AGAIN
        elif now.holder == before.successor:
            reason = LeaseReason.HANDED_OVER
        else:
            reason = LeaseReason.RAN_OUT
        who = NOBODY if before is None else before.holder
        self.leases[now.area] = LeaseNote(now.area, now.holder, now.promised, who, reason, now_ns)
        self._tell_ns = now_ns

    def _on_message(self, decree: Decree, now_ns: int) -> None:
        if decree.source != SUPERVISION or not self._gate.admits(decree):
            self.refusals[RefusedReason.WRONG_SOURCE] += decree.source != SUPERVISION
            return
        age_ns = now_ns - decree.echo_ns
        if not 0 <= age_ns <= DECREE_AGE_NS:
            answer = DecreeAnswer.TOO_OLD
        elif decree.kind in OF_TRACK:
            answer = self._of_track(decree)
        else:
            answer = self._of_train(decree)
        self._answered = (decree.boot, decree.sequence, answer)

    def _of_train(self, decree: Decree) -> DecreeAnswer:
        train, status = decree.train, self._statuses.get(decree.train)
        if status is None:
            return DecreeAnswer.UNKNOWN_TRAIN
        was = self._of(train)
        name, value = CHANGES[decree.kind]
        now = was._replace(**{name: value})
        if decree.kind in (DecreeKind.LET_GO, DecreeKind.CALL) and now == was:
            return DecreeAnswer.NOT_THERE
        if decree.kind is DecreeKind.RELEASE:
            now = now._replace(releases=was.releases + 1)
        if decree.kind is DecreeKind.SKIP:
            ahead_m = [each.stop_m for each in self._line.stations if each.stop_m > status.front_m]
            if not status.localised or not ahead_m:
                return DecreeAnswer.NO_STRETCH
            self._skipping_m[train] = min(ahead_m)
        if now != was:
            self._keep(now)
        return DecreeAnswer.DONE

    def _of_track(self, decree: Decree) -> DecreeAnswer:
        shut = decree.kind in (DecreeKind.CLOSE, DecreeKind.OPEN)
        # What takes a stretch back says which; no limit is meant.
        limitless = shut or decree.kind is DecreeKind.LIFT
        limit_mps = NO_LIMIT_MPS if limitless else decree.limit_mps
        start_m, end_m = decree.start_m, decree.end_m
        if not self._line.start_m <= start_m < end_m <= self._line.end_m or not limit_mps > 0.0:
            return DecreeAnswer.NO_STRETCH
        memory = self.memory
        kept = memory.closed if shut else memory.restrictions
        others = tuple([each for each in kept if (each.start_m, each.end_m) != (start_m, end_m)])
        if decree.kind in (DecreeKind.LIFT, DecreeKind.OPEN):
            if len(others) == len(kept):
                return DecreeAnswer.NOT_THERE
        elif len(others) >= RESTRICTIONS_MAX:
            return DecreeAnswer.FULL
        else:
            others = (*others, SpeedRestriction(start_m, end_m, limit_mps))
        if shut:
            self.memory = replace(memory, closed=others)
        else:
            self.memory = replace(memory, restrictions=others)
        return DecreeAnswer.DONE

    def _end_skips(self) -> None:
        """Only the next station was meant."""
        for train, stop_m in list(self._skipping_m.items()):
            status, decreed = self._statuses[train], self._of(train)
            passed = status.localised and status.front_m > stop_m + PASSED_M
            if passed and decreed.skip:
                self._keep(decreed._replace(skip=False))
            if passed or not decreed.skip:
                del self._skipping_m[train]

    def _of(self, train: int) -> TrainDecree:
        for each in self.memory.trains:
            if each.train == train:
                return each
        return TrainDecree(train, False, False, False, 0)

    def _keep(self, decree: TrainDecree) -> None:
        others = [each for each in self.memory.trains if each.train != decree.train]
        self.memory = replace(self.memory, trains=tuple(sorted([*others, decree])))

    def _state(self, now_ns: int) -> LineState:
        self._sequence += 1
        head = (WAYSIDE, BROADCAST, 0, 0, self._boot, self._sequence, now_ns)
        trains = tuple([self._of(train) for train in sorted(self._centres)])
        stretches = self.memory.restrictions, self.memory.closed
        leases = tuple(self.leases.values())[:LEASES_MAX]
        silent = self._silent(now_ns)[:SILENT_MAX]
        return LineState(*head, *self._answered, trains, leases, *stretches, silent)

    def _silent(self, now_ns: int) -> tuple[RosterPlace, ...]:
        return tuple(
            [
                RosterPlace(area, entry.train)
                for area, each in sorted(self._rosters.items())
                for entry in each.roster
                if now_ns - self._heard_ns[entry.train] > SILENT_NS
            ]
        )
