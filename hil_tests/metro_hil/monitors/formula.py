"""A formula of signal temporal logic as a tree in which negations occur only in atoms."""

from dataclasses import dataclass, replace
from enum import Enum
from typing import Final, TypeAlias

LEAST: Final = "5e-324"
"""Subtracted from the margin of a strict comparison. It turns a margin of exactly zero into a
violation and changes no other, so the sign of a margin always gives the result."""


class Lasting(Enum):
    ALWAYS = "always"
    EVENTUALLY = "eventually"
    HISTORICALLY = "historically"
    ONCE = "once"


DUAL: Final = {
    Lasting.ALWAYS: Lasting.EVENTUALLY,
    Lasting.EVENTUALLY: Lasting.ALWAYS,
    Lasting.HISTORICALLY: Lasting.ONCE,
    Lasting.ONCE: Lasting.HISTORICALLY,
}
AHEAD: Final = (Lasting.ALWAYS, Lasting.EVENTUALLY)


@dataclass(frozen=True, slots=True)
class TimeInterval:
    """An interval relative to the present sample, forwards or back in time."""

    begin_ns: int = 0
    end_ns: int | None = None
    """End of the interval; None: open."""


@dataclass(frozen=True, slots=True)
class Atom:
    """A comparison, as the text of its margin and of its negation's margin."""

    margin: str
    negated: str
    position: int
    denied: bool = False
    """Whether the text has the atom under an odd number of negations."""


@dataclass(frozen=True, slots=True)
class Both:
    parts: tuple["Node", ...]


@dataclass(frozen=True, slots=True)
class Either:
    parts: tuple["Node", ...]
    premise: "Node | None" = None
    """Premise of an implication; None for a plain choice."""


@dataclass(frozen=True, slots=True)
class Timed:
    lasting: Lasting
    interval: TimeInterval
    body: "Node"
    position: int


@dataclass(frozen=True, slots=True)
class Until:
    """`first` holds until `second` does.

    If `released`: the negation of this for the negated parts.
    """

    interval: TimeInterval
    first: "Node"
    second: "Node"
    position: int
    released: bool = False


Node: TypeAlias = Atom | Both | Either | Timed | Until


def negation(node: Node) -> Node:
    """Return the negated tree, with the negation moved down to the atoms."""
    if isinstance(node, Atom):
        return Atom(node.negated, node.margin, node.position, not node.denied)
    if isinstance(node, Both):
        return Either(tuple(negation(part) for part in node.parts))
    if isinstance(node, Either):
        return Both(tuple(negation(part) for part in node.parts))
    if isinstance(node, Timed):
        return replace(node, lasting=DUAL[node.lasting], body=negation(node.body))
    return replace(
        node, first=negation(node.first), second=negation(node.second), released=not node.released
    )


def premise_of(node: Either, *, lasting: Lasting) -> Node | None:
    """Return the premise without which the rest is not required; None for a plain choice.

    Where a choice has to hold all the time, `not p or q` requires the same as `p -> q`.
    """
    if node.premise is not None or lasting not in (Lasting.ALWAYS, Lasting.HISTORICALLY):
        return node.premise
    denied = [part for part in node.parts if _denied(part)]
    if not denied or len(denied) == len(node.parts):
        return None
    return _both([negation(part) for part in denied])


def _denied(node: Node) -> bool:
    if isinstance(node, Atom):
        return node.denied
    if isinstance(node, Both | Either):
        return all(map(_denied, node.parts))
    return False


def witness(node: Node, lasting: Lasting = Lasting.EVENTUALLY) -> Node | None:
    """Return what a run must show to exercise the formula; None if it needs nothing more.

    A formula that holds without its witness holds vacuously: `always(p -> q)` if `p` never held, or
    `eventually(p -> q)` if `q` never held.

    Args:
        lasting: the operator that contains the node.
    """
    if isinstance(node, Atom):
        return None
    if isinstance(node, Both):
        return _both([each for part in node.parts if (each := witness(part, lasting)) is not None])
    if isinstance(node, Either):
        return _of_choice(node, lasting)
    if isinstance(node, Timed):
        inner = witness(node.body, node.lasting)
        if inner is None:
            return None
        if node.lasting in (Lasting.EVENTUALLY, Lasting.ONCE):
            return replace(node, body=Both((node.body, inner)))
        return replace(node, lasting=DUAL[node.lasting], body=inner)
    inner = None if node.released else witness(node.second)
    return None if inner is None else replace(node, second=Both((node.second, inner)))


def _of_choice(node: Either, lasting: Lasting) -> Node | None:
    premise = premise_of(node, lasting=lasting)
    if premise is None:
        found = [witness(part, lasting) for part in node.parts]
        if all(each is None for each in found):
            return None
        pairs = zip(node.parts, found, strict=True)
        return Either(tuple(part if each is None else Both((part, each)) for part, each in pairs))
    asked = [premise]
    for part in node.parts:
        if part == negation(premise):
            continue
        if (inner := witness(part, lasting)) is not None:
            asked.append(inner)
        if not _present(part):
            # A part that looks ahead must have been judged, not only required.
            asked.append(Either((part, negation(part))))
    return _both(asked)


def _present(node: Node) -> bool:
    """Tell whether the node depends on a single sample only."""
    if isinstance(node, Both | Either):
        return all(map(_present, node.parts))
    return isinstance(node, Atom)


def _both(parts: list[Node]) -> Node | None:
    if len(parts) < 2:
        return parts[0] if parts else None
    return Both(tuple(parts))


def boolean(name: str, position: int, *, wanted: bool) -> Atom:
    true, false = f"(2.0 * {name} - 1.0)", f"(1.0 - 2.0 * {name})"
    return Atom(true, false, position) if wanted else Atom(false, true, position)


def comparison(left: str, sign: str, right: str, position: int) -> Atom:
    if sign in (">", ">="):
        return comparison(right, sign.replace(">", "<"), left, position)
    gap, reverse = f"({right} - {left})", f"({left} - {right})"
    if sign == "<=":
        return Atom(gap, f"({reverse} - {LEAST})", position)
    if sign == "<":
        return Atom(f"({gap} - {LEAST})", reverse, position)
    same, other = f"(-abs{gap})", f"(abs{gap} - {LEAST})"
    return Atom(same, other, position) if sign == "==" else Atom(other, same, position)
