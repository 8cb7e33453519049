"""What the fault layers of the links share: the active faults, and a queue for delayed items."""

from collections import Counter
from collections.abc import Collection, Iterator
from heapq import heappop, heappush
from typing import Any, Final, Generic, NamedTuple, TypeVar

import numpy as np

from plant_emulator.faults.kinds import FaultPlace
from plant_emulator.faults.plan import FaultPlan

T = TypeVar("T")

NS_PER_S: Final = 1_000_000_000


class Acting(NamedTuple):
    """One active fault."""

    plan: FaultPlan
    draws: np.random.Generator
    """Random numbers of this fault alone; they continue when the fault becomes active again."""
    since_ns: int

    @property
    def name(self) -> str:
        return self.plan.kind.name


class ActingFaults:
    """The active faults of one place, in the order of the scenario."""

    def __init__(self, place: FaultPlace, seed: int) -> None:
        self._place, self._seed = place, seed
        self._draws: dict[int, np.random.Generator] = {}
        self._acting: list[Acting] = []
        self.touched: Counter[int] = Counter()
        """Number of frames, telegrams or messages that each fault changed, by the fault's index."""

    def change(self, plan: FaultPlan, active: bool, now_ns: int) -> bool:
        """Start or end a fault. Returns whether the fault acts at this place."""
        if plan.kind.place is not self._place:
            return False
        rest = [each for each in self._acting if each.plan.index != plan.index]
        self.touched.setdefault(plan.index, 0)
        if active:
            rest.append(Acting(plan, self.draws_of(plan), now_ns))
        self._acting = sorted(rest, key=lambda each: each.plan.index)
        return True

    def reseed(self, seed: int) -> None:
        """Take the random numbers of all faults that begin from now on from another seed."""
        self._seed = seed
        self._draws.clear()

    def draws_of(self, plan: FaultPlan) -> np.random.Generator:
        if plan.index not in self._draws:
            self._draws[plan.index] = plan.generator(self._seed)
        return self._draws[plan.index]

    def of(self, parameters: type) -> Iterator[tuple[Acting, Any]]:
        """Yield the active faults with parameters of this class, and the parameters."""
        for acting in self._acting:
            if isinstance(acting.plan.parameters, parameters):
                yield acting, acting.plan.parameters

    def __iter__(self) -> Iterator[Acting]:
        return iter(self._acting)

    def __bool__(self) -> bool:
        return bool(self._acting)


class DelayQueue(Generic[T]):
    """Holds items until their due instant; items of the same instant keep their order."""

    def __init__(self) -> None:
        self._heap: list[tuple[int, int, T]] = []
        self._number = 0

    def hold(self, due_ns: int, thing: T) -> None:
        self._number += 1
        heappush(self._heap, (due_ns, self._number, thing))

    def due(self, now_ns: int) -> Iterator[tuple[int, T]]:
        """Remove and yield each item that is due by now, with its due instant."""
        while self._heap and self._heap[0][0] <= now_ns:
            due_ns, _, thing = heappop(self._heap)
            yield due_ns, thing

    @property
    def next_ns(self) -> int | None:
        return self._heap[0][0] if self._heap else None

    def __len__(self) -> int:
        return len(self._heap)


def after_ns(now_ns: int, wait_s: float) -> int:
    return now_ns + round(wait_s * NS_PER_S)


def hits(draws: np.random.Generator, share_ratio: float) -> bool:
    """Return True with this probability.

    It takes one random number for any ratio, so that another ratio leaves later random numbers
    unchanged.
    """
    return draws.random() < share_ratio


def flipped(
    data: bytes, bits: int, draws: np.random.Generator, spared: Collection[int] = ()
) -> bytes:
    """Return `data` with this many different bits inverted, or with all if there are fewer.

    `spared` bits are never inverted.
    """
    places = [place for place in range(8 * len(data)) if place not in spared]
    chosen = draws.choice(len(places), size=min(bits, len(places)), replace=False)
    word = int.from_bytes(data, "little")
    for index in chosen:
        word ^= 1 << places[int(index)]
    return word.to_bytes(len(data), "little")
