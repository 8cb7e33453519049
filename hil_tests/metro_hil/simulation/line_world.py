"""A line of trains that command themselves, with areas, objects, supervision and depot."""

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

from firmware_py.trackdb.areas import Area
from metro_hil.simulation.authority_checks import AuthorityChecks, LeaseRules
from metro_hil.simulation.checker import ViolationError
from metro_hil.simulation.event_queue import Codec
from metro_hil.simulation.generate import Draw
from metro_hil.simulation.node import NodeMachine, QueuedMessage, SimulatedNode
from metro_hil.simulation.orders import TrainOrder
from metro_hil.simulation.protocol_nodes import ProtocolNodes, TrainNode
from metro_hil.simulation.trace import Teller
from metro_hil.simulation.track import TrueTrack
from metro_hil.simulation.train_node import TrainNodeController
from metro_hil.simulation.true_train import BrakeLoopGrant, TrueTrain
from metro_hil.simulation.world import SimulatedLine
from zenoh_config.messages import RESTRICTIONS_MAX, SpeedRestriction
from zenoh_config.t2t_supervision import RemovalState

NS_PER_S: Final = 1_000_000_000
NS_PER_MS: Final = 1_000_000


class LineWorld(SimulatedLine):
    """A simulated line whose nodes all run the real protocol."""

    def __init__(
        self, seed: int, drawn: Draw, *, codec: Codec | None = None, tell: Teller | None = None
    ) -> None:
        self.drawn = drawn
        crew = ProtocolNodes(drawn.cast, seed)
        if drawn.insider:
            crew.arbiters = {}
            crew.rules = replace(crew.rules, hostile=drawn.insider)
        super().__init__(seed, drawn.setting, crew, codec=codec, tell=tell)
        self.t2t = crew
        self.track = TrueTrack(drawn.cast.line, tuple(self.trains.values()))
        crew.track = self.track
        crew.true_ns = lambda: self.net.now_ns
        crew.move = self._objects_move
        timers = drawn.cast.config.timers
        rules = LeaseRules(
            timers.lease_ms * NS_PER_MS,
            timers.drift_ratio,
            timers.margin_ms * NS_PER_MS,
            drawn.cast.config.majority,
            crew.rules.age_max_ns,
            crew.rules.hostile,
        )
        self.net.turn_ns = drawn.turn_ms * NS_PER_MS
        self._delay_links()
        self._closed: list[tuple[int, SpeedRestriction]] = []
        self._places: dict[int, deque[tuple[int, float]]] = {each: deque() for each in self.trains}
        """Times and greatest front positions by train; positions that a later one exceeds are
        dropped."""
        ends_m = {area.number: area.end_m for area in drawn.cast.line.areas}
        self.air = AuthorityChecks(rules, self.checker.looked, ends_m)
        crew.answered = self.air.answered

    def _delay_links(self) -> None:
        delay_ns = int(self.drawn.standing_ms * NS_PER_MS)
        for link in self.net.links():
            trains = link.source in self.trains and link.target in self.trains
            if delay_ns and not (trains and self.drawn.wayside_delayed):
                link.delay(delay_ns)

    def _start_train(self, node: SimulatedNode, now_ns: int) -> NodeMachine:
        self.air.booted(node.address)
        machine = super()._start_train(node, now_ns)
        assert isinstance(machine, TrainNodeController)
        machine.listener = self
        leisurely = self.drawn.leisurely and self.net.codec is None
        if leisurely and isinstance(machine.protocol, TrainNode):
            node.minds = machine.protocol.waits_for
        return machine

    def stepped(
        self,
        address: int,
        now_ns: int,
        true_ns: int,
        heard: Sequence[Any],
        letters: Sequence[QueuedMessage],
    ) -> None:
        train = self.trains.get(address)
        if train is not None and train.rolls:
            self.notes_place(train)
        self.air.clocks_sound = not self.net.clock_steps
        self.air.stepped(address, now_ns, true_ns, heard, letters)

    def holds(self, address: int, grant: BrakeLoopGrant) -> None:
        self.air.made_of(address, grant)
        self._in_its_area(address, grant)
        self._stays_out(address, grant)
        self.check_objects()

    def without_authority(self) -> list[int]:
        """Return the trains without authority, except those that stand too close to another.

        A leader that rolls back into the room it must leave behind it takes away what its follower
        could get. An unregistered train that appears so close ahead of another is not put on a
        roster.
        """
        return [each for each in super().without_authority() if not self._closed_up(each)]

    def _closed_up(self, address: int) -> bool:
        train = self.trains[address]
        if train.motion.speed_mps > 0.0:
            return False
        others = [e for e in self.trains.values() if e.on_line and e is not train]
        ahead = [e for e in others if e.front_m > train.front_m]
        behind = [e for e in others if e.front_m <= train.front_m]
        leader = min(ahead, key=lambda each: each.front_m, default=None)
        follower = max(behind, key=lambda each: each.front_m, default=None)
        area = self.drawn.cast.line.area_at(train.front_m)
        closed_up = self._too_near(train, leader) or (
            self._too_near(follower, train) and not self.air.keeps(address, area.number)
        )
        self.checker.looked["40 closed up"] += closed_up
        return closed_up

    def _too_near(self, train: TrueTrain | None, leader: TrueTrain | None) -> bool:
        """Tell whether the trains are too close by their own position intervals."""
        if train is None or leader is None:
            return False
        rules = self.checker.rules
        room_m = rules.roll_back_m + rules.jog_m
        return train.reading().front_max_m > leader.reading().rear_min_m - room_m

    def is_in(self, train: TrueTrain, area: Area) -> bool:
        """Tell whether any part of the train is in the area."""
        return train.on_line and train.rear_m < area.end_m and train.front_m > area.start_m

    def unsettled(self, waiting: Sequence[int]) -> bool:
        """Tell whether trains have to wait because another train moves.

        A restarted train waits while a train moves that no empty section separates from it: others
        have to stand and report where. A train that left an area stays on its roster while its
        possible way is checked. It also stays while it moves and its master still receives it.
        """
        moving = [each for each in self.trains.values() if each.motion.speed_mps > 0.0]
        if not moving:
            return super().unsettled(waiting)
        line = self.drawn.cast.line
        leaves = any(
            state is RemovalState.AXLES
            or (state is RemovalState.HEARD and self.trains[train] in moving)
            for (area, train), state in self.t2t.removals.items()
            if not self.is_in(self.trains[train], line.area(area))
        )
        joined = (self.track.joined_to(self.trains[each]) for each in waiting)
        return (
            leaves
            or super().unsettled(waiting)
            or any(e in moving for each in joined for e in each)
        )

    def removes(self, train: int, areas: Sequence[int] = ()) -> None:
        """Let supervision take the train off the rosters of these areas; by default of all."""
        wanted = areas or [area.number for area in self.drawn.cast.line.areas]
        self.net.say("railway", f"supervision takes train {train} off rosters {wanted}")
        self.t2t.orders += [TrainOrder(None, area, train) for area in wanted]

    @property
    def may_close(self) -> bool:
        """Whether the wayside can report another closed stretch; their number is limited."""
        return len(self.t2t.closed) < RESTRICTIONS_MAX

    def is_closed(self, closed: SpeedRestriction) -> bool:
        """Tell whether this object is still closed; another one may cover the same metres."""
        return any(each is closed for each in self.t2t.closed)

    def opens(self, closed: SpeedRestriction) -> None:
        """End this closure; another one of the same metres stays."""
        crew = self.t2t
        crew.closed = tuple([each for each in crew.closed if each is not closed])

    def closes(self, closed: SpeedRestriction) -> None:
        """Close a stretch.

        Invariant 23: after a while no accepted authority enters it any more.

        This while covers the way of the news to a master and the maximum age of an authority.
        """
        self.t2t.closed = (*self.t2t.closed, closed)
        age_max_ns = self.checker.rules.age_max_ns
        self._closed.append((self.net.now_ns + 3 * age_max_ns, closed))

    def _stays_out(self, address: int, grant: BrakeLoopGrant) -> None:
        train = self.trains[address]
        self._closed = [each for each in self._closed if self.is_closed(each[1])]
        for since_ns, closed in self._closed:
            if self.net.now_ns < since_ns:
                continue
            self.checker.looked["23 closed"] += 1
            least_m = max(closed.start_m, self._lately_m(train))
            if train.reading().front_max_m < closed.start_m and grant.end_m > least_m:
                raise ViolationError(
                    "23",
                    f"train {address} may go to {grant.end_m:.1f} m, over what is closed from "
                    f"{closed.start_m:.1f} m on",
                )

    def notes_place(self, train: TrueTrain) -> None:
        """Record the front position of a train before and while it rolls back."""
        now_ns, front_max_m = self.net.now_ns, train.reading().front_max_m
        places = self._places[train.address]
        while places and places[-1][1] <= front_max_m:
            places.pop()
        places.append((now_ns, front_max_m))
        while places[0][0] < now_ns - self.checker.rules.age_max_ns:
            places.popleft()

    def _lately_m(self, train: TrueTrain) -> float:
        """Return the greatest position of the train's front within the maximum age of an authority.

        The master tells a train that rolls back to stay where it stood when it reported.
        """
        self.notes_place(train)
        return self._places[train.address][0][1]

    def _in_its_area(self, address: int, grant: BrakeLoopGrant) -> None:
        """Check invariant 27: an authority ends at its area's border at the latest.

        Only the master behind the border grants what lies beyond.
        """
        area = self.drawn.cast.line.area(grant.area)
        if grant.end_m > area.end_m:
            raise ViolationError(
                "27",
                f"train {address} may go to {grant.end_m:.1f} m by area {grant.area}, which is "
                f"from {area.start_m:.1f} m to {area.end_m:.1f} m",
            )

    def _objects_move(self, moved: list[tuple[int, bool]]) -> None:
        for number, locked in moved:
            thing = self.track.objects[number]
            if thing.locked is not locked:
                self.net.say(f"object {number}", "is locked" if locked else "is free to move")
                if locked and thing.release_wanted:
                    raise ViolationError("23", f"object {number} locks although it may stand open")
                thing.locked = locked
        self.check_objects()

    def check_objects(self) -> None:
        """Check invariant 23: no train stands on or may enter an object that may move."""
        self.checker.looked["23"] += 1
        for thing in self.track.objects.values():
            if thing.locked:
                continue
            for train in self.trains.values():
                if train.on_line and train.rear_m < thing.end_m:
                    self._clear_of(train, thing.number, thing.start_m)

    def _clear_of(self, train: TrueTrain, number: int, start_m: float) -> None:
        """Check that a train cannot run onto an unlocked object.

        A train that stands in the object now, or stood there lately, keeps it from moving and may
        stay. A train driven by hand runs on sight and is bound only by its authorities.
        """
        reach_m = self.checker.granted_m(train) if train.shunts else self.checker.reach_m(train)
        stood_m = self._lately_m(train)
        if train.front_m > start_m:
            # After rolling back, the train may come again to where it stood before.
            stood_m = max(stood_m, train.foremost_front_max_m)
        if reach_m > max(start_m, stood_m):
            raise ViolationError(
                "23",
                f"object {number} at {start_m:.1f} m is not locked, and train {train.address}, "
                f"front {train.front_m:.2f} m, may go to {reach_m:.2f} m",
            )
