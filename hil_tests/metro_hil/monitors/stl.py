"""Evaluates a formula sample by sample; gives a verdict and a margin at the end.

The top of a formula consists of `always`, `eventually` and `until`, alone or joined by `and`, `or`,
`not` and `->`. They look from the first sample on. Inside them every operator that looks ahead
needs an end. So memory stays bounded, and a violation is known when its interval is over.
"""

from collections.abc import Callable, Collection
from typing import Final

from firmware_py.expression import ExpressionError, compile_expression
from metro_hil.monitors.formula import (
    AHEAD,
    Atom,
    Both,
    Either,
    Lasting,
    Node,
    Timed,
    TimeInterval,
    Until,
    witness,
)
from metro_hil.monitors.reading import FormulaError, parse
from metro_hil.monitors.streams import (
    NO_END,
    BoundedFuture,
    InstantStream,
    Joined,
    JoinedLater,
    Later,
    Margin,
    Now,
    Past,
    PastLater,
    ReadyStream,
    SlidingWindow,
    UntilLater,
)
from metro_hil.monitors.terms import MonitorTerm, Several, TermState, UntilWhole, Whole

STATIC_MAX: Final = 900
"""Maximum number of characters of a joined expression."""
NS_PER_S: Final = 1_000_000_000
NEVER_HELD: Final = "its premise never held"
HELD_AT_ONCE: Final = "it held from the first sample on, so no change was observed"


class Formula:
    """One formula over one run."""

    __slots__ = ("_began", "_first_ns", "_term", "_witness", "broken", "names", "text")

    def __init__(self, text: str, signals: Collection[str], booleans: Collection[str] = ()) -> None:
        """Parse the formula. Raises FormulaError."""
        self.text = text
        tree = parse(text, signals, booleans)
        builder = _Builder(text, signals)
        self._term: MonitorTerm = builder.term(tree)
        needed = witness(tree)
        self._witness: MonitorTerm | None = None if needed is None else builder.term(needed)
        self.names: frozenset[str] = frozenset(builder.names)
        """Names of the signals that the formula reads."""
        self._began = False
        self._first_ns = 0
        self.broken = ""
        """Reason why the formula could not be computed; empty if it could."""

    def step(self, t_ns: int, signals: object) -> bool:
        """Take one sample; return True once the formula certainly does not hold."""
        if not self._began:
            self._began = True
            self._first_ns = t_ns
        if self.broken:
            return False
        since_ns = t_ns - self._first_ns
        try:
            self._term.step(t_ns, since_ns, signals)
            needed = self._witness
            if needed is not None and needed.state is not TermState.HOLDS:
                needed.step(t_ns, since_ns, signals)
        except ZeroDivisionError:
            self.broken = f"division by zero at {since_ns / NS_PER_S:g} s"
        return self._term.state is TermState.VIOLATED

    def finish(self, cut_short: bool = False) -> None:
        """End the run; `cut_short` means that it was ended early."""
        self._term.finish(cut_short)
        if self._witness is not None:
            self._witness.finish(cut_short)

    @property
    def vacuous(self) -> str:
        """Why a formula that holds proves nothing about the run; empty if it does."""
        if self._witness is not None and self._witness.state is not TermState.HOLDS:
            return NEVER_HELD
        return HELD_AT_ONCE if self._term.trivial else ""

    @property
    def state(self) -> TermState:
        return self._term.state

    @property
    def margin(self) -> float:
        """Robustness; infinite when nothing was judged. Its sign is the verdict."""
        return self._term.margin

    @property
    def at_ns(self) -> int:
        """Instant of the sample that determines the margin."""
        return self._term.at_ns


class _Builder:
    """Builds the evaluators from the tree."""

    def __init__(self, text: str, signals: Collection[str]) -> None:
        self._text = text
        self._signals = signals
        self.names: set[str] = set()

    def term(self, node: Node) -> MonitorTerm:
        """Return the evaluator of a node at the top of the formula."""
        if isinstance(node, Both | Either):
            parts = [self.term(part) for part in node.parts]
            return Several(parts, one_is_enough=isinstance(node, Either))
        if isinstance(node, Until):
            first, second = self.later(node.first), self.later(node.second)
            return UntilWhole(first, second, node.interval, released=node.released)
        if isinstance(node, Timed) and node.lasting in AHEAD:
            greatest = node.lasting is Lasting.EVENTUALLY
            return Whole(self.stream(node.body), node.interval, greatest=greatest)
        raise self._error(
            node.position,
            "this would be evaluated in the first sample only; "
            "put it into always(…), eventually(…) or until",
        )

    def stream(self, node: Node) -> InstantStream | Later:
        """Return the evaluator of a node inside an operator."""
        static = _static(node)
        if static is not None and len(static) <= STATIC_MAX:
            return Now(self._margin(static, node))
        if isinstance(node, Both | Either):
            return self._joined(node)
        if isinstance(node, Until):
            begin_ns, end_ns = self._ends(node.interval, node.position)
            first, second = self.later(node.first), self.later(node.second)
            return UntilLater(first, second, begin_ns, end_ns, released=node.released)
        assert isinstance(node, Timed)
        greatest = node.lasting in (Lasting.EVENTUALLY, Lasting.ONCE)
        body = self.stream(node.body)
        if node.lasting in AHEAD:
            begin_ns, end_ns = self._ends(node.interval, node.position)
            return BoundedFuture(_as_later(body), begin_ns, end_ns, greatest=greatest)
        end_ns = NO_END if node.interval.end_ns is None else node.interval.end_ns
        window = SlidingWindow(node.interval.begin_ns, end_ns, greatest=greatest)
        return Past(body, window) if isinstance(body, InstantStream) else PastLater(body, window)

    def later(self, node: Node) -> Later:
        return _as_later(self.stream(node))

    def _joined(self, node: Both | Either) -> InstantStream | Later:
        greatest = isinstance(node, Either)
        parts = [self.stream(part) for part in node.parts]
        instants = [part for part in parts if isinstance(part, InstantStream)]
        if len(instants) == len(parts):
            return Joined(instants, greatest=greatest)
        return JoinedLater([_as_later(part) for part in parts], greatest=greatest)

    def _ends(self, interval: TimeInterval, position: int) -> tuple[int, int]:
        if interval.end_ns is None:
            raise self._error(
                position, "inside another operator it needs an end, such as eventually[0:5](…)"
            )
        return interval.begin_ns, interval.end_ns

    def _margin(self, text: str, node: Node) -> Margin:
        try:
            # The leading 0.0 makes the result a float even for a text of integers.
            expression = compile_expression(f"0.0 + {text}", self._signals)
        except ExpressionError as error:
            raise self._error(_position(node), "is too long or too deep") from error
        self.names |= expression.names
        value_of: Callable[[object], float] = expression.value_of
        return value_of

    def _error(self, position: int, what: str) -> FormulaError:
        return FormulaError(f"{self._text!r} at character {position + 1}: {what}")


def _as_later(body: InstantStream | Later) -> Later:
    return ReadyStream(body) if isinstance(body, InstantStream) else body


def _static(node: Node) -> str | None:
    """Return the text of the margin if it depends on the present only, otherwise None."""
    if isinstance(node, Atom):
        return node.margin
    if isinstance(node, Both | Either):
        parts = [_static(part) for part in node.parts]
        known = [part for part in parts if part is not None]
        if len(known) < len(parts):
            return None
        return f"{'max' if isinstance(node, Either) else 'min'}({', '.join(known)})"
    return None


def _position(node: Node) -> int:
    while isinstance(node, Both | Either):
        node = node.parts[0]
    return node.position
