"""Generates the constructors of dataclasses, so that mypyc can compile them.

The constructor that `dataclass` creates during import stays interpreted, and in a frozen class it
sets every field through `object.__setattr__`. A constructor written in the class is compiled with
it, and `dataclass` keeps it. Each generated one takes the empty line after its class, so all other
lines keep their numbers in tracebacks.
"""

import ast
from collections.abc import Collection, Mapping, Sequence
from typing import Final

Heads = Mapping[str, Sequence[ast.AnnAssign]]
"""Fields by class."""

KEYWORDS: Final = {"frozen", "slots", "kw_only"}
"""Permitted arguments of `dataclass`; classes with others are left unchanged."""


def bases_in(source: str) -> set[str]:
    """Return the names of all base classes in a module."""
    classes = _classes(source)
    return {ast.unparse(base).split(".")[-1] for node in classes for base in node.bases}


def heads_in(source: str) -> Heads:
    """Return the plain dataclasses of a module without bases, with their fields; they may be bases
    of others.
    """
    return {node.name: _fields(node) for node in _classes(source) if _is_plain(node)}


def with_written_inits(source: str, bases: Collection[str] = (), heads: Heads | None = None) -> str:
    """Return the module with a constructor in each plain dataclass.

    Args:
        bases: names of classes that any module inherits from. They are left unchanged: a
            constructor in a base would hide from mypyc the one given to its subclass.
        heads: those of these bases whose subclasses are all plain dataclasses in modules processed
            like this one; they get constructors like their subclasses.
    """
    heads = heads or {}
    lines = [*source.splitlines(), ""]
    for node in _classes(source):
        head = _head_of(node, heads)
        if head is not None and (node.name not in bases or node.name in heads):
            behind = node.body[-1].end_lineno
            assert behind is not None
            if not lines[behind].strip():
                lines[behind] = _init(node, head)
    return "\n".join(lines).rstrip("\n") + "\n"


def with_native_records(source: str, tuples: Collection[str] = ()) -> str:
    """Return the module with a frozen dataclass for each named tuple.

    mypyc has no support for named tuples: the interpreter creates each one and looks each field up
    by name. The decorator takes the empty line before the class. `_replace` takes the place of the
    class's docstring; if the class has at least three docstrings, equality and hash take the next
    two.

    Args:
        tuples: names of classes that code unpacks, sorts or counts. They are left unchanged.
    """
    lines = source.splitlines()
    records = [each for each in _classes(source) if _is_record(each) and each.name not in tuples]
    for node in records:
        before = node.lineno - 2
        assert not lines[before].strip()
        lines[before] = f"{' ' * node.col_offset}@dataclass(frozen=True, slots=True)"
        lines[node.lineno - 1] = lines[node.lineno - 1].replace("(NamedTuple)", "", 1)
        said = [each for each in node.body if isinstance(each, ast.Expr)]
        methods = [_replacing(node), _equality(node), _hash(node)]
        for words, method in zip(said, methods[: 3 if len(said) > 2 else 1], strict=False):
            first, behind = words.lineno - 1, words.end_lineno
            assert behind is not None
            lines[first:behind] = [method, *[""] * (behind - first - 1)]
    if records:
        (taken,) = (
            each
            for each in ast.parse(source).body
            if isinstance(each, ast.ImportFrom) and "NamedTuple" in ast.unparse(each)
        )
        at = taken.lineno - 1
        lines[at] = f"from dataclasses import dataclass; {lines[at]}"
    return "\n".join(lines) + "\n"


def with_kept_types(source: str) -> str:
    """Return the module with statements at its end that set the field types of each dataclass
    again.

    The settings reader needs the types, and mypyc keeps only the names.
    """
    kept: list[str] = []
    for node in ast.parse(source).body:
        if isinstance(node, ast.ClassDef) and _is_dataclass(node) and _fields(node):
            types = ", ".join(
                f"{ast.unparse(each.target)!r}: {ast.unparse(each.annotation)}"
                for each in _fields(node)
            )
            kept.append(f"setattr({node.name}, '__annotations__', {{{types}}})")
    return "\n".join([source.rstrip("\n"), *kept]) + "\n"


def _classes(source: str) -> list[ast.ClassDef]:
    return [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.ClassDef)]


