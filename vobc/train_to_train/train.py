"""One train in train-to-train control: the state machine that the train's process runs."""

from collections import Counter
from dataclasses import replace
from typing import Final

from firmware_py.trackdb.areas import Area, AreaMap
from vobc.train_to_train.area_participant import AreaParticipant, Chance
from vobc.train_to_train.guards import TrainAhead, TrainGuards
from vobc.train_to_train.message_heads import MessageHeads
from vobc.train_to_train.occupancy import UNBOUNDED_M
from vobc.train_to_train.reception import Reception
from vobc.train_to_train.roles import StandingGuardInputs, state_of
from vobc.train_to_train.trains_ahead import TrainsAhead
from vobc.train_to_train.vocabulary import (
    HeldAuthority,
    OwnTrain,
    Role,
    Stepped,
    T2tConfig,
    TrainMemory,
)
from zenoh_config.t2t import (
    NO_TRAIN,
    AreaAuthority,
    LineOrder,
    OrderKind,
    T2tMessage,
    TrainReport,
)
from zenoh_config.timers import NS_PER_MS

FAREWELL_M: Final = 150.0
"""Distance beyond a border up to which a train still reports to the area that it has left.

The master of that area receives the track status this far, and the reports account for the axles
there.
"""
IDLE_NS: Final = 1000 * NS_PER_MS
LISTENS_NS: Final = 10_000 * NS_PER_MS
"""How long the train keeps listening in an area that no longer concerns it.

This is longer than any message of the area stays valid, and longer than position uncertainty can
waver around a border.
"""
VOUCHES_NS: Final = 20_000 * NS_PER_MS
"""Time at standstill after which a train also reports to the areas next to its own."""
HEARD_MAX: Final = 1000
"""Greatest number of messages processed in one step. More are refused and counted."""


