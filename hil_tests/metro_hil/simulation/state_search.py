"""Explicit-state search over every schedule of a few nodes with a limited number of faults.

Time runs in slots. In each slot every running node reads what has arrived and steps once, with the
same code that runs on trains. A message arrives in the next slot unless it is lost, late or
duplicated. A node may be stopped or die at every point of its step. Each such deviation counts
against a budget of faults, within which the search tries all combinations. Schedules that lead to
the same state are followed once. At the horizon faults end, and every state there must recover by
itself.
"""

import io
import itertools
import pickle
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from hashlib import blake2b
from typing import Any, Final, NamedTuple, Protocol

from metro_hil.simulation.checker import ViolationError
from metro_hil.simulation.node import Doom, QueuedMessage


class Flight(NamedTuple):
    """A message on its way."""

    slot: int
    """Slot in which the message arrives."""
    target: int
    order: int
    message: Any


class Fate(NamedTuple):
    """Fate of a message: the delay of each copy in slots; no copy means that it is lost."""

    name: str
    copies: tuple[int, ...]


FATES: Final = (Fate("lost", ()), Fate("late", (4,)), Fate("doubled", (0, 4)))


class NodeFault(NamedTuple):
    """What happens to a node in a slot."""

    name: str
    doom: Doom | None
    slots: int
    """Number of slots for which the node is stopped or down."""


NODE_FAULTS: Final = (
    NodeFault("stopped", None, 3),
    NodeFault("stopped for long", None, 12),
    NodeFault("dies before storing", Doom.BEFORE_STORING, 2),
    NodeFault("dies before sending", Doom.BEFORE_SENDING, 2),
    NodeFault("dies for long", Doom.WHILE_SENDING, 12),
)


class SearchModel(Protocol):
    """A few nodes and their checks; the attributes hold all state that changes."""

    @property
    def addresses(self) -> Sequence[int]: ...

    @property
    def victims(self) -> Sequence[int]:
        """Nodes that may be stopped or die."""

    def exposed(self, message: Any) -> bool:
        """Tell whether this message may be lost, late or duplicated; others always arrive."""

    def step(
        self, address: int, now_ns: int, heard: Sequence[Any], doom: Doom | None
    ) -> Sequence[QueuedMessage]:
        """Run one step of a node. Raises ViolationError."""

    def boot(self, address: int, now_ns: int) -> None:
        """Restart a dead node with what it stored."""

    def alive(self) -> bool:
        """Tell whether the system works as it must after some time without faults."""


class SearchState(NamedTuple):
    """State between two slots."""

    stage: SearchModel
    flights: tuple[Flight, ...]
    away: tuple[tuple[int, int, bool], ...]
    """Nodes that do not run: address, slot in which they run again, and whether they died."""


class Deviation(NamedTuple):
    """One deviation from the schedule without faults, for the report."""

    slot: int
    what: str


@dataclass(frozen=True, slots=True)
class Bounds:
    """Bounds of the search: its length, its number of faults and the duration of a slot."""

    slots: int
    faults: int
    slot_ns: int
    calm_slots: int = 40
    """Number of slots without faults after the horizon within which every state must recover."""


@dataclass(slots=True)
class SearchResult:
    """Result of a search."""

    states: int = 0
    """Number of different states."""
    schedules: int = 0
    """Number of slots played: states times the combinations of faults in them."""
    ends: int = 0
    """Number of different states at the horizon, each followed until it recovered."""
    broken: ViolationError | None = None
    story: tuple[Deviation, ...] = ()


class _Saver(pickle.Pickler):
    """Pickler that writes objects that never change by name only."""

    def __init__(self, file: io.BytesIO, names: Mapping[int, str]) -> None:
        super().__init__(file, protocol=5)
        self._names = names

    def persistent_id(self, thing: object) -> str | None:
        return self._names.get(id(thing))


class _Loader(pickle.Unpickler):
    def __init__(self, file: io.BytesIO, things: Mapping[str, object]) -> None:
        super().__init__(file)
        self._things = things

    def persistent_load(self, name: str) -> object:
        return self._things[name]


