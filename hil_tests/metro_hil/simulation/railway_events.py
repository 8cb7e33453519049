"""Random events on the railway besides faults of nodes and network.

Objects request their release. People close track and give commands. Trains roll back, lose their
position, or leave the line at its end and come back at its start.
"""

import random
from collections.abc import Callable, Sequence
from typing import Final

from metro_hil.simulation.depot import SEEN_NS, Depot, seen_gone
from metro_hil.simulation.line_world import LineWorld
from metro_hil.simulation.manual_driving import ByHand
from metro_hil.simulation.orders import ORDER_REPEATS, TrainOrder
from metro_hil.simulation.removal import Sidings
from zenoh_config.messages import SpeedRestriction
from zenoh_config.t2t import OrderKind

NS_PER_S: Final = 1_000_000_000
SLOW_MPS: Final = 4.0
ALL_CLEAR_NS: Final = (0, 4 * NS_PER_S, 9 * NS_PER_S)
"""Times at which all commands are cancelled. They repeat because a process may be stopped for 8
s."""
APART_NS: Final = 300_000_000
"""Time between the commands for two successive trains. Of many commands sent at once, later ones
would overtake the first, and the receiver would reject those as old."""


Thing = tuple[str, Callable[[], object]]


def some_of(things: Sequence[Thing], rng: random.Random) -> list[Thing]:
    """Choose each kind of event with even odds, at least one, and give each a random weight."""
    kinds = dict(things)
    chosen = [name for name in kinds if rng.random() < 0.5] or [rng.choice(list(kinds))]
    return [(name, kinds[name]) for name in chosen for _ in range(rng.choice((1, 1, 2, 4, 8)))]


