"""The centre of a line whose trains command themselves.

It stores the commands of supervision. Pure.

Commands about trains are sent as the orders that answer each of their statuses. Commands about the
track go to the masters with the track status. Every command is stored before it is answered or
acted on, and it stays until it is taken back.
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
from zenoh_config.codec import BENCH_KEY, SafetyKey
from zenoh_config.messages import (
    RESTRICTIONS_MAX,
    WAYSIDE,
    RefusedReason,
    SpeedRestriction,
    TrainStatus,
)
from zenoh_config.t2t import BROADCAST, LAST_TRAIN, NO_TRAIN, ROSTER_MAX, SUPERVISION, T2tMessage
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
"""Maximum age of the line state that supervision had received when it sent its command."""
PASSED_M: Final = 20.0
"""Distance beyond a stopping point from which a train counts as having skipped it."""
NO_LIMIT_MPS: Final = 1.0
"""Placeholder limit of a closed stretch, where the limit has no meaning."""
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
    """Centre of all trains of a line.

    It knows a train from its first status on, up to the capacity of an area.
    """

    def __init__(
        self,
        line: LineMap,
        *,
        boot: int,
        memory: CentreMemory | None = None,
        first_sequence: int = 0,
        key: SafetyKey = BENCH_KEY,
    ) -> None:
        """Args:
        first_sequence: first sequence number of orders; above all that were sent before this start.
        memory: the stored commands.
        """
        self.memory = memory or CentreMemory()
        self.refusals: Counter[RefusedReason] = Counter()
        """Refused statuses and commands by reason."""
        self.leases: dict[int, LeaseNote] = {}
        """Leases by area, as the arbiters granted them."""
        self._received_ns: dict[int, int] = {}
        """Instant of the last status of each train; before the first, of its first appearance on a
        roster."""
        self._rosters: dict[int, LeaseMemory] = {}
        """Newest roster of each area that an arbiter stores."""
        self._line, self._boot, self._key = line, boot, key
        self._first_sequence = first_sequence
        self._gate = OrderGate(WAYSIDE)
        self._centres: dict[int, tuple[Centre, PlatformDoors]] = {}
        self._skipping_m: dict[int, float] = {}
        """The stopping point that each train must skip."""
        self._statuses: dict[int, TrainStatus] = {}
        self._answered = (0, 0, DecreeAnswer.NONE)
        self._sequence = 0
        self._next_state_ns = 0

    @property
    def restrictions(self) -> tuple[SpeedRestriction, ...]:
        return self.memory.restrictions

    @property
    def closed(self) -> tuple[SpeedRestriction, ...]:
        return self.memory.closed

    def answer(
        self, message: RadioMessage, status: TrainStatus, now_ns: int
    ) -> tuple[str, bytes] | None:
        """Return key and payload of the orders to a train that sent its status."""
        train = status.train
        if train not in self._centres:
            if len(self._centres) >= ROSTER_MAX or train > LAST_TRAIN:
                self.refusals[RefusedReason.WRONG_SOURCE] += 1
                return None
            # Each train has its own platform doors. It commands only those where it stands, and no
            # two trains stand at one platform.
            doors = PlatformDoors(self._line)
            centre = Centre(self._line, doors, first_sequence=self._first_sequence, key=self._key)
            self._centres[train] = centre, doors
            self._next_state_ns = 0
        centre, _ = self._centres[train]
        decreed = self._of(train)
        centre.standing = replace(
            NORMAL, hold=decreed.hold, skip_next=decreed.skip, emergency=decreed.emergency
        )
        centre.releases = decreed.releases
        answer = centre.answer(message, now_ns)
        if answer is not None:
            self._statuses[train] = status
            self._received_ns[train] = now_ns
        return answer

    def starts_again(self, train: int) -> None:
        """Forget what a train sent, because its controller counts from 0 on each trip. A skip order
        ends with the trip.
        """
        self._centres.pop(train, None)
        self._statuses.pop(train, None)
        self._skipping_m.pop(train, None)
        known = self._of(train)
        if known.skip:
            self._keep(known._replace(skip=False))

    @property
    def lasting(self) -> tuple[TrainDecree, ...]:
        """Commands to trains that hold on each path of a network: all but skip orders."""
        return tuple(each._replace(skip=False) for each in self.memory.trains)

    def take(self, lasting: Iterable[TrainDecree]) -> None:
        """Take the lasting commands that were given on another path of the network."""
        for each in lasting:
            self._keep(each._replace(skip=self._of(each.train).skip))

    def step_doors(self, now_ns: int) -> None:
        """Move the platform doors; call it every 10 ms."""
        for _, doors in self._centres.values():
            doors.step(now_ns)

    def step(self, now_ns: int, heard: Iterable[T2tMessage]) -> WaysideStepped[CentreMemory]:
        """Accept commands. They take effect in `restrictions`, `closed` and the next orders."""
        before, answered = self.memory, self._answered
        for message in heard:
            if isinstance(message, Decree):
                self._on_command(message, now_ns)
        self._end_skips()
        changed = self.memory is not before
        if not changed and self._answered == answered and now_ns < self._next_state_ns:
            return WaysideStepped(None, ())
        self._next_state_ns = now_ns + TELL_NS
        return WaysideStepped(self.memory if changed else None, (self._state(now_ns),))

    def not_stored(self, before: CentreMemory, now_ns: int) -> LineState:
        """Undo a change that could not be stored, and return a status that reports it."""
        self.memory = before
        boot, sequence, _ = self._answered
        self._answered = (boot, sequence, DecreeAnswer.NOT_STORED)
        return self._state(now_ns)

    def granted(self, before: LeaseMemory | None, now: LeaseMemory, now_ns: int) -> None:
        """Note an arbiter's new and previous memory of an area; the first arbiter that reports a
        grant counts.
        """
        kept = self._rosters.get(now.area, now)
        version = (now.roster_term, now.roster_version)
        if version >= (kept.roster_term, kept.roster_version):
            self._rosters[now.area] = now
            for entry in now.roster:
                self._received_ns.setdefault(entry.train, now_ns)
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
        who = NO_TRAIN if before is None else before.holder
        self.leases[now.area] = LeaseNote(now.area, now.holder, now.promised, who, reason, now_ns)
        self._next_state_ns = now_ns

    def _on_command(self, decree: Decree, now_ns: int) -> None:
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
            self._centres[train][0].release()
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
        # A command that takes a stretch back only names the stretch, without a limit.
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
        """End each skip order when the train has passed its station."""
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
        silent = self._non_communicating(now_ns)[:SILENT_MAX]
        return LineState(*head, *self._answered, trains, leases, *stretches, silent)

    def _non_communicating(self, now_ns: int) -> tuple[RosterPlace, ...]:
        return tuple(
            [
                RosterPlace(area, entry.train)
                for area, each in sorted(self._rosters.items())
                for entry in each.roster
                if now_ns - self._received_ns[entry.train] > SILENT_NS
            ]
        )
