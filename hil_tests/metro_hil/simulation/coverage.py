"""Counts the protocol's states, transitions, guard answers and message kinds that a run reached."""

import dataclasses
import enum
import itertools
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final

from vobc.train_to_train.guards import TrainGuards
from vobc.train_to_train.roles import ROLES
from vobc.train_to_train.vocabulary import Role, TrainState
from zenoh_config.t2t import (
    Admission,
    AdmissionState,
    Heartbeat,
    LeaseKind,
    LeaseRequest,
    LineOrder,
    OrderKind,
    Phase,
    SwitchKind,
    SwitchStep,
    T2tMessage,
)
from zenoh_config.t2t_supervision import Decree, LineState, RemovalAnswer, RemovalState
from zenoh_config.t2t_types import T2T_TYPES

KINDS: Final[dict[type[T2tMessage], tuple[str, type[enum.IntEnum]]]] = {
    LeaseRequest: ("kind", LeaseKind),
    Heartbeat: ("phase", Phase),
    SwitchStep: ("kind", SwitchKind),
    LineOrder: ("kind", OrderKind),
    Admission: ("state", AdmissionState),
    RemovalAnswer: ("state", RemovalState),
}
"""Message types whose kinds are counted separately, with the field that holds the kind."""
PLAIN: Final = {kind: kind.__name__ for kind in T2T_TYPES if kind not in KINDS}
NAMES: Final = {
    (kind, value): f"{kind.__name__} {value.name}"
    for kind, (_, values) in KINDS.items()
    for value in values
}
"""Names under which these messages are counted, by type and kind."""
FORMULAS: Final = frozenset(
    {"latent_authority_m", "behind_train_ahead_m", "unused_term", "granted_until_ns"}
)
"""Entries among the guards that return something other than true or false."""


def counted(guards: Any, counting: "list[CountedGuard]") -> Any:
    """Return the same guards, each counting its answers; add each counting guard to the list."""
    changed: dict[str, Any] = {}
    for each in dataclasses.fields(guards):
        value = getattr(guards, each.name)
        if dataclasses.is_dataclass(value):
            changed[each.name] = counted(value, counting)
        elif each.name not in FORMULAS:
            changed[each.name] = CountedGuard(value, each.name)
            counting.append(changed[each.name])
    return dataclasses.replace(guards, **changed)


class CountedGuard:
    """A guard that counts its answers."""

    __slots__ = ("_call", "name", "no", "yes")

    def __init__(self, call: Callable[[Any], bool], name: str) -> None:
        self._call, self.name = call, name
        self.no = self.yes = 0

    def __call__(self, seen: Any) -> bool:
        answer = self._call(seen)
        if answer:
            self.yes += 1
        else:
            self.no += 1
        return answer


def answers(counting: Sequence[CountedGuard]) -> Counter[str]:
    """Return the answers of all guards by name; guards of one name are counted together."""
    counts = Counter[str]()
    for each in counting:
        counts.update({f"guard {each.name}: no": each.no, f"guard {each.name}: yes": each.yes})
    return +counts


def told_kinds(messages: Iterable[T2tMessage], counts: Counter[str]) -> None:
    """Count sent messages by kind."""
    for message in messages:
        kind = type(message)
        finer = KINDS.get(kind)
        if finer is None:
            counts[PLAIN[kind]] += 1
        else:
            counts[NAMES[kind, getattr(message, finer[0])]] += 1


def never(counts: Counter[str]) -> list[str]:
    """Return the names that the run could have reached and did not."""
    return sorted(everything() - set(counts))


def everything() -> set[str]:
    """Return the names of all states, roles, transitions, guard answers and message kinds."""
    found = {f"state {state.value}" for state in TrainState}
    found |= {f"from {a.value} to {b.value}" for a, b in itertools.permutations(TrainState, 2)}
    found |= {f"role {role.value}" for role in Role}
    found |= {f"from {role.value} to {to.value}" for role, ways in ROLES.items() for _, to in ways}
    found |= set(_guard_names(TrainGuards()))
    for kind in T2T_TYPES:
        if kind in (Decree, LineState):
            # Only consoles and the wayside exchange these; the simulation has no console.
            continue
        finer = KINDS.get(kind)
        if finer is None:
            found.add(kind.__name__)
        else:
            found |= {f"{kind.__name__} {value.name}" for value in finer[1]}
    return found


def _guard_names(guards: Any) -> Iterable[str]:
    for each in dataclasses.fields(guards):
        value = getattr(guards, each.name)
        if dataclasses.is_dataclass(value):
            yield from _guard_names(value)
        elif each.name not in FORMULAS:
            yield from (f"guard {each.name}: no", f"guard {each.name}: yes")