class RailwayEvents:
    """Starts random events on a simulated line; `calm` undoes all of them and starts no new one."""

    def __init__(self, world: LineWorld, seed: int) -> None:
        self.world = world
        self.counts: dict[str, int] = {}
        self._rng = random.Random(seed ^ 0x315C)
        self._over = False
        self._things: list[Thing] = [
            ("rolls back", self._roll_back),
            ("rolls back", self._roll_back),
            ("jog", self._jog),
            ("loses its place", self._lose_place),
            ("closure", self._close),
            ("restriction", self._restrict),
            ("stop order", self._stop_order),
            ("switch order", self._switch_order),
            ("out of service", self._out_of_service),
            ("removal in error", self._remove_in_error),
        ]
        depot = Depot(world, self._rng)
        self._things += 3 * [("leaves the line", depot.leaves)]
        if world.drawn.ordered:
            self._things.append(("out of service by order", self._retire))
        if world.track.objects:
            self._things += 4 * [("object wish", self._request_release)]
        self._sidings = Sidings(world, self._rng)
        if world.drawn.sidings:
            self._things += 2 * [("taken off the line", self._sidings.leaves)]
        self._by_hand = ByHand(world, self._rng)
        if world.drawn.by_hand:
            self._things += 3 * [("driven by hand", self._by_hand.drives)]
        if world.drawn.disturbed:
            self._things += 2 * [("counter disturbed", self._disturb)]
        if world.drawn.choosy:
            self._things = some_of(self._things, random.Random(seed ^ 0xC4005))

    def begin(self) -> None:
        wait_s = self._rng.expovariate(1.0 / self.world.drawn.between_s)
        self.world.net.at(self.world.net.now_ns + int(wait_s * NS_PER_S), self._next_event)

    def calm(self) -> None:
        """End all closures, requests and commands.

        A person then asks for the removal of trains that ran on without radio. Otherwise other
        trains would wait behind their old position.
        """
        self._over = self._sidings.over = self._by_hand.over = True
        for thing in self.world.track.objects.values():
            thing.release_wanted = False
        for each in self.world.trains.values():
            each.localised, each.out_of_service = each.on_line, False
        crew = self.world.t2t
        crew.closed, crew.restrictions, crew.orders = (), (), []
        self.world.track.disturbed = frozenset()
        net = self.world.net
        for wait_ns in ALL_CLEAR_NS:
            net.at(net.now_ns + wait_ns, self._cancel_all)
        crew.removals.clear()
        net.at(net.now_ns + SEEN_NS, self._report_gone_trains)

    def _report_gone_trains(self, _: object) -> None:
        for train in self.world.trains.values():
            if train.on_line:
                seen_gone(self.world, train)

    def _cancel_all(self, _: object) -> None:
        for place, train in enumerate(self.world.trains):
            self._cancel(train, place * APART_NS)

    def _cancel(self, train: int, wait_ns: int) -> None:
        def says(_: object) -> None:
            self._order(OrderKind.GO, train, left=20)
            if self.world.drawn.ordered:
                self._order(OrderKind.IN_SERVICE, train, left=20)

        self.world.net.at(self.world.net.now_ns + wait_ns, says)

    def _next_event(self, _: object) -> None:
        if self._over:
            return
        name, call = self._rng.choice(self._things)
        # An event that returns False did not happen.
        if call() is not False:
            self.counts[name] = self.counts.get(name, 0) + 1
        self.begin()

    def _later(self, least_s: float, most_s: float, call: Callable[[], None]) -> None:
        at_ns = self.world.net.now_ns + int(self._rng.uniform(least_s, most_s) * NS_PER_S)
        self.world.net.at(at_ns, lambda _: None if self._over else call())

    def _say(self, what: str) -> None:
        self.world.net.say("railway", what)

    # -- things ------------------------------------------------------------------------------------

    def _roll_back(self) -> None:
        """Let a train at rest roll back, as after a brake that is applied too late."""
        standing = [
            t
            for t in self.world.trains.values()
            if t.motion.speed_mps == 0.0 and t.on_line and not t.shunts
        ]
        if not standing:
            return
        train = self._rng.choice(standing)
        motion = train.motion
        room_m = self.world.checker.rules.roll_back_m - motion.rolled_m + motion.jogged_m
        if motion.accel_mps2 <= 0.0 and room_m > 0.0:
            self.world.notes_place(train)
            motion.back_m = self._rng.uniform(0.0, room_m)
            self._say(f"train {train.address} rolls back {motion.back_m:.2f} m")

    def _jog(self) -> None:
        """Let a train at rest jog back as far as its authority allows."""
        for train in self.world.trains.values():
            held = self.world.checker.held.get(train.address)
            motion = train.motion
            stands = motion.speed_mps == 0.0 and motion.accel_mps2 <= 0.0
            if held and stands and train.on_line and not train.shunts:
                rear_m = train.reading().rear_min_m
                room_m = min(
                    self.world.checker.rules.jog_m - motion.rolled_m,
                    rear_m - min(grant.rear_m for grant in held.values()),
                )
                if room_m > 0.0:
                    self.world.notes_place(train)
                    motion.back_m = self._rng.uniform(0.0, room_m)
                    # This jog replaces what is left of the previous one.
                    motion.jogged_m = min(motion.jogged_m, motion.rolled_m) + motion.back_m
                    self._say(f"train {train.address} sets back {motion.back_m:.2f} m")

    def _lose_place(self) -> None:
        train = self._rng.choice(list(self.world.trains.values()))
        train.localised = False
        self._say(f"train {train.address} loses its place")

        def found() -> None:
            train.localised = train.on_line
            self._say(f"train {train.address} knows its place again")

        self._later(0.2, 20.0, found)

    def _request_release(self) -> None:
        thing = self._rng.choice(list(self.world.track.objects.values()))
        thing.release_wanted = True
        self._say(f"object {thing.number} wants to be released")

        def content() -> None:
            thing.release_wanted = False
            self._say(f"object {thing.number} wants nothing any more")

        self._later(0.3, 25.0, content)

    def _stretch(self, speed_mps: float) -> SpeedRestriction:
        end_m = self.world.drawn.cast.line.end_m
        start_m = self._rng.uniform(0.0, end_m - 200.0)
        return SpeedRestriction(start_m, start_m + self._rng.uniform(20.0, 200.0), speed_mps)

    def _close(self) -> None:
        closed, crew = self._stretch(1.0), self.world.t2t
        crew.closed = crew.closed[-2:]
        self._say(f"closed from {closed.start_m:.0f} m to {closed.end_m:.0f} m")
        self.world.closes(closed)

        self._later(2.0, 30.0, lambda: self.world.opens(closed))

    def _restrict(self) -> None:
        slow, crew = self._stretch(SLOW_MPS), self.world.t2t
        crew.restrictions = (*crew.restrictions[-2:], slow)

        def lifted() -> None:
            crew.restrictions = tuple(each for each in crew.restrictions if each is not slow)

        self._later(5.0, 40.0, lifted)

    def _disturb(self) -> None:
        """Disturb an axle counter that may have missed an axle; inspection ends the disturbance."""
        track = self.world.track
        number = self._rng.choice(track.line.sections).number
        track.disturbed |= {number}
        self._say(f"the counter of section {number} is disturbed")

        def looked_at() -> None:
            track.disturbed -= {number}
            self._say(f"the counter of section {number} is trusted again")

        self._later(0.5, 60.0, looked_at)

    def _stop_order(self) -> None:
        train = self._rng.choice(list(self.world.trains))
        self._order(OrderKind.STOP, train)
        self._say(f"supervision stops train {train}")
        self._later(1.0, 15.0, lambda: self._order(OrderKind.GO, train))

    def _order(self, kind: OrderKind, train: int, left: int = ORDER_REPEATS) -> None:
        """Give a command about the train in every area."""
        for area in self.world.drawn.cast.line.areas:
            self.world.t2t.orders.append(TrainOrder(kind, area.number, train, left))

    def _remove_in_error(self) -> bool:
        """Ask by mistake for the removal of a train that is still on the line."""
        there = [t for t in self.world.trains.values() if t.on_line and not t.shunts]
        if not there:
            return False
        self.world.removes(self._rng.choice(there).address)
        return True

    def _switch_order(self) -> None:
        train = self._rng.choice(list(self.world.trains))
        area = self._rng.choice(self.world.drawn.cast.line.areas).number
        self.world.t2t.orders.append(TrainOrder(OrderKind.SWITCH_MASTER, area, train))
        self._say(f"supervision wants train {train} to command area {area}")

    def _out_of_service(self) -> None:
        train = self._rng.choice(list(self.world.trains.values()))
        train.out_of_service = True

        def back() -> None:
            train.out_of_service = False

        self._later(2.0, 20.0, back)

    def _retire(self) -> None:
        """Take a train out of service by command; it obeys in whatever area it is."""
        train = self._rng.choice(list(self.world.trains))
        self._order(OrderKind.OUT_OF_SERVICE, train)
        self._say(f"supervision takes train {train} out of service")
        self._later(2.0, 60.0, lambda: self._order(OrderKind.IN_SERVICE, train))
