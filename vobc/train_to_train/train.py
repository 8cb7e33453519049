"""One train among trains that command themselves: the state machine that its process runs."""

from collections import Counter
from dataclasses import replace
from typing import Final

from firmware_py.trackdb.areas import Area, AreaMap
from vobc.train_to_train.area_participant import AreaParticipant, Chance
from vobc.train_to_train.guards import TrainGuards
from vobc.train_to_train.message_heads import MessageHeads
from vobc.train_to_train.occupancy import UNBOUNDED_M
from vobc.train_to_train.reception import Reception
from vobc.train_to_train.roles import StandingGuardInputs, state_of
from vobc.train_to_train.vocabulary import (
    HeldAuthority,
    OwnTrain,
    Role,
    Stepped,
    T2tConfig,
    TrainMemory,
)
from zenoh_config.t2t import NOBODY, AreaAuthority, LineOrder, OrderKind, T2tMessage
from zenoh_config.timers import NS_PER_MS

FAREWELL_M: Final = 150.0
"""So far behind a border the rear goes on being told to the area before, and as far as its master
is told of sections there: what it says explains the axles in them."""
IDLE_NS: Final = 1000 * NS_PER_MS
LISTENS_NS: Final = 10_000 * NS_PER_MS
"""For so long it goes on listening in an area that has been no concern of it any more: longer than
anything lives that is said there, and than its bounds of place waver around a border."""
VOUCHES_NS: Final = 20_000 * NS_PER_MS
"""A train that has stood for so long tells the areas next to its own where."""
HEARD_MAX: Final = 1000
"""Messages taken in one step; more are refused and counted."""


