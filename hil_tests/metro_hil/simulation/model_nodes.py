"""The real protocol on a few nodes at standstill, for the explicit-state search."""

from collections import Counter
from collections.abc import Collection, Sequence
from typing import Any, Final

from metro_hil.simulation.authority_checks import AuthorityChecks, LeaseRules
from metro_hil.simulation.checker import Checker
from metro_hil.simulation.motion import SimulatedMotion
from metro_hil.simulation.node import Doom, QueuedMessage
from metro_hil.simulation.protocol_nodes import Mute, ProtocolNodes, TrainNode
from metro_hil.simulation.state_search import SearchState
from metro_hil.simulation.track import TrueTrack
from metro_hil.simulation.true_train import BrakeLoopGrant, TrueTrain
from vobc.train_to_train.vocabulary import Role
from zenoh_config.messages import WAYSIDE
from zenoh_config.t2t import (
    AreaAuthority,
    Heartbeat,
    LeaseAnswer,
    LeaseRequest,
    RosterAck,
    RosterCommit,
    SwitchStep,
    TrainReport,
)

MILLION: Final = 1_000_000
EXPOSED: Final = (LeaseRequest, LeaseAnswer, Heartbeat, RosterCommit, RosterAck)
"""Messages of the election."""
EXPOSED_DEAF: Final = (*EXPOSED, SwitchStep)
"""Messages of the election and those with which a master resigns."""
EXPOSED_ALL: Final = (*EXPOSED, AreaAuthority, TrainReport)
"""Messages of the election, and those that carry terms and acknowledgements."""


class NodePlace:
    """One node: its state machine and its disk."""

    __slots__ = ("address", "boots", "disk", "drift_ppm", "grants", "machine", "offset_ns", "tuned")

    def __init__(self, address: int, disk: Any, offset_ns: int, drift_ppm: int) -> None:
        self.address, self.disk = address, disk
        self.offset_ns, self.drift_ppm = offset_ns, drift_ppm
        self.boots = 0
        self.machine: Any = None
        self.grants: tuple[BrakeLoopGrant, ...] = ()
        self.tuned: Collection[int] | None = None
        """Topics that the node receives; unused, as all nodes are in one area."""

    def local_ns(self, true_ns: int) -> int:
        return self.offset_ns + true_ns + true_ns * self.drift_ppm // MILLION


class LineStage:
    """Trains at rest, arbiters and wayside, with the checks of the simulation."""

    def __init__(
        self,
        crew: ProtocolNodes,
        fronts_m: dict[int, float],
        *,
        drifts_ppm: dict[int, int],
        exposed: tuple[type, ...] = EXPOSED,
    ) -> None:
        cast = crew.cast
        self._crew = crew
        self._exposed = exposed
        self._deaf, self._deaf_until_ns = 0, 0
        self.now_ns = 0
        trains = [
            TrueTrain(
                address,
                SimulatedMotion(0, front_m, emergency_mps2=1.0),
                length_m=80.0,
                half_width_m=2.0,
            )
            for address, front_m in fronts_m.items()
        ]
        crew.track = TrueTrack(cast.line, trains)
        self._trains = {train.address: train for train in trains}
        self._checker = Checker(trains, crew.rules)
        timers = cast.config.timers
        self._air = AuthorityChecks(
            LeaseRules(
                timers.lease_ms * MILLION,
                timers.drift_ratio,
                timers.margin_ms * MILLION,
                cast.config.majority,
                crew.rules.age_max_ns,
            ),
            self._checker.looked,
        )
        self.addresses = (*cast.config.arbiters, WAYSIDE, *fronts_m)
        self.victims = (*cast.config.arbiters, *fronts_m)
        self._places = {
            address: NodePlace(
                address,
                crew.installed(address),
                10_000 * MILLION * (1 + index),
                drifts_ppm.get(address, 0),
            )
            for index, address in enumerate(self.addresses)
        }

    def deafen_master(self, until_ns: int) -> None:
        """Let the present master receive nothing before that instant."""
        for address in self._trains:
            machine = self._places[address].machine
            last = machine.last if isinstance(machine, TrainNode) else None
            if last is not None and Role.MASTER in dict(last.roles).values():
                self._deaf, self._deaf_until_ns = address, until_ns

    @property
    def looked(self) -> Counter[str]:
        return self._checker.looked

    def constants(self) -> dict[str, object]:
        """Return the parts that never change during the search, by name."""
        return {"looked": self.looked, "lease rules": self._air.rules}

    def exposed(self, message: Any) -> bool:
        return isinstance(message, self._exposed)

    def boot(self, address: int, now_ns: int) -> None:
        place = self._places[address]
        place.boots += 1
        place.grants = ()
        local_ns = place.local_ns(now_ns)
        if address in self._trains:
            self._air.booted(address)
            self._checker.gave_up(address)
            place.machine = self._crew.train(place, local_ns)
        else:
            _, start = self._crew.wayside()[address]
            place.machine = start(place, local_ns)

    def step(
        self, address: int, now_ns: int, heard: Sequence[Any], doom: Doom | None
    ) -> Sequence[QueuedMessage]:
        place = self._places[address]
        self.now_ns = now_ns
        local_ns = place.local_ns(now_ns)
        machine = place.machine
        if address == self._deaf and now_ns < self._deaf_until_ns:
            heard = ()
        if address not in self._trains:
            turn = machine.step(local_ns, heard)
        else:
            for train in self._trains.values():
                train.motion.advance(now_ns)
            turn = machine.step(local_ns, heard, self._trains[address].reading())
            self._air.stepped(address, local_ns, now_ns, heard, turn.letters)
        if doom is Doom.BEFORE_STORING:
            return ()
        place.disk = turn.keep
        if doom is Doom.BEFORE_SENDING:
            return ()
        if address in self._trains:
            self._apply(place, machine, local_ns)
        letters: Sequence[QueuedMessage] = turn.letters
        return letters[: (len(letters) + 1) // 2] if doom is Doom.WHILE_SENDING else letters

    def _apply(self, place: NodePlace, machine: TrainNode | Mute, local_ns: int) -> None:
        if machine.grants is place.grants:
            return
        place.grants = machine.grants
        if not place.grants:
            self._checker.gave_up(place.address)
        for grant in place.grants:
            self._checker.accepted(place.address, grant, local_ns, whole=False)
            self._air.made_of(place.address, grant)

    def alive(self) -> bool:
        """Tell whether every train holds an authority that is fresh enough."""
        return all(self._has_authority(self._places[address]) for address in self._trains)

    def _has_authority(self, place: NodePlace) -> bool:
        now_ns = place.local_ns(self.now_ns)
        age_max_ns = self._crew.rules.age_max_ns
        return bool(place.grants) and now_ns - place.grants[0].stamp_ns <= age_max_ns


def begin(stage: LineStage, now_ns: int) -> SearchState:
    """Return the state in which all nodes start at that instant."""
    for address in stage.addresses:
        stage.boot(address, now_ns)
    return SearchState(stage, (), ())