class TrainCore:
    """Core of one incarnation. After a restart the caller creates a new object from the stored
    memory.
    """

    def __init__(
        self,
        config: T2tConfig,
        line: AreaMap,
        *,
        address: int,
        memory: TrainMemory | None,
        start_ns: int,
        seed: int = 0,
        guards: TrainGuards | None = None,
    ) -> None:
        """Begin an incarnation. The first step returns its memory to be stored.

        Args:
            memory: memory as stored. None: it is unreadable, and the train takes no part.
        """
        stored = memory or TrainMemory()
        self.memory = replace(stored, boot=stored.boot + 1)
        self.refusals: Counter[str] = Counter()
        """Messages that the train did not act on, by reason."""
        self._forgotten = memory is None
        self._config, self._line = config, line
        self._told_to_m = {
            area.number: max(
                [area.end_m + FAREWELL_M]
                + [s.end_m + config.overhang_m for s in line.sections_told(area.number)]
            )
            for area in line.areas
        }
        """Place of the rear by area. A train whose rear is beyond it is no longer concerned with
        the area."""
        self._guards = guards or TrainGuards()
        self._speaker = MessageHeads(address, self.memory.boot)
        self._hearing = Reception(address, self.memory.boot)
        self._ahead = TrainsAhead(config.jog_m)
        self._chance = Chance(address * 0x10001 + seed)
        self._desks: dict[int, AreaParticipant] = {}
        self.listens: frozenset[int] = frozenset()
        """Areas whose broadcasts the train wants to receive. The object is replaced when the set
        changes."""
        self._concerned_ns: dict[int, int] = {}
        """When each area last concerned the train."""
        self._stored = False
        self._void = False
        """The clock or the place went backwards. Nothing that the train sent or received is valid
        any more."""
        self._newest_ns = start_ns
        self._moved_ns = start_ns
        """When the train last moved or had lost its position."""
        self._rear_m = -UNBOUNDED_M
        """Hindmost place where the rear can be."""
        self._due_ns = start_ns

    @property
    def address(self) -> int:
        return self._speaker.address

    def desk(self, area: int) -> AreaParticipant | None:
        """State of the train in an area, for displays. None: the area does not concern it."""
        return self._desks.get(area)

    @property
    def round_trip_ms(self) -> float:
        """Time that the arbiters take to answer this train. 0: it has not asked any."""
        times_ns = [desk.lease.round_trip_ns for desk in self._desks.values()]
        return max(times_ns, default=0) / NS_PER_MS

    @property
    def round_trip_max_ms(self) -> int:
        return self._config.timers.round_trip_max_ms

    def next_due_ns(self) -> int:
        """When the next step is due without any message."""
        return self._due_ns

    def step(self, now_ns: int, heard: tuple[T2tMessage, ...], own: OwnTrain) -> Stepped:
        """Process all messages, decide once, and return all messages to send."""
        self._look_back(now_ns, own)
        if self._silenced():
            return self._takes_no_part(now_ns)
        areas = self._concerned(own)
        beside = self._beside(areas, now_ns, own)
        known = areas | beside
        for area in known:
            self._desk(area, now_ns)
            self._concerned_ns[area] = now_ns
        if not len(known) == len(self._concerned_ns) == len(self.listens):
            self._listen(now_ns)
        sent = self._hear(now_ns, heard)
        if self._silenced():
            return self._takes_no_part(now_ns)
        if self.memory.out_of_service:
            own = own._replace(out_of_service=True)
        limit_m = self._limit_m(now_ns, own)
        for desk in self._desks.values():
            desk.member.settle(now_ns, own, limit_m=limit_m)
        for number, desk in self._desks.items():
            concerned = number in areas
            relation = self._relation(desk.area, now_ns)
            sent += desk.step(now_ns, own, concerned=concerned, relation=relation)
            if number in beside:
                sent += desk.vouch(now_ns, own)
        for desk in self._desks.values():
            if desk.refused:
                self.refusals.update(desk.refused)
                desk.refused.clear()
            desk.member.settle(now_ns, own, limit_m=limit_m)
        return self._stepped(now_ns, own, sent, limit_m)

    def _listen(self, now_ns: int) -> None:
        """Update the areas in which the train listens.

        A line has many areas and many trains. The train stops receiving and tracking broadcasts of
        areas that no longer concern it.
        """
        for area, last_ns in list(self._concerned_ns.items()):
            if now_ns - last_ns > LISTENS_NS and self._desks[area].role is Role.OUTSIDE:
                del self._concerned_ns[area]
                self._hearing.forget(area)
        if self.listens != self._concerned_ns.keys():
            self.listens = frozenset(self._concerned_ns)

    def _silenced(self) -> bool:
        """Whether the train takes no part. Without its memory, or with a duplicate of its address,
        it cannot be identified.
        """
        return self._forgotten or self._void or self._hearing.doubled

    def _look_back(self, now_ns: int, own: OwnTrain) -> None:
        """Detect a clock or a place that went backwards. The train then takes no part until the
        next restart.

        After a detour through a depot, or a tow, the train is no longer where its authority began.
        """
        if not self._void and now_ns < self._newest_ns:
            self.refusals["clock went back"] += 1
            self._void = True
        self._newest_ns = now_ns
        if not own.localised:
            return
        unsure_m = own.front_max_m - own.front_min_m
        if not self._void and own.rear_min_m + unsure_m < self._rear_m - self._config.behind_rear_m:
            self.refusals["place went back"] += 1
            self._void = True
        self._rear_m = max(self._rear_m, own.rear_min_m)

    def _hear(self, now_ns: int, heard: tuple[T2tMessage, ...]) -> list[T2tMessage]:
        sent: list[T2tMessage] = []
        if len(heard) > HEARD_MAX:
            self.refusals["flood"] += len(heard) - HEARD_MAX
        for message in heard[:HEARD_MAX]:
            # A message of an unknown area is not even tracked. That memory is for real senders.
            if message.area not in self._told_to_m and message.source != self.address:
                self.refusals["unknown area"] += 1
                continue
            if not self._hearing.admits(message, self._speaker.sequence):
                continue
            if isinstance(message, TrainReport):
                self._ahead.on_message(message, now_ns)
            elif isinstance(message, LineOrder) and message.train == self.address:
                self._serve(message)
            desk = self._desks.get(message.area)
            if desk is None:
                self.refusals["area of no concern"] += 1
            else:
                sent += desk.on_message(message, now_ns)
        if self._hearing.refusals:
            self.refusals.update({r.value: n for r, n in self._hearing.refusals.items()})
            self._hearing.refusals.clear()
        return sent

    def _serve(self, order: LineOrder) -> None:
        """Apply an order to take the train in or out of service.

        It holds in every area and across restarts, until supervision orders otherwise.
        """
        kinds = (OrderKind.IN_SERVICE, OrderKind.OUT_OF_SERVICE)
        out_of_service = order.kind is OrderKind.OUT_OF_SERVICE
        if order.kind in kinds and out_of_service is not self.memory.out_of_service:
            self.memory = replace(self.memory, out_of_service=out_of_service)
            self._stored = False

    def _desk(self, area: int, now_ns: int) -> None:
        if area not in self._desks:
            self._desks[area] = AreaParticipant(
                self._config,
                self._guards,
                self._line,
                area,
                speaker=self._speaker,
                memory=self.memory.of_area(area),
                now_ns=now_ns,
                chance=self._chance,
            )

    def _concerned(self, own: OwnTrain) -> set[int]:
        """Areas that the train is in, has just left, or approaches. A lost train keeps the former
        ones.
        """
        if not own.localised:
            return {number for number, each in self._desks.items() if each.role is not Role.OUTSIDE}
        line = self._line
        return {
            area.number
            for area in line.areas
            if area.start_m - line.apply_m <= own.front_max_m
            and own.rear_min_m <= self._told_to_m[area.number]
        }

    def _beside(self, areas: set[int], now_ns: int, own: OwnTrain) -> set[int]:
        """Areas next to those of a train that has stood for a while.

        Their masters may count its axles in adjoining occupied sections. Without its report no
        train could account for them, and all would wait for ever.
        """
        if not (own.localised and own.standstill):
            self._moved_ns = now_ns
        if now_ns - self._moved_ns < VOUCHES_NS:
            return set()
        line = self._line
        sides = [side(number) for number in areas for side in (line.preceding, line.following)]
        return {each.number for each in sides if each is not None} - areas

    def _relation(self, area: Area, now_ns: int) -> tuple[int, int]:
        """The preceding area whose authority is held, and the train ahead in that authority."""
        for number, desk in self._desks.items():
            following = self._line.following(number)
            if following is not None and following.number == area.number:
                held = desk.member.held
                if held is not None and desk.member.is_young(now_ns):
                    return number, held.behind
        return 0, NO_TRAIN

    def _authority(self, now_ns: int, own: OwnTrain) -> HeldAuthority | None:
        """Combine the authorities of the areas from the rear onwards.

        The first area is the one into which the rear may roll back. An authority that reaches its
        area's border is continued by the next area. Each area that the train stands in must agree,
        because only its master knows its objects. The next area must agree, too, if the end is near
        the border.

        If the next area has granted nothing, or the line ends, a shadow train may be just beyond.
        The authority then ends short of that border.
        """
        hindmost = self._line.area_at(own.rear_min_m - self._config.rollback_m)
        back_m = self._back_m(hindmost)
        area: Area | None = hindmost
        result: HeldAuthority | None = None
        reaches = True
        while area is not None and (held := self._held(area, result, now_ns, own)) is not None:
            if not reaches:
                return result
            # No master grants track of another area.
            end_m = min(held.end_m, max(area.end_m, own.front_max_m))
            if result is not None and result.end_m < area.start_m:
                end_m = min(end_m, result.end_m)
            result = HeldAuthority(
                end_m=end_m,
                rear_m=max(held.rear_m, back_m) if result is None else result.rear_m,
                echo_ns=held.echo_ns if result is None else min(result.echo_ns, held.echo_ns),
                area=area.number,
                term=held.term,
                sequence=held.sequence,
                restrictions=held.restrictions
                if result is None
                else (*result.restrictions, *held.restrictions),
            )
            reaches = end_m > area.end_m - self._config.behind_axle_m
            area = self._line.following(area.number)
        if result is None or (area is not None and area.start_m <= own.front_min_m):
            return None
        known_m = self._line.end_m if area is None else area.start_m
        before_m = known_m - self._config.behind_axle_m
        return result._replace(end_m=min(result.end_m, max(before_m, own.front_max_m)))

    def _limit_m(self, now_ns: int, own: OwnTrain) -> float:
        """Farthest end of an authority, whatever masters grant: behind the nearest train ahead."""
        ahead = TrainAhead(self._ahead.rear_m(now_ns, own), self._config.behind_rear_m)
        return max(self._guards.member.behind_train_ahead_m(ahead), own.front_max_m)

    def _back_m(self, area: Area) -> float:
        """Hindmost place for a jog. The rear must not cross a border, even if it rolls back from
        there.
        """
        first = self._line.preceding(area.number) is None
        return -UNBOUNDED_M if first else area.start_m + self._config.rollback_m

    def _held(
        self, area: Area, before: HeldAuthority | None, now_ns: int, own: OwnTrain
    ) -> AreaAuthority | None:
        """Authority that an area has granted. In an area that the train occupies, its age does not
        matter.

        The next area's authority must not have expired. While the train can stop short of that area
        with the service brake, an ageing authority is left out. It would only age the combined
        authority.
        """
        desk = self._desks.get(area.number)
        held = None if desk is None else desk.member.held
        if held is None or before is None or area.start_m <= own.front_min_m:
            return held
        age_ns, age_max_ns = now_ns - held.echo_ns, self._config.timers.authority_ms * NS_PER_MS
        easy = own.easy_m <= area.start_m - self._config.behind_axle_m
        return held if age_ns < age_max_ns // 2 or (age_ns <= age_max_ns and not easy) else None

    def _takes_no_part(self, now_ns: int) -> Stepped:
        """Send nothing and obey nothing. Other trains protect this one by what they know of it."""
        self._due_ns = now_ns + IDLE_NS
        return Stepped(None, None, ())

    def _stepped(
        self, now_ns: int, own: OwnTrain, sent: list[T2tMessage], limit_m: float
    ) -> Stepped:
        memory, due_ns = self.memory, now_ns + IDLE_NS
        roles: list[tuple[int, Role]] = []
        within = 0
        for number, desk in self._desks.items():
            if desk.member.memory is not desk.stored:
                desk.stored = desk.member.memory
                memory = memory.with_area(desk.stored)
            if desk.role is not Role.OUTSIDE:
                due_ns = min(due_ns, desk.next_due_ns(now_ns))
                roles.append((number, desk.role))
            # Every area that the train is in has an entry here.
            within += desk.area.start_m < own.front_max_m and own.rear_min_m < desk.area.end_m
        changed = memory is not self.memory or not self._stored
        self.memory, self._stored = memory, True
        self._due_ns = due_ns
        authority = self._authority(now_ns, own) if own.localised else None
        if authority is not None and authority.end_m > limit_m:
            authority = authority._replace(end_m=limit_m)
        age_max_ns = self._config.timers.authority_ms * NS_PER_MS
        young = authority is not None and now_ns - authority.echo_ns <= age_max_ns
        return Stepped(
            memory=memory if changed else None,
            authority=authority,
            out=tuple(sent),
            state=state_of(StandingGuardInputs(own.localised, young, within)),
            roles=tuple(roles),
        )
