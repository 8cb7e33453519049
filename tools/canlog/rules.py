"""Rules that a log must not break: `missing > 0`, `DOOR_*: crc_errors > 0`, `bus_load_ratio >
0.7`.
"""

import fnmatch
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Final

from canlog.damage import LogError
from canlog.stats_rows import BUS_NUMBERS, MESSAGE_NUMBERS, TRANSPORT_NUMBERS, Row
from firmware_py.expression import Expression, ExpressionError, compile_expression

LOG_NUMBERS = ("damaged", "absent")
"""Numbers of the log itself for rules: unreadable places, and cyclic messages that never came."""
NUMBERS: Final = {
    "message": MESSAGE_NUMBERS,
    "bus": BUS_NUMBERS,
    "reassembled message": TRANSPORT_NUMBERS,
    "log": LOG_NUMBERS,
}
"""Numbers that a rule may name, by what it judges."""


@dataclass(frozen=True, slots=True)
class FailRule:
    """One `--fail-on`. Each message or bus for which the expression is true breaks the rule."""

    text: str
    only: str
    """Pattern of the names of messages or channels to judge."""
    expression: Expression

    @property
    def scope(self) -> str:
        """What the rule judges."""
        return next(scope for scope, names in NUMBERS.items() if self.expression.names & set(names))


@dataclass(frozen=True, slots=True)
class Broken:
    """One broken rule, the message or bus that broke it, and its numbers."""

    rule: str
    who: str
    channel: str
    numbers: str

    def __str__(self) -> str:
        return f"{self.rule}: {self.who} on {self.channel}: {self.numbers}"


def parse_rule(text: str) -> FailRule:
    """Parse a rule. Raises LogError that lists what a rule may name."""
    only, colon, expression = text.partition(":")
    if not colon:
        only, expression = "*", text
    allowed = tuple(name for names in NUMBERS.values() for name in names)
    try:
        compiled = compile_expression(expression.strip(), allowed)
    except ExpressionError as error:
        raise LogError(f"--fail-on {error}") from error
    if sum(bool(compiled.names & set(names)) for names in NUMBERS.values()) != 1:
        kinds = "of messages, of buses, of reassembled messages or of the log"
        raise LogError(f"--fail-on {text!r}: name numbers {kinds}")
    return FailRule(text, only.strip(), compiled)


@dataclass(frozen=True, slots=True)
class Judged:
    """The rows of a log that rules judge."""

    messages: Sequence[Row]
    buses: Sequence[Row]
    damaged: int = 0
    absent: int | None = 0
    """Number of absent messages; None if no DBC file requires a message."""
    never: Sequence[Row] = ()
    """Rows of cyclic messages that never came; see `absent_rows`."""
    transport: Sequence[Row] = ()
    """Rows of reassembled messages; see `transport_rows`."""

    def rows(self, rule: FailRule) -> list[tuple[str, Row]]:
        """Return the rows that a rule applies to, each with its name."""
        whole = [{"channel": "log", "damaged": self.damaged, "absent": self.absent}]
        rows: Mapping[str, Sequence[Row]] = {
            "message": [*self.messages, *self.never],
            "bus": self.buses,
            "reassembled message": self.transport,
            "log": whole,
        }
        named = ((_named(row), row) for row in rows[rule.scope])
        return [(who, row) for who, row in named if fnmatch.fnmatchcase(who, rule.only)]


def _named(row: Row) -> str:
    """Return the name of a row: of its message, else its identifier, else its channel."""
    return str(row.get("message") or row.get("id") or row["channel"])


def broken(rules: Sequence[FailRule], judged: Judged) -> list[Broken]:
    """Return every breach, rule by rule."""
    found = []
    for rule in rules:
        for who, row in judged.rows(rule):
            if _judged(rule.expression, row):
                told = ", ".join(f"{name} {row[name]}" for name in sorted(rule.expression.names))
                found.append(Broken(rule.text, who, str(row["channel"]), told))
    return found


def untold(rules: Sequence[FailRule], judged: Judged) -> dict[str, str]:
    """Return rules that had nothing to judge, and why. They fail: no evidence is not a pass."""
    found = {}
    for rule in rules:
        rows = judged.rows(rule)
        if not rows:
            found[rule.text] = f"the log has no {rule.scope} {rule.only}"
        elif all(_judged(rule.expression, row) is None for _, row in rows):
            found[rule.text] = f"cannot be judged of any of {len(rows)} {rule.scope}s"
    return found


def _judged(expression: Expression, row: Row) -> bool | None:
    """Whether the expression is true; None if a number is unknown or divided by zero."""
    if any(row[name] is None for name in expression.names):
        # For instance, the latency of a message without a period is unknown.
        return None
    try:
        return bool(expression(SimpleNamespace(**row)))
    except ZeroDivisionError:
        return None
