"""Reads signal temporal logic from text into the tree of `formula`.

    formula := either [("->" | "implies") formula]
    either  := both {"or" both}
    both    := held {"and" held}
    held    := plain ["until" [interval] plain]
    plain   := "not" plain | operator [interval] "(" formula ")" | "(" formula ")" | atom
    operator := "always" | "eventually" | "historically" | "once"
    interval := "[" seconds ":" seconds "]"
    atom    := sum {("<" | "<=" | ">" | ">=" | "==" | "!=") sum} | name of a boolean signal

Sums are those of `firmware_py.expression`: numbers, signals, + - * /, abs, min, max.
"""

import difflib
import re
from collections.abc import Collection
from dataclasses import dataclass
from typing import Final, TypeAlias

from firmware_py.expression import FUNCTIONS
from metro_hil.monitors.formula import (
    Atom,
    Both,
    Either,
    Lasting,
    Node,
    Timed,
    TimeInterval,
    Until,
    boolean,
    comparison,
    negation,
)

TEXT_MAX: Final = 1000
DEPTH_MAX: Final = 50
"""Maximum nesting of brackets."""
NS_PER_S: Final = 1_000_000_000
HALF: Final = "0.5"


class FormulaError(ValueError):
    """The text is not a valid formula; the message holds text, place and correction."""


@dataclass(frozen=True, slots=True)
class Sum:
    """A value that is not yet a condition."""

    text: str
    position: int
    name: str = ""
    """Name of the signal if the sum is a single signal."""


Part: TypeAlias = Node | Sum


def parse(text: str, signals: Collection[str], booleans: Collection[str] = ()) -> Node:
    """Return the tree of a text over these signals.

    Raises FormulaError.

    Args:
        booleans: signals that are 0 or 1; their margin in a comparison with 0.5 is 1 or -1.
    """
    if len(text) > TEXT_MAX:
        raise FormulaError(f"{text[:40]!r}…: longer than {TEXT_MAX} characters")
    depth = 0
    for letter in text:
        depth += (letter == "(") - (letter == ")")
        if depth > DEPTH_MAX:
            raise FormulaError(f"{text[:40]!r}…: nested too deeply")
    try:
        return _Reader(text, signals, booleans).whole()
    except RecursionError:
        raise FormulaError(f"{text[:40]!r}…: nested too deeply") from None


_TOKEN: Final = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|(?P<name>[A-Za-z_]\w*)"
    r"|(?P<sign>->|<=|>=|==|!=|[-+*/()<>,:\[\]]))"
)
_COMPARISONS: Final = ("<", "<=", ">", ">=", "==", "!=")
_WORDS: Final = ("and", "or", "not", "implies", "until", *(each.value for each in Lasting))


