"""Rejects formulas that no run can decide: without a signal, or with a constant result."""

import ast
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import Final

from metro_hil.monitors.formula import Atom, Both, Either, Node, Timed, Until, witness
from metro_hil.monitors.reading import FormulaError, parse
from metro_hil.monitors.vocabulary import BOOLEANS, NAMES, RANGES

Range = tuple[float, float]
ANYTHING: Final[Range] = (-math.inf, math.inf)
ATOMS_MAX: Final = 8
"""Largest number of different comparisons of which all combinations are tried."""


@lru_cache(maxsize=1024)
def refuse_constant(text: str, narrower: tuple[tuple[str, Range], ...] = ()) -> None:
    """Raise FormulaError for a formula that no run can violate, fulfil or exercise.

    Args:
        narrower: ranges of signals that hold for the intended runs.
    """
    ranges, tree = {**RANGES, **dict(narrower)}, parse(text, NAMES, BOOLEANS)
    for atom in _atoms(tree):
        if not _names(atom.margin):
            raise _error(text, atom.position, "compares without a signal; name one")
    decided = _decided(tree, ranges)
    if decided is not None:
        what = "no run can violate it" if decided else "no run can fulfil it"
        raise FormulaError(
            f"{text!r} is {str(decided).lower()} for all values of its signals; {what}"
        )
    needed = witness(tree)
    if needed is not None and _decided(needed, ranges) is False:
        raise FormulaError(f"{text!r}: its premise cannot hold, so the formula never applies")


def _error(text: str, position: int, what: str) -> FormulaError:
    return FormulaError(f"{text!r} at character {position + 1}: {what}")


def _atoms(node: Node) -> Iterator[Atom]:
    if isinstance(node, Atom):
        yield node
    elif isinstance(node, Both | Either):
        for part in node.parts:
            yield from _atoms(part)
    elif isinstance(node, Timed):
        yield from _atoms(node.body)
    else:
        yield from _atoms(node.first)
        yield from _atoms(node.second)


def _decided(node: Node, ranges: Mapping[str, Range]) -> bool | None:
    """Return the result if it is the same in every run, otherwise None."""
    if isinstance(node, Atom):
        return _sign(node.margin, ranges)
    if isinstance(node, Timed):
        # Over an interval without a sample `always` holds and `eventually` does not.
        return _decided(node.body, ranges)
    if isinstance(node, Until):
        second = None if node.released else _decided(node.second, ranges)
        return None if second and node.interval.begin_ns else second
    answers = [_decided(part, ranges) for part in node.parts]
    strong = isinstance(node, Either)
    if strong in answers:
        return strong
    if all(answer is (not strong) for answer in answers):
        return not strong
    return _tried(node)


def _tried(node: Both | Either) -> bool | None:
    """Try every combination of results of the comparisons; two comparisons of one text agree."""
    atoms = {min(atom.margin, atom.negated): atom for atom in _atoms(node)}
    if not _present(node) or len(atoms) > ATOMS_MAX:
        return None
    found = {
        _answer(node, dict(zip(atoms, answers, strict=True)))
        for answers in product((False, True), repeat=len(atoms))
    }
    return found.pop() if len(found) == 1 else None


def _present(node: Node) -> bool:
    if isinstance(node, Both | Either):
        return all(map(_present, node.parts))
    return isinstance(node, Atom)


def _answer(node: Node, answers: Mapping[str, bool]) -> bool:
    if isinstance(node, Atom):
        key = min(node.margin, node.negated)
        return answers[key] is (key == node.margin)
    assert isinstance(node, Both | Either)
    join = any if isinstance(node, Either) else all
    return join(_answer(part, answers) for part in node.parts)


def _names(margin: str) -> set[str]:
    return {
        each.id
        for each in ast.walk(ast.parse(margin, mode="eval"))
        if isinstance(each, ast.Name) and each.id not in ("min", "max", "abs")
    }


