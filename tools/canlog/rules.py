"""Rules that a log must not break: `missing > 0`, `DOOR_*: crc_errors > 0`, `bus_load_ratio >
0.7`.
"""

import fnmatch
from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace

from canlog.damage import LogError
from canlog.stats_rows import BUS_NUMBERS, MESSAGE_NUMBERS, Row
from firmware_py.expression import Expression, ExpressionError, compile_expression

LOG_NUMBERS = ("damaged", "absent")
"""Numbers of the log itself for rules: unreadable places, and cyclic messages that never came."""


@dataclass(frozen=True, slots=True)
class FailRule:
    """One `--fail-on`. Each message or bus for which the expression is true breaks the rule."""

    text: str
    only: str
    """Pattern of the names of messages or channels to judge."""
    expression: Expression

    @property
    def scope(self) -> str:
        """What the rule judges: message, bus or log."""
        if self.expression.names & set(MESSAGE_NUMBERS):
            return "message"
        return "bus" if self.expression.names & set(BUS_NUMBERS) else "log"


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
    allowed = (*MESSAGE_NUMBERS, *BUS_NUMBERS, *LOG_NUMBERS)
    try:
        compiled = compile_expression(expression.strip(), allowed)
    except ExpressionError as error:
        raise LogError(f"--fail-on {error}") from error
    kinds = (MESSAGE_NUMBERS, BUS_NUMBERS, LOG_NUMBERS)
    if sum(bool(compiled.names & set(each)) for each in kinds) != 1:
        raise LogError(f"--fail-on {text!r}: name numbers of messages, of buses or of the log")
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

    def rows(self, rule: FailRule) -> list[tuple[str, Row]]:
        """Return the rows that a rule applies to, each with its name."""
        whole = [{"channel": "log", "damaged": self.damaged, "absent": self.absent}]
        rows = {"message": [*self.messages, *self.never], "bus": self.buses, "log": whole}[
            rule.scope
        ]
        named = ((str(row.get("message", row["channel"])), row) for row in rows)
        return [(who, row) for who, row in named if fnmatch.fnmatchcase(who, rule.only)]


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
