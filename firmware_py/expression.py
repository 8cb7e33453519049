"""Expressions that users write over named signals, such as `speed_mps > 10 and front_m < 1500`.

The grammar consists of Python's arithmetic, comparisons and `and`, `or`, `not` over numbers and the
names that the caller permits, and of the functions in FUNCTIONS. A signal with named values can be
compared with a name in quotes, such as `supervision == "emergency"`. Nothing else can be called or
accessed.
"""

import ast
import difflib
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any, Final

FUNCTIONS: Final[dict[str, Callable[..., float]]] = {"abs": abs, "min": min, "max": max}
ARGUMENTS: Final = {"abs": (1, 1), "min": (2, 100), "max": (2, 100)}
"""Least and greatest number of arguments of each function."""
TEXT_MAX: Final = 1000
_ALLOWED: Final = (
    ast.BoolOp, ast.And, ast.Or, ast.UnaryOp, ast.Not, ast.USub, ast.UAdd, ast.BinOp, ast.Add,
    ast.Sub, ast.Mult, ast.Div, ast.Compare, ast.Lt, ast.LtE, ast.Gt, ast.GtE, ast.Eq, ast.NotEq,
    ast.Call, ast.Name, ast.Load, ast.Constant,
)  # fmt: skip


NamedValues = Mapping[str, Mapping[str, float]]
"""Values by name of each signal that has named values."""
NO_NAMES: Final[NamedValues] = {}


class ExpressionError(ValueError):
    """A text that is not a valid expression over the permitted names; the message says what is
    wrong.
    """


@dataclass(frozen=True, slots=True)
class Expression:
    """A compiled expression.

    Call it with an object whose attributes are the signals; true and false are 1.0 and 0.0.
    """

    text: str
    names: frozenset[str]
    """Names of the signals that the expression reads."""
    value_of: Callable[[Any], float]

    def __call__(self, signals: object) -> float:
        """Evaluate the expression.

        A division by zero raises ZeroDivisionError, which the caller must handle.
        """
        return float(self.value_of(signals))


def compile_expression(
    text: str, allowed: Collection[str], named: NamedValues = NO_NAMES
) -> Expression:
    """Compile an expression.

    Raises ExpressionError that names the first item that is not permitted.
    """
    if len(text) > TEXT_MAX:
        raise ExpressionError(f"{text[:40]!r}…: longer than {TEXT_MAX} characters")
    try:
        tree = ast.parse(text.strip(), mode="eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise ExpressionError(f"{text!r}: not an expression") from error
    tree = _NamedAsNumbers(text, named).visit(tree)
    names: set[str] = set()
    called = {id(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
    for node in ast.walk(tree.body):
        _check(node, text, allowed, is_function=id(node) in called)
        if isinstance(node, ast.Name) and id(node) not in called:
            names.add(node.id)
    body = ast.fix_missing_locations(ast.Expression(_SignalReads(called).visit(tree.body)))
    reader = ast.parse("lambda _signals: 0", mode="eval")
    assert isinstance(reader.body, ast.Lambda)
    reader.body.body = body.body
    # Only nodes of _ALLOWED are left, so the code can access only the signals and FUNCTIONS.
    code = compile(ast.fix_missing_locations(reader), "<expression>", "eval")
    value_of = eval(code, {"__builtins__": {}, **FUNCTIONS})  # noqa: S307
    return Expression(text, frozenset(names), value_of)


def _check(node: ast.AST, text: str, allowed: Collection[str], *, is_function: bool) -> None:
    if not isinstance(node, _ALLOWED):
        raise ExpressionError(f"{text!r}: {type(node).__name__.lower()} is not allowed here")
    if isinstance(node, ast.Constant) and not isinstance(node.value, int | float):
        raise ExpressionError(f"{text!r}: {node.value!r} is not a number")
    if isinstance(node, ast.Call):
        if not isinstance(node.func, ast.Name) or node.func.id not in FUNCTIONS:
            raise ExpressionError(f"{text!r}: only {', '.join(FUNCTIONS)} can be called")
        if node.keywords:
            raise ExpressionError(f"{text!r}: {node.func.id} takes plain arguments")
        few, many = ARGUMENTS[node.func.id]
        if not few <= len(node.args) <= many:
            wanted = "one argument" if many == 1 else "two arguments or more"
            raise ExpressionError(f"{text!r}: {node.func.id} takes {wanted}")
    if isinstance(node, ast.Name) and not is_function and node.id not in allowed:
        close = difflib.get_close_matches(node.id, list(allowed), n=1)
        hint = f"nearest: {close[0]}" if close else f"known: {', '.join(sorted(allowed))}"
        raise ExpressionError(f"{text!r}: unknown signal {node.id}; {hint}")


class _NamedAsNumbers(ast.NodeTransformer):
    """Replaces each name in quotes by the value of the signal that it is compared with."""

    def __init__(self, text: str, named: NamedValues) -> None:
        self._text, self._named = text, named

    def visit_Compare(self, node: ast.Compare) -> ast.AST:
        sides = [node.left, *node.comparators]
        for index, side in enumerate(sides):
            if isinstance(side, ast.Constant) and isinstance(side.value, str):
                beside = sides[max(0, index - 1) : index] + sides[index + 1 : index + 2]
                sides[index] = ast.Constant(self._number(side.value, beside))
        node.left, node.comparators = sides[0], sides[1:]
        return self.generic_visit(node)

    def _number(self, value: str, beside: list[ast.expr]) -> float:
        for each in beside:
            if isinstance(each, ast.Name) and each.id in self._named:
                values = self._named[each.id]
                if value in values:
                    return values[value]
                close = difflib.get_close_matches(value, list(values), n=1)
                hint = f"nearest: {close[0]}" if close else f"known: {', '.join(values)}"
                raise ExpressionError(f"{self._text!r}: {each.id} is never {value!r}; {hint}")
        known = ", ".join(self._named) or "none"
        raise ExpressionError(
            f"{self._text!r}: {value!r} is not a number; signals with named values: {known}"
        )


class _SignalReads(ast.NodeTransformer):
    """Replaces each name by a read of the attribute of that name."""

    def __init__(self, called: set[int]) -> None:
        self._called = called

    def visit_Name(self, node: ast.Name) -> ast.AST:
        if id(node) in self._called:
            return node
        return ast.Attribute(ast.Name("_signals", ast.Load()), node.id, ast.Load())
