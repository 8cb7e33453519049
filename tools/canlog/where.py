"""Conditions on signals, such as `force_n > 1000 and direction == FORWARD`, for whole columns."""

import ast
import operator
from collections.abc import Callable, Mapping
from functools import reduce
from typing import Any, Final

import numpy as np

from canlog.damage import LogError
from canlog.database import Bus, MessageSpec
from canlog.frames import Bools
from canlog.table import Table
from firmware_py.expression import ExpressionError, compile_expression

_ARITHMETIC: Final[Mapping[type[ast.AST], Callable[[Any, Any], Any]]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: np.true_divide,
}
_COMPARISONS: Final[Mapping[type[ast.AST], Callable[[Any, Any], Any]]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
}
_FUNCTIONS: Final[Mapping[str, Callable[..., Any]]] = {
    "abs": np.abs,
    "min": lambda *each: reduce(np.minimum, each),
    "max": lambda *each: reduce(np.maximum, each),
}


class Where:
    """One condition. It applies to messages that have every signal in it."""

    def __init__(self, text: str, bus: Bus) -> None:
        """Raises LogError for text that is no condition, or whose signals no message has
        together.
        """
        self.text = text
        specs = [
            spec for each in (bus, *bus.by_channel.values()) for spec in each.messages.values()
        ]
        signals = {each.name for spec in specs for each in spec.signals}
        labels = {
            label for spec in specs for each in spec.signals for label in each.choices.values()
        }
        try:
            compiled = compile_expression(text, signals | labels)
        except ExpressionError as error:
            raise LogError(f"--where {error}") from error
        self._names = compiled.names & signals
        self._tree = ast.parse(text.strip(), mode="eval").body
        if not self._names or not any(map(self._fits, specs)):
            raise LogError(f"--where {text!r}: no message has {' and '.join(sorted(self._names))}")

    def _fits(self, spec: MessageSpec) -> bool:
        return self._names <= {each.name for each in spec.signals}

    def covers(self, spec: MessageSpec) -> bool:
        """Whether frames of this message can fulfil the condition."""
        return self._fits(spec)

    def holds(self, table: Table) -> Bools:
        """(n,) frames for which it is true; never a frame that lacks one of the signals."""
        with np.errstate(divide="ignore", invalid="ignore"):
            value = np.asarray(self._value(self._tree, table, ""))
        held = np.broadcast_to(value != 0, len(table)).copy()
        for name in self._names:
            held &= table.valid(name)
        return held

    def _value(self, node: ast.AST, table: Table, beside: str) -> Any:
        if isinstance(node, ast.Constant):
            return node.value
        if isinstance(node, ast.Name):
            return table[node.id] if node.id in table else self._label(node.id, table, beside)
        if isinstance(node, ast.BinOp):
            left, right = (self._value(each, table, "") for each in (node.left, node.right))
            return _ARITHMETIC[type(node.op)](left, right)
        if isinstance(node, ast.UnaryOp):
            value = self._value(node.operand, table, "")
            if isinstance(node.op, ast.Not):
                return np.equal(value, 0)
            return np.negative(value) if isinstance(node.op, ast.USub) else value
        if isinstance(node, ast.BoolOp):
            each = [np.not_equal(self._value(one, table, ""), 0) for one in node.values]
            return reduce(np.logical_and if isinstance(node.op, ast.And) else np.logical_or, each)
        if isinstance(node, ast.Compare):
            return self._comparison(node, table)
        assert isinstance(node, ast.Call)
        assert isinstance(node.func, ast.Name)
        return _FUNCTIONS[node.func.id](*(self._value(each, table, "") for each in node.args))

    def _comparison(self, node: ast.Compare, table: Table) -> Any:
        terms = [node.left, *node.comparators]
        beside = next((t.id for t in terms if isinstance(t, ast.Name) and t.id in table), "")
        values = [self._value(term, table, beside) for term in terms]
        steps = zip(node.ops, values, values[1:], strict=False)
        return reduce(np.logical_and, [_COMPARISONS[type(op)](a, b) for op, a, b in steps])

    def _label(self, label: str, table: Table, beside: str) -> Any:
        """Return the value that a label has in the value table of the compared signal."""
        for signal in table.spec.signals:
            if beside in ("", signal.name):
                for raw, name in signal.choices.items():
                    if name == label:
                        return raw * signal.scale + signal.offset
        raise LogError(f"--where {self.text!r}: {beside or table.spec.name} has no value {label}")
