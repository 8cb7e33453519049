"""The mutation operators: possible replacements of one node of a syntax tree. Pure."""

import ast
from collections.abc import Iterator
from typing import Final, TypeVar

T = TypeVar("T")

COMPARED: Final[dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
"""Replacements of comparisons: a moved boundary, and the negation."""

COMPUTED: Final[dict[type[ast.operator], type[ast.operator]]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.BitXor: ast.BitAnd,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
}

CALLED: Final = {
    "min": "max",
    "max": "min",
    "any": "all",
    "all": "any",
    "floor": "ceil",
    "ceil": "floor",
}

OTHER_END: Final = {
    "low": "high",
    "high": "low",
    "left": "right",
    "right": "left",
    "start_m": "end_m",
    "end_m": "start_m",
}
"""Swapped attributes, a mistake that readers easily miss: the wrong end of an interval or the wrong
side."""

FLOAT_FACTOR: Final = 1.1
"""Factor on floating-point constants. If no test fails when a quantity changes by ten percent, it
is not tested."""


def changed(holder: ast.AST, field: str, node: ast.AST) -> Iterator[ast.AST]:
    """Yield the possible replacements of `node` in `field` of `holder`."""
    if isinstance(node, ast.cmpop):
        yield from (kind() for kind in COMPARED[type(node)])
    elif isinstance(node, ast.operator):
        if (other := COMPUTED.get(type(node))) is not None:
            yield other()
    elif isinstance(node, ast.boolop):
        yield ast.And() if isinstance(node, ast.Or) else ast.Or()
    elif isinstance(node, ast.BoolOp):
        yield from _shorter(node)
    elif isinstance(node, ast.UnaryOp):
        if isinstance(node.op, ast.Not | ast.USub | ast.Invert):
            yield node.operand
    elif isinstance(node, ast.Constant):
        yield from _other_constant(node)
    elif isinstance(node, ast.Name | ast.Attribute):
        yield from _other_name(holder, field, node)
    elif isinstance(node, ast.Call) and _called(node) == "abs":
        yield node.args[0]
    if field == "test" and isinstance(node, ast.Name | ast.Attribute | ast.Call | ast.BoolOp):
        yield ast.UnaryOp(op=ast.Not(), operand=_as_expression(node))
    if isinstance(holder, ast.Return) and not _is_none(node):
        yield ast.Constant(value=None)


def dropped_elements(node: ast.AST) -> Iterator[ast.AST]:
    """Yield a table or a choice without one of its entries."""
    if isinstance(node, ast.Dict):
        for gone in range(len(node.keys)):
            yield ast.Dict(keys=_without(node.keys, gone), values=_without(node.values, gone))
    elif isinstance(node, ast.Tuple | ast.List | ast.Set) and len(node.elts) > 1:
        for gone in range(len(node.elts)):
            rest = _without(node.elts, gone)
            if isinstance(node, ast.Set):
                yield ast.Set(elts=rest)
            else:
                yield type(node)(elts=rest, ctx=ast.Load())


def _without(items: list[T], gone: int) -> list[T]:
    return items[:gone] + items[gone + 1 :]


def _shorter(node: ast.BoolOp) -> Iterator[ast.AST]:
    """Yield the expression without one of its conditions."""
    for gone in range(len(node.values)):
        rest = _without(node.values, gone)
        yield rest[0] if len(rest) == 1 else ast.BoolOp(op=node.op, values=rest)


def _other_constant(node: ast.Constant) -> Iterator[ast.AST]:
    value = node.value
    if isinstance(value, bool):
        yield ast.Constant(value=not value)
    elif isinstance(value, int):
        yield ast.Constant(value=value + 1)
    elif isinstance(value, float):
        yield ast.Constant(value=value * FLOAT_FACTOR if value else 1.0)


def _other_name(holder: ast.AST, field: str, node: ast.Name | ast.Attribute) -> Iterator[ast.AST]:
    name = node.id if isinstance(node, ast.Name) else node.attr
    other = CALLED.get(name) if isinstance(holder, ast.Call) and field == "func" else None
    if isinstance(node, ast.Attribute):
        other = other or OTHER_END.get(name)
        if other is not None:
            yield ast.Attribute(value=node.value, attr=other, ctx=node.ctx)
    elif other is not None:
        yield ast.Name(id=other, ctx=ast.Load())


def _called(node: ast.Call) -> str:
    return node.func.id if isinstance(node.func, ast.Name) else ""


def _as_expression(node: ast.AST) -> ast.expr:
    assert isinstance(node, ast.expr)
    return node


def _is_none(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and node.value is None