def _is_record(node: ast.ClassDef) -> bool:
    return [ast.unparse(base) for base in node.bases] == ["NamedTuple"]


def _hash(node: ast.ClassDef) -> str:
    values = ", ".join(f"self.{ast.unparse(field.target)}" for field in _fields(node))
    return f"{_margin(node)}def __hash__(self) -> int: return hash(({values},))"


def _equality(node: ast.ClassDef) -> str:
    """Return an equality method.

    That of a dataclass is interpreted and creates a tuple of both sides.
    """
    names = [ast.unparse(field.target) for field in _fields(node)]
    values = " and ".join(f"self.{name} == other.{name}" for name in names)
    head = f"{_margin(node)}def __eq__(self, other: object) -> bool"
    return f"{head}: return isinstance(other, {node.name}) and {values}"


def _replacing(node: ast.ClassDef) -> str:
    names = [ast.unparse(field.target) for field in _fields(node)]
    values = ", ".join(f"changes.get({name!r}, self.{name})" for name in names)
    head = f"{_margin(node)}def _replace(self, **changes: object)"
    return f'{head} -> "{node.name}": return {node.name}({values})  # type: ignore[arg-type]'


def _is_dataclass(node: ast.ClassDef) -> bool:
    return any(ast.unparse(each).startswith("dataclass") for each in node.decorator_list)


def _head_of(node: ast.ClassDef, heads: Heads) -> Sequence[ast.AnnAssign] | None:
    """Return the fields that a plain class inherits; None if the class is not plain."""
    if _is_plain(node):
        return ()
    head = heads.get(ast.unparse(node.bases[0])) if len(node.bases) == 1 else None
    return head if head is not None and _is_plain(node, heir=True) else None


def _is_plain(node: ast.ClassDef, *, heir: bool = False) -> bool:
    """Return whether a class is a dataclass without bases, with only ordinary fields."""
    if (node.bases and not heir) or node.keywords or len(node.decorator_list) != 1:
        return False
    call = node.decorator_list[0]
    if not isinstance(call, ast.Call) or ast.unparse(call.func) != "dataclass":
        return False
    if any(keyword.arg not in KEYWORDS for keyword in call.keywords):
        return False
    fields, methods = _fields(node), _methods(node)
    unusual = any(_calls_or_class_variable(field) for field in fields)
    return bool(fields) and "__init__" not in methods and not unusual


def _is_frozen(node: ast.ClassDef) -> bool:
    return "frozen=True" in ast.unparse(node.decorator_list[0])


def _fields(node: ast.ClassDef) -> Sequence[ast.AnnAssign]:
    return [each for each in node.body if isinstance(each, ast.AnnAssign)]


def _methods(node: ast.ClassDef) -> set[str]:
    return {each.name for each in node.body if isinstance(each, ast.FunctionDef)}


def _calls_or_class_variable(field: ast.AnnAssign) -> bool:
    """Return whether the default is a call, which may be `field(...)` or an object shared by all
    instances, or the field belongs to the class.
    """
    kind = ast.unparse(field.annotation)
    return isinstance(field.value, ast.Call) or "ClassVar" in kind or "InitVar" in kind


def _margin(node: ast.ClassDef) -> str:
    return " " * node.body[0].col_offset


def _init(node: ast.ClassDef, head: Sequence[ast.AnnAssign]) -> str:
    keyword_only = "kw_only=True" in ast.unparse(node.decorator_list[0])
    parameters, statements = ["self", *(["*"] if keyword_only else [])], []
    for field in (*head, *_fields(node)):
        name, kind = ast.unparse(field.target), ast.unparse(field.annotation)
        default = "" if field.value is None else f" = {ast.unparse(field.value)}"
        parameters.append(f"{name}: {kind}{default}")
        statements.append(f"self.{name} = {name}")
    if "__post_init__" in _methods(node):
        statements.append("self.__post_init__()")
    line = f"{_margin(node)}def __init__({', '.join(parameters)}) -> None: "
    # Only the constructor may assign to a frozen class, and mypy has no exception for that.
    exception = "  # type: ignore[misc]" if _is_frozen(node) else ""
    return f"{line}{'; '.join(statements)}{exception}"
