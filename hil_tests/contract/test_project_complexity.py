"""No function of the product has more than 20 independent paths, counted as radon does."""

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest

ROOT: Final = Path(__file__).parents[2]
PACKAGES: Final = (
    *("can_dbc", "zenoh_config", "firmware_py", "vobc", "plant_emulator"),
    *("hil_tests/metro_hil", "tools/metro_tools", "tools/canlog"),
)
COMPLEXITY_MAX: Final = 20
FUNCTIONS: Final = (ast.FunctionDef, ast.AsyncFunctionDef)


def complexity(function: ast.AST) -> int:
    """One, and one for each branch, loop, boolean operator, comprehension, handler and case.

    A function inside another one counts for itself.
    """
    return 1 + sum(_inside(child) for child in ast.iter_child_nodes(function))


def _inside(node: ast.AST) -> int:
    if isinstance(node, FUNCTIONS):
        return 0
    return _paths(node) + sum(_inside(child) for child in ast.iter_child_nodes(node))


def _paths(node: ast.AST) -> int:
    match node:
        case ast.If() | ast.IfExp() | ast.Assert():
            return 1
        case ast.For() | ast.While() | ast.AsyncFor():
            return 1 + bool(node.orelse)
        case ast.BoolOp():
            return len(node.values) - 1
        case ast.comprehension():
            return 1 + len(node.ifs)
        case ast.Try():
            return len(node.handlers) + bool(node.orelse)
        case ast.Match():
            rest = any(
                isinstance(case.pattern, ast.MatchAs) and case.pattern.pattern is None
                for case in node.cases
            )
            return len(node.cases) - rest
    return 0


def functions(package: str) -> Iterator[tuple[str, int]]:
    for path in sorted((ROOT / package).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, FUNCTIONS):
                yield f"{path.relative_to(ROOT)}:{node.name}", complexity(node)


def test_no_function_is_too_complex() -> None:
    over = {
        name for package in PACKAGES for name, paths in functions(package) if paths > COMPLEXITY_MAX
    }

    assert not over


@pytest.mark.parametrize(
    ("body", "paths"),
    [
        ("return 1", 1),
        ("return 1 if a else 2", 2),
        ("if a:\n  pass\n elif b and c or d:\n  pass", 5),
        ("for x in a:\n  pass\n else:\n  pass", 3),
        ("return [x for x in a if x if b]", 4),
        ("try:\n  pass\n except A:\n  pass\n except B:\n  pass", 3),
        ("match a:\n  case 1: pass\n  case 2: pass\n  case _: pass", 3),
        ("assert a\n def inner():\n  if a:\n   pass", 2),
    ],
)
def test_paths_are_counted_as_radon_counts_them(body: str, paths: int) -> None:
    assert complexity(ast.parse(f"def f():\n {body}\n").body[0]) == paths
