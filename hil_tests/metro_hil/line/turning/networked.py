"""One train of a service in real time: its own program, with masters and wayside over zenoh.

The program has the train with its bus and its controller. Their time is that of the machine: they
never run ahead of it, and catch up after a delay. So a message is received at the instant at which
it arrived, and the age of an authority is true.
"""

from collections import deque
from collections.abc import Callable, Collection, Iterable, Sequence
from contextlib import closing
from dataclasses import replace
from math import inf
from pathlib import Path
from typing import Final

import msgspec

from firmware_py.clock.clock import Clock, WallClock
from firmware_py.clock.realtime import collect_garbage, enter_realtime
from firmware_py.interrupts import never
from firmware_py.ports import LinkCounters, RadioMessage, TunableRadioPort
from firmware_py.radio.credentials import Credentials
from firmware_py.radio.line_keys import line_keys
from firmware_py.radio.zenoh_radio import SessionRole, open_radio
from firmware_py.storage.checked_store import CheckedStore
from firmware_py.trackdb import LineMap
from firmware_py.trackdb.network import TrackNetwork
from firmware_py.trackdb.paths import Path as TrackPath
from firmware_py.trackdb.version import database_version
from metro_hil.line.turning.central_orders import CentralOrders
from metro_hil.line.turning.masters import ShiftedPort
from metro_hil.line.turning.plan import FleetPlan
from metro_hil.line.turning.train import TurningTrain
from metro_hil.model.end_condition import ARRIVED, INTERRUPTED
from metro_hil.model.mission import Journey
from metro_hil.run.lockstep import Lockstep
from plant_emulator.wayside.interlocking import SharedNetwork, SignalBox
from plant_emulator.wayside.network_places import (
    TrainPlace,
    TrainPresence,
    WaysideAnswer,
    key_of_answer,
    key_of_place,
    read_answer,
)
from plant_emulator.wayside.route_objects import AXLES, divided, shared_tracks
from plant_emulator.world import TrainScenario
from vobc.config import VobcConfig
from vobc.process.line_command import LineCommand, commanded
from vobc.train_to_train.train import TrainCore
from vobc.train_to_train.vocabulary import Role, T2tConfig, TrainMemory
from vobc.wire.line_radio import LineRadio
from zenoh_config import keys
from zenoh_config.codec import BENCH_KEY, SafetyKey
from zenoh_config.keys import matches

STEP_NS: Final = 10_000_000
"""Time for which the train runs between two looks at the clock."""
PLACE_NS: Final = 50_000_000
"""Time between two reports of the train's place, in which the wayside also sets routes."""
ASK_NS: Final = 200_000_000
"""Time between two questions of a train that is not on the network."""
FAREWELL_NS: Final = 2_000_000_000
"""Time for the wayside to confirm that it knows that the train is gone."""
GARBAGE_NS: Final = 1_000_000_000
"""Time between two garbage collections, because a real-time run disables the automatic one."""
INBOX_MESSAGES: Final = 8192
NS_PER_S: Final = 1_000_000_000


def no_orders() -> Sequence[str]:
    """No orders, for a train that no bench strikes."""
    return ()