class Explorer:
    """Searches from one state. `constants` are objects within it that never change."""

    def __init__(self, bounds: Bounds, constants: Mapping[str, object]) -> None:
        self.bounds = bounds
        self._things = constants
        self._names = {id(thing): name for name, thing in constants.items()}
        self.found = SearchResult()

    def warm_up(self, start: SearchState, slots: int) -> SearchState:
        """Run this many slots without faults; the slots of the search continue from there."""
        state = start
        for slot in range(-slots, 0):
            state, letters = self._play(self._save(state), slot, {}, ())
            sent = [(target, each.message) for each in letters for target in each.targets]
            state = state._replace(flights=state.flights + tuple(_flights(sent, {}, slot)))
        return state

    def search(
        self, start: SearchState, *, told: Callable[[str], None] = lambda _: None
    ) -> SearchResult:
        """Stop at the first violated invariant, with the deviations that led to it."""
        found, bounds = self.found, self.bounds
        layer: dict[bytes, tuple[bytes, int, tuple[Deviation, ...]]] = {}
        self._keep(layer, start, bounds.faults, ())
        try:
            for slot in range(bounds.slots):
                found.states += len(layer)
                told(f"slot {slot}: {len(layer)} states")
                after: dict[bytes, tuple[bytes, int, tuple[Deviation, ...]]] = {}
                for blob, budget, story in layer.values():
                    for state, cost, steps in self._successors(blob, slot, budget, story):
                        self._keep(after, state, budget - cost, steps)
                layer = after
            found.states += len(layer)
            for blob, _, story in layer.values():
                found.ends += 1
                self._check_recovery(blob, story)
        except _BrokenError as error:
            found.broken, found.story = error.violation, error.story
        return found

    # -- states ------------------------------------------------------------------------------------

    def _save(self, state: SearchState) -> bytes:
        file = io.BytesIO()
        _Saver(file, self._names).dump(state)
        return file.getvalue()

    def _load(self, blob: bytes) -> SearchState:
        state: SearchState = _Loader(io.BytesIO(blob), self._things).load()
        return state

    def _keep(
        self,
        layer: dict[bytes, tuple[bytes, int, tuple[Deviation, ...]]],
        state: SearchState,
        budget: int,
        story: tuple[Deviation, ...],
    ) -> None:
        """Keep a state with the larger fault budget; it leads to all that the smaller one does."""
        blob = self._save(state)
        key = blake2b(blob, digest_size=16).digest()
        known = layer.get(key)
        if known is None or known[1] < budget:
            layer[key] = blob, budget, story

    # -- one slot ----------------------------------------------------------------------------------

    def _successors(
        self, blob: bytes, slot: int, budget: int, story: tuple[Deviation, ...]
    ) -> Iterator[tuple[SearchState, int, tuple[Deviation, ...]]]:
        stage = self._load(blob).stage
        for hit in _node_choices(stage.victims, budget):
            steps = story + tuple(Deviation(slot, f"{a}: {fault.name}") for a, fault in hit.items())
            state, letters = self._play(blob, slot, hit, steps)
            left = budget - len(hit)
            sent = [(target, each.message) for each in letters for target in each.targets]
            saved = self._save(state) if left and sent else b""
            first = True
            exposed = [n for n, (_, message) in enumerate(sent) if stage.exposed(message)]
            for fates in _message_choices(exposed, left):
                if not first:
                    state = self._load(saved)
                first = False
                self.found.schedules += 1
                told = tuple(
                    Deviation(slot, f"{fate.name}, to {sent[index][0]}: {sent[index][1]}")
                    for index, fate in fates.items()
                )
                flights = state.flights + tuple(_flights(sent, fates, slot))
                yield state._replace(flights=flights), len(hit) + len(fates), steps + told

    def _play(
        self, blob: bytes, slot: int, hit: Mapping[int, NodeFault], story: tuple[Deviation, ...]
    ) -> tuple[SearchState, list[QueuedMessage]]:
        state = self._load(blob)
        stage, now_ns = state.stage, slot * self.bounds.slot_ns
        away = {address: (until, died) for address, until, died in state.away}
        inboxes: dict[int, list[Any]] = {address: [] for address in stage.addresses}
        later = []
        for flight in sorted(state.flights, key=lambda each: (each.slot, each.order)):
            stopped = flight.target in away and slot < away[flight.target][0]
            if flight.slot > slot or (stopped and not away[flight.target][1]):
                later.append(flight)
            elif not stopped:
                inboxes[flight.target].append(flight.message)
        letters: list[QueuedMessage] = []
        try:
            for address in stage.addresses:
                until, died = away.get(address, (slot, False))
                if slot < until:
                    continue
                if away.pop(address, None) is not None and died:
                    stage.boot(address, now_ns)
                fault = hit.get(address)
                if fault is not None:
                    away[address] = slot + fault.slots, fault.doom is not None
                    if fault.doom is None:
                        later += [
                            Flight(slot, address, n, each)
                            for n, each in enumerate(inboxes[address])
                        ]
                        continue
                doom = None if fault is None else fault.doom
                letters += stage.step(address, now_ns, inboxes[address], doom)
        except ViolationError as error:
            raise _BrokenError(error, (*story, Deviation(slot, "broken"))) from error
        gone = tuple(sorted((a, until, died) for a, (until, died) in away.items()))
        return SearchState(stage, tuple(later), gone), letters

    def _check_recovery(self, blob: bytes, story: tuple[Deviation, ...]) -> None:
        """Check that the state recovers within the bound if no more faults occur."""
        state = self._load(blob)
        first = self.bounds.slots
        for slot in range(first, first + self.bounds.calm_slots):
            state, letters = self._play(self._save(state), slot, {}, story)
            sent = [(target, each.message) for each in letters for target in each.targets]
            state = state._replace(flights=state.flights + tuple(_flights(sent, {}, slot)))
            if not state.away and state.stage.alive():
                return
        what = f"{self.bounds.calm_slots} slots after the last fault the state has not recovered"
        raise _BrokenError(ViolationError("40", what), story)


class _BrokenError(Exception):
    def __init__(self, violation: ViolationError, story: tuple[Deviation, ...]) -> None:
        super().__init__(str(violation))
        self.violation, self.story = violation, story


def _node_choices(addresses: Sequence[int], budget: int) -> Iterator[dict[int, NodeFault]]:
    for size in range(min(budget, len(addresses)) + 1):
        for hit in itertools.combinations(addresses, size):
            for faults in itertools.product(NODE_FAULTS, repeat=size):
                yield dict(zip(hit, faults, strict=True))


def _message_choices(exposed: Sequence[int], budget: int) -> Iterator[dict[int, Fate]]:
    for size in range(min(budget, len(exposed)) + 1):
        for hit in itertools.combinations(exposed, size):
            for fates in itertools.product(FATES, repeat=size):
                yield dict(zip(hit, fates, strict=True))


def _flights(
    sent: Sequence[tuple[int, Any]], fates: Mapping[int, Fate], slot: int
) -> Iterator[Flight]:
    for index, (target, message) in enumerate(sent):
        fate = fates.get(index)
        for late in (0,) if fate is None else fate.copies:
            yield Flight(slot + 1 + late, target, index, message)
