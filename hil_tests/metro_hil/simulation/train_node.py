"""A train's controller in the simulation: the protocol under test and a simple driver."""

import math
from collections.abc import Sequence
from typing import Any, Final, Protocol

from metro_hil.simulation.checker import Checker
from metro_hil.simulation.driving import DrivingTarget, demand_mps2, must_trip
from metro_hil.simulation.event_queue import SimulatedNetwork
from metro_hil.simulation.node import NodeStep, QueuedMessage, SimulatedNode
from metro_hil.simulation.true_train import BrakeLoopGrant, OdometryReading, TrueTrain

CONTROL_NS: Final = 200_000_000
SILENCE_NS: Final = 300_000_000
"""Time without a sign of its controller after which a brake unit applies the brake itself."""
STOPPING_MARGIN_M: Final = 2.0
"""Distance before the end of authority at which ATO stops."""
SHUNTING_MPS: Final = 5.0
SHUNTING_MPS2: Final = 0.5
RELEASE_M: Final = 5.0
"""Length of authority at which an emergency brake at standstill is released."""


class Protocolled(Protocol):
    """The protocol of one train, as its controller uses it."""

    def step(self, now_ns: int, heard: Sequence[Any], reading: OdometryReading) -> NodeStep: ...

    @property
    def grants(self) -> Sequence[BrakeLoopGrant]:
        """Authorities that must all hold at once; none: the train must not move.

        The object is the same until they change.
        """


class RadioListener(Protocol):
    """Checks the messages of trains."""

    def stepped(
        self,
        address: int,
        now_ns: int,
        true_ns: int,
        heard: Sequence[Any],
        letters: Sequence[QueuedMessage],
    ) -> None: ...

    def holds(self, address: int, grant: BrakeLoopGrant) -> None: ...


class TrainNodeController:
    """State machine that runs on a train's node."""

    __slots__ = ("_checker", "_driver", "_net", "_train", "grants", "listener", "protocol")

    def __init__(
        self,
        protocol: Protocolled,
        driver: "SimulatedDriver",
        net: SimulatedNetwork,
        checker: Checker,
    ) -> None:
        self.protocol = protocol
        self._train, self._driver = driver.train, driver
        self._net, self._checker = net, checker
        self.listener: RadioListener | None = None
        self.grants: Sequence[BrakeLoopGrant] = ()
        """Authorities in the brake loop."""

    def step(self, now_ns: int, heard: Sequence[Any]) -> NodeStep:
        self._train.motion.advance(self._net.now_ns)
        turn = self.protocol.step(now_ns, heard, self._train.reading())
        if self.listener is not None:
            self.listener.stepped(
                self._train.address, now_ns, self._net.now_ns, heard, turn.letters
            )
        grants = self.protocol.grants
        if grants is self.grants:
            return turn
        return turn._replace(apply=lambda: self._apply(grants, now_ns))

    def _apply(self, grants: Sequence[BrakeLoopGrant], now_ns: int) -> None:
        before, self.grants = self.grants, grants
        address = self._train.address
        areas = {grant.area for grant in grants}
        for grant in before:
            if grant.area not in areas:
                self._checker.gave_up(address, grant.area)
        for grant in grants:
            if grant not in before:
                self._net.trace.note(int(grant.end_m * 1000.0))
                if self._net.tell is not None:
                    self._tell(grant)
                self._checker.accepted(address, grant, now_ns, whole=self.listener is None)
                if self.listener is not None:
                    self.listener.holds(address, grant)
        self._driver.supervises()

    def _tell(self, grant: BrakeLoopGrant) -> None:
        self._net.say(
            f"train {self._train.address}",
            f"may go to {grant.end_m:.2f} m: term {grant.term}, area {grant.area}, from "
            f"{grant.issuer}",
        )


