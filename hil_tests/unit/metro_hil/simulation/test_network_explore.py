"""The state search tries every schedule within its bounds and finds the few that break a rule."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from metro_hil.simulation.checker import ViolationError
from metro_hil.simulation.node import Doom, QueuedMessage
from metro_hil.simulation.state_search import Bounds, Explorer, SearchState

SLOT_NS = 1_000_000


@dataclass
class Tokens:
    """Node 1 hands a token to node 2, which hands it back; a token in two places breaks the rule.

    The sender takes its token back if no answer comes within `patience` slots, which is the error
    to find.
    """

    patience: int
    has: dict[int, bool] = field(default_factory=lambda: {1: True, 2: False})
    gave: dict[int, int] = field(default_factory=dict)
    addresses: tuple[int, ...] = (1, 2)
    victims: tuple[int, ...] = ()

    def exposed(self, message: Any) -> bool:
        return True

    def boot(self, address: int, now_ns: int) -> None:
        self.has[address] = False

    def step(
        self, address: int, now_ns: int, heard: Sequence[Any], doom: Doom | None
    ) -> Sequence[QueuedMessage]:
        slot, other = now_ns // SLOT_NS, 3 - address
        said = []
        for message in heard:
            if message == "token":
                self.has[address] = True
                said.append(QueuedMessage((other,), "thanks"))
            else:
                self.gave.pop(address, None)
        if all(self.has.values()):
            raise ViolationError("one token", "there are two")
        if address in self.gave and slot - self.gave[address] >= self.patience:
            del self.gave[address]
            self.has[address] = True
        elif address == 1 and self.has[1] and slot == 2:
            self.has[1], self.gave[1] = False, slot
            said.append(QueuedMessage((other,), "token"))
        return said if doom is None else ()

    def alive(self) -> bool:
        return any(self.has.values())


def search(patience: int, faults: int, slots: int = 10) -> Explorer:
    explorer = Explorer(Bounds(slots, faults, SLOT_NS), {})
    explorer.search(SearchState(Tokens(patience), (), ()))
    return explorer


def test_without_faults_there_is_one_schedule() -> None:
    found = search(patience=3, faults=0).found

    assert found.broken is None
    assert (found.states, found.schedules, found.ends) == (11, 10, 1)


def test_the_one_lost_answer_that_makes_two_tokens_is_found_and_reported() -> None:
    found = search(patience=3, faults=1).found

    assert found.broken is not None
    assert found.broken.invariant == "one token"
    assert any("thanks" in step.what or "token" in step.what for step in found.story)
    assert len([step for step in found.story if step.what != "broken"]) == 1


def test_a_state_without_recovery_is_found() -> None:
    explorer = Explorer(Bounds(10, 1, SLOT_NS), {})

    found = explorer.search(SearchState(Tokens(patience=1000), (), ()))

    assert found.broken is not None
    assert found.broken.invariant == "40"
    assert "lost, to 2: token" in found.story[0].what


def test_every_node_may_die_at_every_point_of_its_step() -> None:
    stage = Tokens(patience=50, victims=(1, 2))
    explorer = Explorer(Bounds(4, 1, SLOT_NS), {})

    found = explorer.search(SearchState(stage, (), ()))

    assert found.schedules > 4 * (1 + 2 * 5)
