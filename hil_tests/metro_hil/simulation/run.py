"""Runs one seed: a phase with faults, then a calm phase in which all trains must get authority."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final, Protocol

from metro_hil.model.gc_tuning import rarely_collected
from metro_hil.simulation.checker import ViolationError
from metro_hil.simulation.network_faults import FaultScale, NetworkFaults
from metro_hil.simulation.world import SimulatedLine

NS_PER_S: Final = 1_000_000_000
LOOK_NS: Final = 100_000_000
"""Time between two checks whether all trains have authority again."""
UNSETTLED_BOUNDS: Final = 10
"""Upper bound of the extension of the calm phase, as a multiple of `calm_s`. The bound restarts
while something goes on that trains have to wait for."""


@dataclass(frozen=True, slots=True)
class Phases:
    """Durations of the phases of a run."""

    trouble_s: float = 300.0
    calm_s: float = 30.0
    """Time after the last fault within which every train on the line must hold an authority."""
    start_s: float = 5.0
    """Nodes start at random instants within this time."""

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle for worker processes.

        A compiled frozen class cannot be restored in any other way.
        """
        return Phases, (self.trouble_s, self.calm_s, self.start_s)


@dataclass(slots=True)
class RunResult:
    """Outcome of one seed."""

    seed: int
    digest: str = ""
    """Hash over the events of the run; equal seeds give equal digests."""
    invariant: str = ""
    """Number of the violated invariant; empty if all held."""
    what: str = ""
    simulated_s: float = 0.0
    train_s: float = 0.0
    """Simulated time summed over all trains."""
    events: int = 0
    cpu_s: float = 0.0
    recovery_s: float = 0.0
    """Time from the end of the last fault until the last train held an authority."""
    emergencies: int = 0
    faults: Counter[str] = field(default_factory=Counter)
    looked: Counter[str] = field(default_factory=Counter)
    covered: Counter[str] = field(default_factory=Counter)
    """Counts of states, transitions and guard answers of the protocol that the run reached, by
    name."""
    messages: Counter[str] = field(default_factory=Counter)
    """Counts of messages sent, delivered, lost, duplicated and damaged, and of writes to disks."""


class Also(Protocol):
    """A source of events on the line other than network faults."""

    counts: dict[str, int]

    def begin(self) -> None: ...

    def calm(self) -> None: ...


def run_seed(
    seed: int,
    world: SimulatedLine,
    scale: FaultScale,
    phases: Phases,
    cpu_ns: Callable[[], int],
    also: Sequence[Also] = (),
) -> RunResult:
    """Run to the end or to the first violated invariant. `cpu_ns` returns used processor time."""
    trouble = NetworkFaults(
        world.net,
        seed=seed,
        victims=tuple(world.net.nodes),
        revive=world.net.boot,
        scale=scale,
    )
    result = RunResult(seed)
    begun_ns = cpu_ns()
    try:
        with rarely_collected():
            _play(world, (trouble, *also), phases, result)
    except ViolationError as error:
        result.invariant, result.what = error.invariant, error.what
        world.net.say("verdict", str(error))
    result.cpu_s = (cpu_ns() - begun_ns) / NS_PER_S
    for each in (trouble, *also):
        result.faults.update(each.counts)
    _sum_up(world, result)
    return result


def _play(world: SimulatedLine, things: Sequence[Also], phases: Phases, result: RunResult) -> None:
    net = world.net
    for address in net.nodes:
        at_ns = int(world.rng.random() * phases.start_s * NS_PER_S)
        net.at(at_ns, net.boot, address)
    for each in things:
        each.begin()
    net.run(int(phases.trouble_s * NS_PER_S))
    for each in things:
        each.calm()
    calm_ns, bound_ns = net.now_ns, int(phases.calm_s * NS_PER_S)
    end_ns, last_ns = calm_ns + bound_ns, calm_ns + UNSETTLED_BOUNDS * bound_ns
    while (waiting := world.without_authority()) and net.now_ns < end_ns:
        net.run(net.now_ns + LOOK_NS)
        if world.unsettled(waiting):
            end_ns = min(net.now_ns + bound_ns, last_ns)
    result.recovery_s = (net.now_ns - calm_ns) / NS_PER_S
    if waiting and not net.disks_lost:
        # A train that lost its disk waits for a person, and other trains may wait for it.
        raise ViolationError(
            "40", f"{phases.calm_s:.0f} s after the last fault trains {waiting} have no authority"
        )


def _sum_up(world: SimulatedLine, result: RunResult) -> None:
    net = world.net
    result.digest = net.trace.digest()
    result.simulated_s = net.now_ns / NS_PER_S
    result.train_s = result.simulated_s * len(world.trains)
    result.events = net.events
    result.emergencies = sum(train.emergencies for train in world.trains.values())
    result.looked.update(world.checker.looked)
    result.messages.update(
        sent=net.sent,
        delivered=net.delivered,
        lost=net.lost,
        doubled=net.doubled,
        damaged=net.damaged,
        stored=net.stored,
    )