class SimulatedDriver:
    """Control cycle of one train: watchdog, supervision, ATO and station stops."""

    __slots__ = (
        *("_age_max_ns", "_checker", "_dwell_ns", "_net", "_node", "_speed_max_mps", "_stops_m"),
        "train",
    )

    def __init__(
        self,
        train: TrueTrain,
        node: SimulatedNode,
        net: SimulatedNetwork,
        checker: Checker,
        *,
        stops_m: Sequence[float],
        dwell_ns: int,
        speed_max_mps: float,
    ) -> None:
        self.train = train
        self._node, self._net, self._checker = node, net, checker
        self._stops_m, self._dwell_ns = stops_m, dwell_ns
        self._speed_max_mps = speed_max_mps
        self._age_max_ns = checker.rules.age_max_ns

    def restart(self) -> None:
        """Brake at the start of a new incarnation, which has none of the former authorities.

        The brake acts from the first output on, before the train reports how far it can still come.
        """
        self._checker.gave_up(self.train.address)
        if self.train.on_line and not self.train.shunts:
            self.train.motion.advance(self._net.now_ns)
            self._trip(self._net.now_ns, "restarts")

    def cycle(self, _: object) -> None:
        """Bring the motion forward, check it, and set the demand until the next cycle."""
        net, train = self._net, self.train
        now_ns = net.now_ns
        train.motion.advance(now_ns)
        if train.shunts:
            self._shunt(now_ns)
        elif train.on_line:
            self._drive(now_ns)
            self._checker.moved(train)
        net.at(now_ns + CONTROL_NS, self.cycle)

    def _shunt(self, now_ns: int) -> None:
        motion = self.train.motion
        self.train.heard_ns = now_ns
        if motion.emergency and motion.speed_mps == 0.0:
            motion.release_emergency()
        motion.demand(now_ns, self._by_hand_mps2(motion.front_m, motion.speed_mps))

    def _by_hand_mps2(self, front_m: float, speed_mps: float) -> float:
        if self.train.shunts_to_m < math.inf:
            return demand_mps2(
                front_m, speed_mps, DrivingTarget(SHUNTING_MPS, self.train.shunts_to_m)
            )
        return SHUNTING_MPS2 if speed_mps < SHUNTING_MPS else 0.0

    def _drive(self, now_ns: int) -> None:
        train, motion = self.train, self.train.motion
        grants, age_ratio = self.in_force(now_ns)
        if not grants or not train.localised:
            self._trip(now_ns, "has no authority" if train.localised else "is lost")
            machine = self._node.machine
            if machine is None or (isinstance(machine, TrainNodeController) and not machine.grants):
                self._checker.gave_up(train.address)
            return
        end_m = min(grant.end_m for grant in grants)
        reading = train.reading()
        if motion.emergency:
            if motion.speed_mps == 0.0 and end_m > reading.front_max_m + RELEASE_M:
                motion.release_emergency()
                self._net.say(f"train {train.address}", "releases its emergency brake")
            return
        if self._is_too_fast(now_ns, end_m):
            return
        if age_ratio > 0.6:
            motion.demand(now_ns, -0.8)
            return
        motion.demand(now_ns, self._wanted_mps2(now_ns, reading, end_m))

    def supervises(self) -> None:
        """Supervise a new authority before the train acknowledges it with how far it may come."""
        train, now_ns = self.train, self._net.now_ns
        grants, _ = self.in_force(now_ns)
        if grants and train.on_line and train.localised and not train.shunts:
            self._is_too_fast(now_ns, min(grant.end_m for grant in grants))

    def _is_too_fast(self, now_ns: int, end_m: float) -> bool:
        """Apply the emergency brake if the train is too fast for this end; tell whether it is."""
        motion, front_max_m = self.train.motion, self.train.reading().front_max_m
        if not must_trip(front_max_m, motion.speed_mps, end_m, accel_mps2=motion.accel_mps2):
            return False
        self._trip(now_ns, f"is too fast for its authority's end at {end_m:.2f} m")
        return True

    def in_force(self, now_ns: int) -> tuple[Sequence[BrakeLoopGrant], float]:
        """Return the authorities in force, and the age of the oldest as a share of the limit."""
        node, train = self._node, self.train
        if self._net.runs(node.address):
            train.heard_ns = now_ns
        elif now_ns - train.heard_ns > SILENCE_NS:
            return (), 0.0
        machine = node.machine
        if not isinstance(machine, TrainNodeController) or not machine.grants:
            return (), 0.0
        grants = machine.grants
        local_ns = node.clock.local_ns(now_ns)
        age_ns = max(local_ns - grant.stamp_ns for grant in grants)
        if age_ns > self._age_max_ns:
            self._checker.gave_up(train.address)
            return (), 0.0
        return grants, age_ns / self._age_max_ns

    def _trip(self, now_ns: int, why: str) -> None:
        train = self.train
        if train.motion.emergency:
            return
        if train.motion.speed_mps > 0.0:
            train.emergencies += 1
            self._net.say(f"train {train.address}", f"{why}: emergency brake")
        train.motion.apply_emergency(now_ns)

    def _wanted_mps2(self, now_ns: int, reading: OdometryReading, end_m: float) -> float:
        train, motion = self.train, self.train.motion
        stop_m = end_m - STOPPING_MARGIN_M - (reading.front_max_m - motion.front_m)
        if train.next_stop < len(self._stops_m):
            station_m = self._stops_m[train.next_stop]
            if motion.speed_mps == 0.0 and abs(motion.front_m - station_m) < 3.0:
                if train.dwell_until_ns == 0:
                    train.dwell_until_ns = now_ns + self._dwell_ns
                if now_ns < train.dwell_until_ns:
                    return -0.8
                train.dwell_until_ns = 0
                train.next_stop += 1
            else:
                stop_m = min(stop_m, station_m)
        return demand_mps2(
            motion.front_m, motion.speed_mps, DrivingTarget(self._speed_max_mps, stop_m)
        )