class _Reader:
    """Reads the text from left to right, always one token ahead."""

    def __init__(self, text: str, signals: Collection[str], booleans: Collection[str]) -> None:
        self._text = text
        self._signals, self._booleans = signals, booleans
        self._next_at = 0
        self._word = ""
        self._at = 0
        self._kind = ""
        self._advance()

    def whole(self) -> Node:
        node = self._condition(self._formula())
        if self._word:
            raise self._error(f"{self._word!r} is superfluous here")
        return node

    def _advance(self) -> str:
        taken = self._word
        match = _TOKEN.match(self._text, self._next_at)
        if match is None:
            rest = self._text[self._next_at :].lstrip()
            self._at = len(self._text) - len(rest)
            self._word = self._kind = ""
            if rest:
                raise self._error(f"{rest[0]!r} is not allowed here")
            return taken
        self._kind = match.lastgroup or ""
        self._word = match[self._kind]
        self._at = match.start(self._kind)
        self._next_at = match.end()
        return taken

    def _take(self, *tokens: str) -> bool:
        if self._word and self._word in tokens:
            self._advance()
            return True
        return False

    def _expect(self, token: str) -> None:
        if not self._take(token):
            found = repr(self._word) if self._word else "the end"
            raise self._error(f"{token!r} is expected, not {found}")

    def _error(self, what: str, position: int | None = None) -> FormulaError:
        place = (self._at if position is None else position) + 1
        return FormulaError(f"{self._text!r} at character {place}: {what}")

    def _condition(self, part: Part) -> Node:
        """Return a condition; a boolean signal alone means the comparison with 0.5."""
        if not isinstance(part, Sum):
            return part
        if part.name in self._booleans:
            return boolean(part.name, part.position, wanted=True)
        raise self._error(f"{part.text} is not a condition; compare it with a value", part.position)

    def _formula(self) -> Part:
        left = self._either()
        if self._take("->", "implies"):
            premise = self._condition(left)
            conclusion = self._condition(self._formula())
            return Either((negation(premise), conclusion), premise)
        return left

    def _either(self) -> Part:
        left = self._both()
        if self._word != "or":
            return left
        parts = [self._condition(left)]
        while self._take("or"):
            parts.append(self._condition(self._both()))
        return Either(tuple(parts))

    def _both(self) -> Part:
        left = self._held()
        if self._word != "and":
            return left
        parts = [self._condition(left)]
        while self._take("and"):
            parts.append(self._condition(self._held()))
        return Both(tuple(parts))

    def _held(self) -> Part:
        left = self._plain()
        position = self._at
        if self._take("until"):
            interval = self._interval()
            return Until(interval, self._condition(left), self._condition(self._plain()), position)
        return left

    def _plain(self) -> Part:
        position = self._at
        if self._take("not"):
            return negation(self._condition(self._plain()))
        for lasting in Lasting:
            if self._take(lasting.value):
                interval = self._interval()
                self._expect("(")
                body = self._condition(self._formula())
                self._expect(")")
                return Timed(lasting, interval, body, position)
        return self._comparison()

    def _interval(self) -> TimeInterval:
        position = self._at
        if not self._take("["):
            return TimeInterval()
        begin_ns = self._seconds()
        self._expect(":")
        end_ns = self._seconds()
        self._expect("]")
        if end_ns < begin_ns:
            raise self._error("the interval ends before it begins", position)
        return TimeInterval(begin_ns, end_ns)

    def _seconds(self) -> int:
        if self._kind != "number":
            raise self._error("a number of seconds is expected")
        return round(float(self._advance()) * NS_PER_S)

    def _comparison(self) -> Part:
        left = self._sum()
        if self._word not in _COMPARISONS:
            return left
        found: list[Atom] = []
        while self._word in _COMPARISONS:
            position, sign = self._at, self._advance()
            right = self._sum()
            found.append(self._compared(self._value(left), sign, self._value(right), position))
            left = right
        return found[0] if len(found) == 1 else Both(tuple(found))

    def _value(self, part: Part) -> Sum:
        if isinstance(part, Sum):
            return part
        raise self._error("a condition has no value to compare or calculate with")

    def _compared(self, left: Sum, sign: str, right: Sum, position: int) -> Atom:
        if left.text == HALF and right.name in self._booleans and sign in ("<", "<=", ">", ">="):
            return boolean(right.name, position, wanted=sign in ("<", "<="))
        if right.text == HALF and left.name in self._booleans and sign in ("<", "<=", ">", ">="):
            return boolean(left.name, position, wanted=sign in (">", ">="))
        return comparison(left.text, sign, right.text, position)

    def _sum(self) -> Part:
        left = self._term()
        while self._word in ("+", "-"):
            left = self._joined(left, self._advance(), self._term())
        return left

    def _term(self) -> Part:
        left = self._factor()
        while self._word in ("*", "/"):
            left = self._joined(left, self._advance(), self._factor())
        return left

    def _joined(self, left: Part, sign: str, right: Part) -> Sum:
        first, second = self._value(left), self._value(right)
        return Sum(f"({first.text} {sign} {second.text})", first.position)

    def _factor(self) -> Part:
        position = self._at
        if self._word in ("+", "-"):
            sign = self._advance()
            return Sum(f"({sign}{self._value(self._factor()).text})", position)
        if self._take("("):
            inner = self._formula()
            self._expect(")")
            return inner
        if self._kind == "number":
            return Sum(self._advance(), position)
        if self._kind == "name":
            return self._named(position)
        raise self._error(
            f"{self._word!r} cannot stand here" if self._word else "the text ends too early"
        )

    def _named(self, position: int) -> Sum:
        name = self._word
        if name in FUNCTIONS:
            self._advance()
            return self._call(name, position)
        if name not in self._signals:
            raise self._error(self._unknown(name))
        self._advance()
        return Sum(name, position, name)

    def _call(self, name: str, position: int) -> Sum:
        self._expect("(")
        arguments = [self._value(self._sum()).text]
        while self._take(","):
            arguments.append(self._value(self._sum()).text)
        self._expect(")")
        if name == "abs" and len(arguments) != 1:
            raise self._error("abs takes one argument", position)
        if name != "abs" and len(arguments) == 1:
            raise self._error(f"{name} takes two arguments or more", position)
        return Sum(f"{name}({', '.join(arguments)})", position)

    def _unknown(self, name: str) -> str:
        if name in _WORDS:
            return f"{name!r} cannot stand here"
        near = difflib.get_close_matches(name, [*self._signals, *_WORDS, *FUNCTIONS], n=1)
        hint = f"nearest: {near[0]}" if near else "`hil monitors` lists all signals"
        return f"unknown signal {name}; {hint}"