class TrainCore:
    """Not for reuse over a restart: a new incarnation is a new object with the stored memory."""

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
        """`memory` as it was stored; None: it cannot be read, and the train takes part in nothing.

        The first step hands out the memory of this incarnation.
        """
        stored = memory or TrainMemory()
        self.memory = replace(stored, boot=stored.boot + 1)
        self.refusals: Counter[str] = Counter()
        """Messages that were not acted on, by reason."""
        self._forgotten = memory is None
        self._config, self._line = config, line
        self._told_to_m = {
            area.number: max(
                [area.end_m + FAREWELL_M]
                + [s.end_m + config.overhang_m for s in line.sections_told(area.number)]
            )
            for area in line.areas
        }
        """By area: a train whose rear is beyond this is no concern of it any more."""
        self._guards = guards or TrainGuards()
        self._speaker = MessageHeads(address, self.memory.boot)
        self._hearing = Reception(address, self.memory.boot)
        self._chance = Chance(address * 0x10001 + seed)
        self._desks: dict[int, AreaParticipant] = {}
        self.listens: frozenset[int] = frozenset()
        """Areas of which it wants to hear what is said to all; another object when it changes."""
        self._concerned_ns: dict[int, int] = {}
        """By area: when it was a concern of the train last."""
        self._stored = False
        self._void = False
        """Its clock or its place went back: nothing that it said or was told holds any more."""
        self._newest_ns = start_ns
        self._moved_ns = start_ns
        """Until then it moved, or was lost."""
        self._rear_m = -UNBOUNDED_M
        """Its rear was surely here or farther on."""
        self._due_ns = start_ns

    @property
    def address(self) -> int:
        return self._speaker.address

    def desk(self, area: int) -> AreaParticipant | None:
        """What the train has to do with an area, for displays; None: nothing."""
        return self._desks.get(area)

    def next_due_ns(self) -> int:
        """When the next step is needed although nothing is heard."""
        return self._due_ns

    def step(self, now_ns: int, heard: tuple[T2tMessage, ...], own: OwnTrain) -> Stepped:
        """Read all, decide once, say all."""
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
        said = self._hear(now_ns, heard)
        if self._silenced():
            return self._takes_no_part(now_ns)
        if self.memory.out_of_service:
            own = own._replace(out_of_service=True)
        for desk in self._desks.values():
            desk.member.settle(now_ns, own)
        for number, desk in self._desks.items():
            concerned = number in areas
            relation = self._relation(desk.area, now_ns)
            said += desk.step(now_ns, own, concerned=concerned, relation=relation)
            if number in beside:
                said += desk.vouch(now_ns, own)
        for desk in self._desks.values():
            if desk.refused:
                self.refusals.update(desk.refused)
                desk.refused.clear()
            desk.member.settle(now_ns, own)
        return self._stepped(now_ns, own, said)

    def _listen(self, now_ns: int) -> None:
        """A line has many areas, and more trains than one of them: what is said to all in those
        that are no concern of this train any more it does not want to hear, nor to keep in order.
        """
        for area, last_ns in list(self._concerned_ns.items()):
            if now_ns - last_ns > LISTENS_NS and self._desks[area].role is Role.OUTSIDE:
                del self._concerned_ns[area]
                self._hearing.forget(area)
        if self.listens != self._concerned_ns.keys():
            self.listens = frozenset(self._concerned_ns)

    def _silenced(self) -> bool:
        """Without memory, or with a double, it cannot be told from what it was or is not."""
        return self._forgotten or self._void or self._hearing.doubled

    def _look_back(self, now_ns: int, own: OwnTrain) -> None:
        """Neither time nor a train goes back; what seems to has to begin anew, with the next start.

        A train that went round by a depot, or was towed, is not where its authority was.
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
        said: list[T2tMessage] = []
        if len(heard) > HEARD_MAX:
            self.refusals["flood"] += len(heard) - HEARD_MAX
        for message in heard[:HEARD_MAX]:
            # Not even kept in order: that place is for somebody who is there.
            if message.area not in self._told_to_m and message.source != self.address:
                self.refusals["unknown area"] += 1
                continue
            if not self._hearing.admits(message, self._speaker.sequence):
                continue
            if isinstance(message, LineOrder) and message.train == self.address:
                self._serve(message)
            desk = self._desks.get(message.area)
            if desk is None:
                self.refusals["area of no concern"] += 1
            else:
                said += desk.hears(message, now_ns)
        if self._hearing.refusals:
            self.refusals.update({r.value: n for r, n in self._hearing.refusals.items()})
            self._hearing.refusals.clear()
        return said

    def _serve(self, order: LineOrder) -> None:
        """In or out of service by order: in every area, for as long as nobody says otherwise, and
        over the next start, too.
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
        """Areas that the train is in, has just left or comes to; while lost, those from before."""
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
        """Areas next to those: their masters may see its axles in sections that are occupied
        without a gap, and all would wait for ever for somebody who explains them.
        """
        if not (own.localised and own.standstill):
            self._moved_ns = now_ns
        if now_ns - self._moved_ns < VOUCHES_NS:
            return set()
        line = self._line
        sides = [side(number) for number in areas for side in (line.preceding, line.following)]
        return {each.number for each in sides if each is not None} - areas

    def _relation(self, area: Area, now_ns: int) -> tuple[int, int]:
        """The area before, if its authority is held, and who is ahead by that."""
        for number, desk in self._desks.items():
            following = self._line.following(number)
            if following is not None and following.number == area.number:
                held = desk.member.held
                if held is not None and desk.member.is_young(now_ns):
                    return number, held.behind
        return 0, NOBODY

    def _authority(self, now_ns: int, own: OwnTrain) -> HeldAuthority | None:
        """Area by area from where the rear may roll back to: one that reaches its border is
        continued by the next, and every one that the train stands in has its say, as only that one
        knows of its objects. So has the next one where the end is near the border. Where that one
        has none, or the line ends, somebody may hide just beyond, with axles that only others count
        or nobody does: nobody goes nearer.
        """
        hindmost = self._line.area_at(own.rear_min_m - self._config.rollback_m)
        back_m = self._back_m(hindmost)
        area: Area | None = hindmost
        result: HeldAuthority | None = None
        reaches = True
        while area is not None and (held := self._held(area, result, now_ns, own)) is not None:
            if not reaches:
                return result
            end_m = held.end_m
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

    def _back_m(self, area: Area) -> float:
        """The rear jogs back over no border, also if it rolls back from there."""
        first = self._line.preceding(area.number) is None
        return -UNBOUNDED_M if first else area.start_m + self._config.rollback_m

    def _held(
        self, area: Area, before: HeldAuthority | None, now_ns: int, own: OwnTrain
    ) -> AreaAuthority | None:
        """What an area has granted: one that the train is in of whatever age, the next one while
        it is young.

        While the train stops before it with ease, one that grows old is left out: it would only
        make the whole look old.
        """
        desk = self._desks.get(area.number)
        held = None if desk is None else desk.member.held
        if held is None or before is None or area.start_m <= own.front_min_m:
            return held
        age_ns, age_max_ns = now_ns - held.echo_ns, self._config.timers.authority_ms * NS_PER_MS
        easy = own.easy_m <= area.start_m - self._config.behind_axle_m
        return held if age_ns < age_max_ns // 2 or (age_ns <= age_max_ns and not easy) else None

    def _takes_no_part(self, now_ns: int) -> Stepped:
        """Nothing is said, nothing obeyed: others protect the train by what they know of it."""
        self._due_ns = now_ns + IDLE_NS
        return Stepped(None, None, ())

    def _stepped(self, now_ns: int, own: OwnTrain, said: list[T2tMessage]) -> Stepped:
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
            # Every area that the train is in has a desk.
            within += desk.area.start_m < own.front_max_m and own.rear_min_m < desk.area.end_m
        changed = memory is not self.memory or not self._stored
        self.memory, self._stored = memory, True
        self._due_ns = due_ns
        authority = self._authority(now_ns, own) if own.localised else None
        age_max_ns = self._config.timers.authority_ms * NS_PER_MS
        young = authority is not None and now_ns - authority.echo_ns <= age_max_ns
        return Stepped(
            memory=memory if changed else None,
            authority=authority,
            out=tuple(said),
            state=state_of(StandingGuardInputs(own.localised, young, within)),
            roles=tuple(roles),
        )
