"""Generates all mutants of one module's source. Pure."""

import ast
import hashlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from metro_tools.mutate.operators import changed, dropped_elements

LONGEST_TEXT: Final = 160
CONTEXT: Final = 48
"""Characters shown on either side of the change in a long statement."""
KEY_DIGITS: Final = 8
MODULE_LEVEL: Final = "(module)"


@dataclass(frozen=True, slots=True)
class Mutant:
    """One changed place of one module."""

    number: int
    """Number in the order of the source; valid only for exactly that source."""
    function: str
    """Qualified name of the function, or (module) for code that runs on import."""
    line: int
    before: str
    after: str
    occurrence: int
    """Number of this change among equal changes in one function, from 1."""
    on_import: bool
    """The place runs when the module is imported: a constant, a table, a default."""

    @property
    def mutation(self) -> str:
        """The change as text; it survives edits elsewhere in the module."""
        again = f"  #{self.occurrence}" if self.occurrence > 1 else ""
        return f"{self.before}  ->  {self.after}{again}"

    @property
    def key(self) -> str:
        """Short name to select this mutant by; as stable as the text of the change."""
        told = f"{self.function}|{self.mutation}".encode()
        return hashlib.sha256(told).hexdigest()[:KEY_DIGITS]


@dataclass(frozen=True, slots=True)
class _Site:
    """A place in the syntax tree, with its replacement."""

    holder: ast.AST
    field: str
    index: int | None
    new: object
    statement: ast.stmt
    function: str
    on_import: bool

    def put(self, value: object) -> object:
        """Put a value in place and return the old one."""
        if self.index is None:
            old = getattr(self.holder, self.field)
            setattr(self.holder, self.field, value)
            return old
        items: list[object] = getattr(self.holder, self.field)
        old, items[self.index] = items[self.index], value
        return old


def mutants_of(source: str) -> list[Mutant]:
    """Return all mutants in the order of the source. Raises SyntaxError."""
    found: list[Mutant] = []
    seen: Counter[tuple[str, str, str]] = Counter()
    for number, site in enumerate(_sites(ast.parse(source))):
        before = _as_one_line(site.statement)
        old = site.put(site.new)
        after = "pass" if isinstance(site.new, ast.Pass) else _as_one_line(site.statement)
        site.put(old)
        before, after = _shortened(before, after)
        what = (site.function, before, after)
        seen[what] += 1
        found.append(
            Mutant(
                number=number,
                function=site.function,
                line=getattr(old, "lineno", site.statement.lineno),
                before=before,
                after=after,
                occurrence=seen[what],
                on_import=site.on_import,
            )
        )
    return found


def mutated(source: str, number: int) -> ast.Module:
    """Return the syntax tree with one mutation; all line numbers stay."""
    tree = ast.parse(source)
    for at, site in enumerate(_sites(tree)):
        if at == number:
            if isinstance(site.new, ast.AST):
                ast.copy_location(site.new, site.statement)
            site.put(site.new)
            return ast.fix_missing_locations(tree)
    raise IndexError(f"there is no mutant {number}")


def _sites(tree: ast.Module) -> Iterator[_Site]:
    yield from _of_body(tree, "body", (), on_import=True)


def _of_body(
    holder: ast.AST, field: str, names: tuple[str, ...], *, on_import: bool
) -> Iterator[_Site]:
    for index, statement in enumerate(getattr(holder, field)):
        yield from _of_statement(holder, field, index, statement, names, on_import=on_import)


def _of_statement(
    holder: ast.AST,
    field: str,
    index: int,
    statement: ast.stmt,
    names: tuple[str, ...],
    *,
    on_import: bool,
) -> Iterator[_Site]:
    function = _outer(names) or MODULE_LEVEL
    if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef):
        for part, list_name in ((statement.args, "defaults"), (statement.args, "kw_defaults")):
            yield from _of_parts(part, list_name, statement, function, on_import=on_import)
        inner = (*names, statement.name, "<locals>")
        yield from _of_body(statement, "body", inner, on_import=False)
        return
    if isinstance(statement, ast.ClassDef):
        yield from _of_body(statement, "body", (*names, statement.name), on_import=on_import)
        return
    if isinstance(statement, ast.Assert | ast.Import | ast.ImportFrom) or _is_told(statement):
        return
    if not on_import and _may_go(statement):
        yield _Site(holder, field, index, ast.Pass(), statement, function, False)
    for part_field, value in ast.iter_fields(statement):
        yield from _of_field(
            statement, part_field, value, statement, function, names, on_import=on_import
        )


