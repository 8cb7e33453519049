"""A formula of signal temporal logic as a tree in which every negation stands at an atom."""

from dataclasses import dataclass, replace
from enum import Enum
from typing import Final, TypeAlias

LEAST: Final = "5e-324"
"""Taken off the margin of a strict comparison: it turns a margin of exactly zero into a violation
and changes no other, so that the sign of a margin is always the truth."""


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
    """From the instant that is looked at, forwards or back."""

    begin_ns: int = 0
    end_ns: int | None = None
    """None has no end."""


@dataclass(frozen=True, slots=True)
class Atom:
    """A comparison, as the text of its margin and that of its negation's."""

    margin: str
    negated: str
    position: int


@dataclass(frozen=True, slots=True)
class Both:
    parts: tuple["Node", ...]


@dataclass(frozen=True, slots=True)
class Either:
    parts: tuple["Node", ...]
    premise: "Node | None" = None
    """Of an implication: what has to hold so that the rest is asked for."""


@dataclass(frozen=True, slots=True)
class Timed:
    lasting: Lasting
    interval: TimeInterval
    body: "Node"
    position: int


@dataclass(frozen=True, slots=True)
class Until:
    """`first` holds until `second` does. Released: not that, of the negations that it holds."""

    interval: TimeInterval
    first: "Node"
    second: "Node"
    position: int
    released: bool = False


Node: TypeAlias = Atom | Both | Either | Timed | Until


def negation(node: Node) -> Node:
    """The same tree, denied, with the denial moved down to the atoms."""
    if isinstance(node, Atom):
        return Atom(node.negated, node.margin, node.position)
    if isinstance(node, Both):
        return Either(tuple(negation(part) for part in node.parts))
    if isinstance(node, Either):
        return Both(tuple(negation(part) for part in node.parts))
    if isinstance(node, Timed):
        return replace(node, lasting=DUAL[node.lasting], body=negation(node.body))
    return replace(
        node, first=negation(node.first), second=negation(node.second), released=not node.released
    )


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