def _sign(margin: str, ranges: Mapping[str, Range]) -> bool | None:
    """Tell whether a margin is never negative or always negative; None if neither is certain."""
    low, high = _bounds(ast.parse(margin, mode="eval").body, ranges)
    if low >= 0.0:
        return True
    return False if high < 0.0 else None


@dataclass(frozen=True, slots=True)
class _Linear:
    """A sum of multiples of signals and a constant."""

    factors: Mapping[str, float]
    constant: float

    def bounds(self, ranges: Mapping[str, Range]) -> Range:
        low = high = self.constant
        for name, factor in self.factors.items():
            if factor != 0.0:
                ends = [factor * end for end in ranges.get(name, ANYTHING)]
                low, high = low + min(ends), high + max(ends)
        return low, high

    def plus(self, other: "_Linear", factor: float) -> "_Linear":
        names = {*self.factors, *other.factors}
        factors = {
            name: self.factors.get(name, 0.0) + factor * other.factors.get(name, 0.0)
            for name in names
        }
        return _Linear(factors, self.constant + factor * other.constant)


NO_FACTORS: Final[Mapping[str, float]] = {}


def _linear(node: ast.expr) -> _Linear | None:
    if isinstance(node, ast.Constant):
        assert isinstance(node.value, int | float)
        return _Linear(NO_FACTORS, float(node.value))
    if isinstance(node, ast.Name):
        return _Linear({node.id: 1.0}, 0.0)
    if isinstance(node, ast.UnaryOp):
        inner = _linear(node.operand)
        sign = -1.0 if isinstance(node.op, ast.USub) else 1.0
        return None if inner is None else _Linear(NO_FACTORS, 0.0).plus(inner, sign)
    if not isinstance(node, ast.BinOp):
        return None
    left, right = _linear(node.left), _linear(node.right)
    if left is None or right is None:
        return None
    if isinstance(node.op, ast.Add | ast.Sub):
        return left.plus(right, 1.0 if isinstance(node.op, ast.Add) else -1.0)
    if isinstance(node.op, ast.Div):
        if right.factors or right.constant == 0.0:
            return None
        return _Linear(NO_FACTORS, 0.0).plus(left, 1.0 / right.constant)
    if left.factors and right.factors:
        return None
    many, one = (left, right) if left.factors else (right, left)
    return _Linear(NO_FACTORS, 0.0).plus(many, one.constant)


def _bounds(node: ast.expr, ranges: Mapping[str, Range]) -> Range:
    """Return bounds of the value; they may be wider than the true range, but never narrower."""
    linear = _linear(node)
    if linear is not None:
        return _known(linear.bounds(ranges))
    if isinstance(node, ast.Call):
        assert isinstance(node.func, ast.Name)
        parts = [_bounds(part, ranges) for part in node.args]
        return _known(_of_call(node.func.id, parts))
    if isinstance(node, ast.UnaryOp):
        low, high = _bounds(node.operand, ranges)
        return (-high, -low) if isinstance(node.op, ast.USub) else (low, high)
    if isinstance(node, ast.BinOp):
        left, right = _bounds(node.left, ranges), _bounds(node.right, ranges)
        if isinstance(node.op, ast.Add):
            return _known((left[0] + right[0], left[1] + right[1]))
        if isinstance(node.op, ast.Sub):
            return _known((left[0] - right[1], left[1] - right[0]))
        if isinstance(node.op, ast.Mult):
            ends = [one * other for one in left for other in right]
            return ANYTHING if any(map(math.isnan, ends)) else (min(ends), max(ends))
    return ANYTHING


def _of_call(name: str, parts: list[Range]) -> Range:
    lows, highs = zip(*parts, strict=True)
    if name == "abs":
        low, high = parts[0]
        least = 0.0 if low <= 0.0 <= high else min(abs(low), abs(high))
        return least, max(abs(low), abs(high))
    join = min if name == "min" else max
    return join(lows), join(highs)


def _known(found: Range) -> Range:
    low, high = found
    return (-math.inf if math.isnan(low) else low, math.inf if math.isnan(high) else high)