class NetworkSession:
    """The train's session, by the time of the network. Answers of the wayside are kept apart.

    The messages of the line can be cut, the places and the answers to them cannot, because they
    belong to the emulated rails. What is sent in a cut arrives at its end, as over TCP.
    """

    def __init__(self, radio: TunableRadioPort, network: str, train: int, clock: Clock) -> None:
        self.counters: LinkCounters = radio.counters
        self.zero_ns: int | None = None
        """Time of the clock at which that of the network was 0; None before the first answer."""
        self.newest: WaysideAnswer | None = None
        """The newest answer of the wayside."""
        self.order: RadioMessage | None = None
        """The newest order of the centre to the train on its present path."""
        self.orders = ""
        """Key expression of these orders; empty without a path."""
        self._runs = False
        self._radio, self._clock = radio, clock
        self._place, self._answer = key_of_place(network, train), key_of_answer(network, train)
        self._waiting: list[RadioMessage] = []
        self._is_mute = self._is_deaf = False
        self._held_out: deque[tuple[str, bytes]] = deque(maxlen=INBOX_MESSAGES)
        self._held_in: deque[RadioMessage] = deque(maxlen=INBOX_MESSAGES)

    @property
    def now_ns(self) -> int:
        """Time of the network. Call it after the first answer."""
        assert self.zero_ns is not None
        return self._clock.now_ns() - self.zero_ns

    def listen(self, subscriptions: Collection[str]) -> None:
        own = (self._answer, self.orders) if self.orders else (self._answer,)
        self._radio.listen((*own, *subscriptions))

    def send(self, now_ns: int, key: str, payload: bytes) -> None:
        if self._is_mute:
            self._held_out.append((key, payload))
        else:
            self._radio.send(self._clock.now_ns(), key, payload)

    def cut(self, *, is_mute: bool, is_deaf: bool) -> None:
        """Hold back what the train sends or receives; pass on what is not cut any more."""
        self._is_mute, self._is_deaf = is_mute, is_deaf
        if not is_mute:
            for key, payload in self._held_out:
                self._radio.send(self._clock.now_ns(), key, payload)
            self._held_out.clear()
        if not is_deaf and self._held_in:
            now_ns = self.now_ns
            self._waiting += [each._replace(stamp_ns=now_ns) for each in self._held_in]
            self._held_in.clear()

    def receive(self, now_ns: int) -> Sequence[RadioMessage]:
        """Messages that arrived up to an instant of the network."""
        self.take()
        due = [each for each in self._waiting if each.stamp_ns <= now_ns]
        self._waiting = [each for each in self._waiting if each.stamp_ns > now_ns]
        return due

    def take(self) -> None:
        """Receive, and evaluate answers of the wayside."""
        for message in self._radio.receive(self._clock.now_ns()):
            if message.key == self._answer:
                answer = read_answer(message)
                if answer is not None:
                    self.newest = answer
                    self._set_zero(message.stamp_ns - answer.now_ns)
            elif self.orders and not self._is_deaf and matches(self.orders, message.key):
                self.order = message
            elif self.zero_ns is not None:
                stamp_ns = message.stamp_ns - self.zero_ns
                waiting = self._held_in if self._is_deaf else self._waiting
                waiting.append(message._replace(stamp_ns=stamp_ns))

    @property
    def enters(self) -> bool:
        """Whether the wayside keeps room for the train."""
        return self.newest is not None and self.newest.enters

    def waits(self, trip: int) -> bool:
        """Whether a standing train does not depart yet; so until the answer to its trip."""
        return self.newest is None or self.newest.trip != trip or self.newest.waits

    def _set_zero(self, zero_ns: int) -> None:
        """Take the least difference, that of the fastest answer, until the train runs."""
        if not self._runs:
            self.zero_ns = zero_ns if self.zero_ns is None else min(self.zero_ns, zero_ns)

    def tell(self, place: TrainPlace) -> None:
        """Report the true place of the train to the wayside."""
        self._runs = self._runs or place.presence is TrainPresence.PRESENT
        self._radio.send(self._clock.now_ns(), self._place, msgspec.json.encode(place))

    def close(self) -> None:
        """Do nothing: the program closes its session at its end."""


class NetworkedMasters:
    """The part of one train in the lines of all paths of its service."""

    def __init__(
        self,
        network: TrackNetwork,
        paths: Iterable[TrackPath],
        t2t: T2tConfig,
        radio: NetworkSession,
        *,
        boot: int,
        key: SafetyKey = BENCH_KEY,
    ) -> None:
        """Args:
        boot: number of starts of the train; it must increase with every start.
        """
        self._t2t, self._port, self.key = t2t, radio, key
        self._paths = {path.line.name: path for path in paths}
        self.shared = shared_tracks(self._paths.values())
        self._areas = {
            name: divided(network, path, self.shared) for name, path in self._paths.items()
        }
        self._stores = {name: CheckedStore(None, TrainMemory) for name in self._paths}
        self._boot = boot
        self.radio: LineRadio | None = None
        """The part of the train in the line of its present path."""

    def config_of(self, config: VobcConfig, train: int) -> VobcConfig:
        return replace(commanded(config, self._t2t.timers), address=train)

    def enter(self, line: LineMap, config: VobcConfig, began_ns: int) -> LineCommand:
        """The part of the train in the line of the path that it enters."""
        radio, port = self.join(line.name, config.address, began_ns)
        return LineCommand(radio, port, config, line, axles=AXLES)

    def join(self, name: str, train: int, began_ns: int) -> tuple[LineRadio, TunableRadioPort]:
        """The core of the train in the line of a path, and its port by the time of its trip."""
        store = self._stores[name]
        memory = store.value or TrainMemory(boot=self._boot)
        core = TrainCore(self._t2t, self._areas[name], address=train, memory=memory, start_ns=0)
        database = database_version(self._paths[name].line)
        self._port.orders = keys.orders(name, train)
        radio = self.radio = LineRadio(core, name, store.put, key=self.key, database=database)
        port = ShiftedPort(self._port, began_ns)
        port.listen(radio.subscriptions)
        return radio, port

    def leave(self, path: str, train: int) -> None:
        """The train sends and receives nothing on this path any more."""
        self.radio, self._port.orders = None, ""
        self._port.listen(())

    def commands(self) -> tuple[int, ...]:
        """Numbers of the areas that the train commands."""
        roles = {} if self.radio is None else self.radio.roles
        return tuple(area for area, role in sorted(roles.items()) if role is Role.MASTER)