def _outer(names: tuple[str, ...]) -> str:
    """Return the qualified name of the function around a statement."""
    return ".".join(names[:-1]) if names[-1:] == ("<locals>",) else ".".join(names)


def _of_field(
    node: ast.AST,
    field: str,
    value: object,
    statement: ast.stmt,
    function: str,
    names: tuple[str, ...],
    *,
    on_import: bool,
) -> Iterator[_Site]:
    if field in ("annotation", "returns", "targets", "type_params", "type_comment", "msg"):
        return
    if field == "target" and isinstance(node, ast.AugAssign | ast.AnnAssign | ast.For):
        return
    if isinstance(value, list) and value and isinstance(value[0], ast.stmt):
        yield from _of_body(node, field, names, on_import=on_import)
    elif isinstance(value, list | ast.AST):
        yield from _of_parts(node, field, statement, function, on_import=on_import)


def _of_parts(
    node: ast.AST, field: str, statement: ast.stmt, function: str, *, on_import: bool
) -> Iterator[_Site]:
    """Yield the possible replacements in one field of a node, and then inside of it."""
    value = getattr(node, field)
    places = enumerate(value) if isinstance(value, list) else ((None, value),)
    for index, item in places:
        if not isinstance(item, ast.AST) or _is_type(item, on_import=on_import):
            continue
        if isinstance(item, ast.expr_context | ast.JoinedStr):
            continue
        table = on_import or isinstance(node, ast.Compare)
        news = [*changed(node, field, item), *(dropped_elements(item) if table else ())]
        for new in news:
            yield _Site(node, field, index, new, statement, function, on_import)
        for name, _ in ast.iter_fields(item):
            if name not in ("annotation", "returns"):
                yield from _of_parts(item, name, statement, function, on_import=on_import)


def _is_type(item: ast.AST, *, on_import: bool) -> bool:
    """Return whether a node is a type alias or the like, which has no effect at run time."""
    if not on_import:
        return False
    if isinstance(item, ast.Subscript):
        return True
    return (
        isinstance(item, ast.BinOp)
        and isinstance(item.op, ast.BitOr)
        and any(
            isinstance(side, ast.Constant) and side.value is None
            for side in (item.left, item.right)
        )
    )


def _is_told(statement: ast.stmt) -> bool:
    """Return whether a statement is a docstring or a name that only readers of the code use."""
    if isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant):
        return True
    if isinstance(statement, ast.Assign):
        names = {target.id for target in statement.targets if isinstance(target, ast.Name)}
        return bool(names & {"__all__", "__slots__"})
    return False


def _may_go(statement: ast.stmt) -> bool:
    if isinstance(statement, ast.AnnAssign):
        return statement.value is not None
    return isinstance(
        statement,
        ast.Assign | ast.AugAssign | ast.Expr | ast.Raise | ast.Continue | ast.Break | ast.Delete,
    )


def _as_one_line(statement: ast.stmt) -> str:
    """Return a statement in one line; for a compound statement its head."""
    bodies = [
        name
        for name in ("body", "orelse", "finalbody", "handlers", "cases")
        if isinstance(getattr(statement, name, None), list)
    ]
    if not bodies:
        return " ".join(ast.unparse(statement).split())
    kept = {name: getattr(statement, name) for name in bodies}
    for name in bodies:
        setattr(statement, name, [ast.Pass()] if name == "body" else [])
    try:
        text = ast.unparse(ast.fix_missing_locations(statement))
    finally:
        for name, value in kept.items():
            setattr(statement, name, value)
    return " ".join(text.split()).removesuffix(" pass")


def _shortened(before: str, after: str) -> tuple[str, str]:
    """Shorten both texts by most of their common parts if they are long."""
    if max(len(before), len(after)) <= LONGEST_TEXT:
        return before, after
    start = next(
        (at for at, (a, b) in enumerate(zip(before, after, strict=False)) if a != b),
        min(len(before), len(after)),
    )
    ends = zip(reversed(before[start:]), reversed(after[start:]), strict=False)
    common = min(len(before), len(after)) - start
    end = next((at for at, (a, b) in enumerate(ends) if a != b), common)
    return _cut(before, start, end), _cut(after, start, end)


def _cut(text: str, start: int, end: int) -> str:
    first, last = max(0, start - CONTEXT), min(len(text), len(text) - end + CONTEXT)
    return ("…" if first else "") + text[first:last] + ("…" if last < len(text) else "")
