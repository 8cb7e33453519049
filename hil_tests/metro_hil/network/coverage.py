"""What of the protocol a run went through: states, transitions, guards, kinds of message."""

import dataclasses
import enum
import itertools
from collections import Counter
from collections.abc import Callable, Iterable
from typing import Any, Final

from vobc.t2t.guards import TrainGuards
from vobc.t2t.roles import ROLES
from vobc.t2t.vocabulary import Role, TrainState
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
"""Messages of which each kind counts by itself."""
FORMULAS: Final = frozenset({"latent_authority_m", "unused_term", "granted_until_ns"})
"""Among the guards, but not true or false."""


def counted(guards: Any, counts: Counter[str]) -> Any:
    """The same guards; each answer of each is counted."""
    changed: dict[str, Any] = {}
    for each in dataclasses.fields(guards):
        value = getattr(guards, each.name)
        if dataclasses.is_dataclass(value):
            changed[each.name] = counted(value, counts)
        elif each.name not in FORMULAS:
            changed[each.name] = _Counting(value, each.name, counts)
    return dataclasses.replace(guards, **changed)


class _Counting:
    __slots__ = ("_call", "_counts", "_names")

    def __init__(self, call: Callable[[Any], bool], name: str, counts: Counter[str]) -> None:
        self._call, self._counts = call, counts
        self._names = (f"guard {name}: no", f"guard {name}: yes")

    def __call__(self, seen: Any) -> bool:
        answer = self._call(seen)
        self._counts[self._names[1 if answer else 0]] += 1
        return answer


def told_kinds(messages: Iterable[T2tMessage], counts: Counter[str]) -> None:
    """Count what is said, by kind."""
    for message in messages:
        counts[_kind(message)] += 1


def _kind(message: T2tMessage) -> str:
    kind = type(message)
    finer = KINDS.get(kind)
    if finer is None:
        return kind.__name__
    value: enum.IntEnum = getattr(message, finer[0])
    return f"{kind.__name__} {value.name}"


def never(counts: Counter[str]) -> list[str]:
    """What could have happened and did not."""
    return sorted(everything() - set(counts))


def everything() -> set[str]:
    """States and roles, every way from one to another, both answers of every guard, all kinds of
    message.
    """
    found = {f"state {state.value}" for state in TrainState}
    found |= {f"from {a.value} to {b.value}" for a, b in itertools.permutations(TrainState, 2)}
    found |= {f"role {role.value}" for role in Role}
    found |= {f"from {role.value} to {to.value}" for role, ways in ROLES.items() for _, to in ways}
    found |= set(_guard_names(TrainGuards()))
    for kind in T2T_TYPES:
        if kind in (Decree, LineState):
            # Between desks and the wayside: no part of what is simulated.
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