class _WaitingTrain(TurningTrain):
    """A train that departs only when the wayside lets it, because its box knows no other train. It
    obeys the centre of the network.
    """

    session: NetworkSession
    key: SafetyKey
    orders: CentralOrders

    def _open(
        self, index: int, scenario: TrainScenario, journey: Journey, shared: SharedNetwork
    ) -> Lockstep:
        bench = super()._open(index, scenario, journey, shared)
        railway = bench.plant.railway
        self.orders = CentralOrders(self.session, railway, journey.line, self.key)
        return bench

    def _be_commanded(self, bench: Lockstep, command: LineCommand) -> None:
        super()._be_commanded(bench, command)
        waits = self.session.waits(self.trips[-1].index)
        command.waits = command.waits or (not self.moving and waits)
        self.orders.obey(self.number)


class NetworkedTrain:
    """A train of a service that runs in real time."""

    def __init__(
        self,
        plan: FleetPlan,
        number: int,
        folder: Path | None,
        t2t: T2tConfig,
        endpoint: str,
        told: Callable[[str], None],
        secure: Credentials | None = None,
    ) -> None:
        """Args:
        endpoint: address of the wayside.
        told: receives a line of text about what happens.
        secure: of the train on a secured line.

        Raises RadioError for an invalid endpoint.
        """
        clock = WallClock()
        self._plan, self._clock, self._told = plan, clock, told
        self._session = open_radio(
            SessionRole.TRAIN,
            endpoint,
            (key_of_answer(plan.network.name, number),),
            clock,
            inbox_messages=INBOX_MESSAGES,
            secure=secure,
        )
        self._radio = NetworkSession(self._session, plan.network.name, number, clock)
        paths = {each.trip.path.line.name: each.trip.path for each in plan.trips}
        self._masters = NetworkedMasters(
            *(plan.network, paths.values(), t2t, self._radio),
            boot=clock.epoch_ns() // NS_PER_S,
            key=line_keys(secure),
        )
        # The interlocking is that of the wayside. This copy of it has no other train, and nothing
        # that it sets has an effect on the network.
        box = SignalBox(plan.network)
        box.shared = self._masters.shared
        self.train = _WaitingTrain(plan, number, box, folder, self._masters)
        self.train.session, self.train.key = self._radio, self._masters.key
        self.late_s = 0.0
        """Greatest delay of the train behind the clock."""
        self.entered_ns = 0
        """Time of the network at which the train entered."""
        self._commands: tuple[int, ...] = ()
        self._end_m: float | None = None
        """End of the last authority that the controller held while it ran."""

    def run(
        self,
        interrupted: Callable[[], bool] = never,
        *,
        priority: int = 0,
        orders: Callable[[], Sequence[str]] = no_orders,
    ) -> str:
        """Make all trips, and return how that ended.

        Args:
            priority: SCHED_FIFO priority if the host permits it; 0: none.
            orders: returns the new orders of the bench, see `obey`.
        """
        if priority:
            enter_realtime(priority)
        with closing(self._session), closing(self.train):
            if not self._enter(interrupted):
                return INTERRUPTED
            now_ns = self.entered_ns
            while not self.train.gone:
                if interrupted():
                    return INTERRUPTED
                now_ns += STEP_NS
                zero_ns = self._radio.zero_ns
                assert zero_ns is not None
                self._clock.wait_until(zero_ns + now_ns)
                self.late_s = max(self.late_s, (self._radio.now_ns - now_ns) / NS_PER_S)
                for order in orders():
                    self.obey(order)
                self._advance(now_ns)
                if priority and (now_ns - self.entered_ns) % GARBAGE_NS == 0:
                    collect_garbage(now_ns)
            self._take_leave()
        return ARRIVED

    def obey(self, order: str) -> None:
        """Strike the controller or its radio; the train itself goes on.

        Args:
            order: `kill` ends the controller for good, `stop` stops it until `go-on`. `cut`, `mute`
                and `deafen` hold back messages both ways, from the train or to it, until `heal`.
        """
        if self.train.bench is None:
            self._told(f"is not on the network, so it ignores: {order}")
            return
        self._told(f"obeys: {order}")
        actions: dict[str, Callable[[], None]] = {
            "kill": self.train.kill,
            "stop": self.train.stop,
            "go-on": self.train.go_on,
        }
        if order in actions:
            actions[order]()
        else:
            both = order == "cut"
            self._radio.cut(is_mute=both or order == "mute", is_deaf=both or order == "deafen")

    def _enter(self, interrupted: Callable[[], bool]) -> bool:
        """Wait until the train is due and has room; False after an interrupt."""
        radio, due_ns, asked_ns = self._radio, self._plan.due_ns(self.train.number, 0), -inf
        heard = False
        while not interrupted():
            if not heard and radio.zero_ns is not None:
                heard = True
                self._told("receives the wayside, and waits until it is due and has room")
            is_due = heard and radio.now_ns >= due_ns
            if is_due and radio.enters:
                self.entered_ns = radio.now_ns
                self._told("enters the network")
                return self.train.enter(self.entered_ns)
            now_ns = self._clock.now_ns()
            if now_ns >= asked_ns + ASK_NS:
                asked_ns = now_ns
                radio.tell(self._first_place(TrainPresence.DUE if is_due else TrainPresence.AHEAD))
            self._clock.wait_until(now_ns + STEP_NS)
            radio.take()
        return False

    def _advance(self, now_ns: int) -> None:
        train, trips = self.train, len(self.train.trips)
        ended = [trip.ended_s is not None for trip in train.trips]
        train.advance(now_ns)
        for trip, was_ended in zip(train.trips, ended, strict=False):
            if trip.ended_s is not None and not was_ended:
                error_m = trip.stops[-1].error_m if trip.stops else None
                stop = "" if error_m is None else f", stop error {100.0 * error_m:+.1f} cm"
                self._told(f"arrives at {trip.end} after {trip.ended_s - trip.began_s:.1f} s{stop}")
        if len(train.trips) > trips:
            trip = train.trips[-1]
            how = "changes ends" if trip.turned else "goes on"
            self._told(f"{how} at {trip.start}, trip {trip.index + 1} of {len(self._plan.trips)}")
        commands = self._masters.commands()
        if commands != self._commands:
            self._commands = commands
            areas = ", ".join(str(area) for area in commands) or "none"
            self._told(f"commands areas: {areas}")
        if train.bench is not None and (now_ns - self.entered_ns) % PLACE_NS == 0:
            self._radio.tell(self._present_place(now_ns))

    def _first_place(self, presence: TrainPresence) -> TrainPlace:
        trip = self._plan.trips[0]
        front_m, length_m = trip.scenario.start.stop_m, trip.scenario.train.length_m
        stops_m = tuple(stop.stop_m for stop in trip.journey.stops)
        return TrainPlace(
            *(presence, 0, trip.trip.path.line.name, front_m, front_m - length_m, front_m),
            *(trip.journey.end.stop_m, stops_m, trip.trip.layover_s),
        )

    def _present_place(self, now_ns: int) -> TrainPlace:
        train, record = self.train, self.train.trips[-1]
        trip, front_m = self._plan.trips[record.index], train.place_m
        rear_m, end_m = front_m - trip.scenario.train.length_m, self._reach_m()
        return TrainPlace(
            presence=TrainPresence.PRESENT,
            trip=record.index,
            path=trip.trip.path.line.name,
            front_m=front_m,
            rear_m=rear_m,
            end_m=front_m if end_m is None else end_m,
            to_m=trip.journey.end.stop_m,
            stops_m=tuple(stop.stop_m for stop in trip.journey.stops),
            wait_s=train.wait_s,
            at_s=now_ns / NS_PER_S,
        )

    def _reach_m(self) -> float | None:
        """End of the authority by which the train moves. A controller that does not run leaves none
        to a train that stands."""
        train = self.train
        if not train.silent:
            self._end_m = train.authority_end_m
        elif not train.moving:
            return None
        return self._end_m

    def _take_leave(self) -> None:
        """Tell the wayside that the train is gone, until it answers."""
        radio, end_ns = self._radio, self._clock.now_ns() + FAREWELL_NS
        while (radio.newest is None or radio.newest.is_known) and self._clock.now_ns() < end_ns:
            radio.tell(self._first_place(TrainPresence.GONE))
            self._clock.wait_until(self._clock.now_ns() + ASK_NS)
            radio.take()
