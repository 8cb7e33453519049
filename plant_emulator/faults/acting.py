"""What the fault layers of the links share: the faults that act now, and what is held until due."""

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
    """One fault that acts now."""

    plan: FaultPlan
    draws: np.random.Generator
    """Its own; goes on where it was when a fault acts again."""
    since_ns: int

    @property
    def name(self) -> str:
        return self.plan.kind.name


class ActingFaults:
    """The faults of one place that act now, in the order of the scenario."""

    def __init__(self, place: FaultPlace, seed: int) -> None:
        self._place, self._seed = place, seed
        self._draws: dict[int, np.random.Generator] = {}
        self._acting: list[Acting] = []
        self.touched: Counter[int] = Counter()
        """By index of the fault: how many frames, telegrams or messages it changed."""

    def change(self, plan: FaultPlan, active: bool, now_ns: int) -> bool:
        """Whether that concerns this place at all."""
        if plan.kind.place is not self._place:
            return False
        rest = [each for each in self._acting if each.plan.index != plan.index]
        self.touched.setdefault(plan.index, 0)
        if active:
            rest.append(Acting(plan, self.draws_of(plan), now_ns))
        self._acting = sorted(rest, key=lambda each: each.plan.index)
        return True

    def reseed(self, seed: int) -> None:
        """What begins from now on draws from another seed."""
        self._seed = seed
        self._draws.clear()

    def draws_of(self, plan: FaultPlan) -> np.random.Generator:
        if plan.index not in self._draws:
            self._draws[plan.index] = plan.generator(self._seed)
        return self._draws[plan.index]

    def of(self, parameters: type) -> Iterator[tuple[Acting, Any]]:
        """Those with parameters of this class, and the parameters."""
        for acting in self._acting:
            if isinstance(acting.plan.parameters, parameters):
                yield acting, acting.plan.parameters

    def __iter__(self) -> Iterator[Acting]:
        return iter(self._acting)

    def __bool__(self) -> bool:
        return bool(self._acting)


class DelayQueue(Generic[T]):
    """Things that wait for their instant; those of one instant keep their order."""

    def __init__(self) -> None:
        self._heap: list[tuple[int, int, T]] = []
        self._number = 0

    def hold(self, due_ns: int, thing: T) -> None:
        self._number += 1
        heappush(self._heap, (due_ns, self._number, thing))

    def due(self, now_ns: int) -> Iterator[tuple[int, T]]:
        """What is due by now, with its instant, and is held no more."""
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
    """One draw, whatever the share, so that another share leaves later draws as they were."""
    return draws.random() < share_ratio


def flipped(
    data: bytes, bits: int, draws: np.random.Generator, spared: Collection[int] = ()
) -> bytes:
    """As many different bits of `data` inverted, or all there are; `spared` ones never."""
    places = [place for place in range(8 * len(data)) if place not in spared]
    chosen = draws.choice(len(places), size=min(bits, len(places)), replace=False)
    word = int.from_bytes(data, "little")
    for index in chosen:
        word ^= 1 << places[int(index)]
    return word.to_bytes(len(data), "little")
