"""Writes docs/reference/python.md: the Python names that users may rely on, from the sources."""

import ast
import inspect
import sys
import textwrap
from collections.abc import Iterator, Sequence
from typing import Any, Final

import canlog
from metro_hil.campaign.builder import Scenario
from metro_hil.model.case import CaseResult, Verdict
from metro_hil.pytest.bench import Bench, LiveRun
from metro_tools.generated_doc import write_or_check

DOCUMENT: Final = "docs/reference/python.md"
MODULE: Final = "metro_tools.api_doc"
OPENING: Final = f"""\
# Python reference

Generated from the sources by `python -m {MODULE}` (`make docs`). These names follow the promise of
[CONTRIBUTING.md](../../CONTRIBUTING.md#what-counts-as-a-breaking-change); all others may change.
"""
LOGS: Final = """\
## Logs: `canlog`

`canlog.read(LOG, DBC)` gives a `Log`; [Looking into CAN logs](../guide/canlog.md) has examples.
"""
FIXTURE: Final = """\
## Scenarios: the fixture `bench`

pytest gives a test the fixture `bench`, a `Bench`, as soon as the package is installed.
[Test campaigns](../guide/hil.md) has examples.
"""
FIXTURE_NAMES: Final = (Bench, LiveRun, Scenario, CaseResult, Verdict)
HIDDEN: Final = frozenset({"judge", "close"})
"""Methods of the fixture that the plugin calls, not a test."""


def document() -> str:
    """The whole page."""
    logs = [getattr(canlog, name) for name in canlog.__all__]
    parts = [OPENING, LOGS]
    parts += [text for each in logs for text in _entry(each, "canlog")]
    parts.append(FIXTURE)
    parts += [text for each in FIXTURE_NAMES for text in _entry(each, each.__module__)]
    return "\n".join(parts)


def _entry(thing: Any, module: str) -> Iterator[str]:
    """A class or a function with all that is public of it; constants have no entry."""
    if not (inspect.isclass(thing) or inspect.isfunction(thing)):
        return
    (node,) = ast.parse(textwrap.dedent(inspect.getsource(thing))).body
    if isinstance(node, ast.FunctionDef):
        yield f"### `{module}.{node.name}`\n"
        yield _function(node)
        return
    assert isinstance(node, ast.ClassDef)
    yield f"### `{module}.{node.name}`\n"
    yield _text(node)
    hidden = HIDDEN if thing is Bench else frozenset()
    for name, text in _attributes(node):
        yield f"- `{name}`{': ' if text else ''}{text}"
    methods = [
        part for part in node.body if isinstance(part, ast.FunctionDef) and part.name not in hidden
    ]
    yield ""
    for method in methods:
        if not method.name.startswith("_"):
            yield f"#### `{node.name}.{method.name}`\n"
            yield _function(method)


def _attributes(node: ast.ClassDef) -> Iterator[tuple[str, str]]:
    """Public attributes and members of an enumeration, with their docstrings."""
    found: list[tuple[str, str]] = []
    for part in node.body:
        if isinstance(part, ast.AnnAssign) and isinstance(part.target, ast.Name):
            found.append((f"{part.target.id}: {ast.unparse(part.annotation)}", ""))
        elif isinstance(part, ast.Assign) and isinstance(part.targets[0], ast.Name):
            found.append((part.targets[0].id, ""))
        elif isinstance(part, ast.Expr) and isinstance(part.value, ast.Constant) and found:
            found[-1] = (found[-1][0], " ".join(str(part.value.value).split()))
    return ((name, text) for name, text in found if not name.startswith("_"))


def _function(node: ast.FunctionDef) -> str:
    arguments = ast.unparse(node.args)
    property_of = any(
        ast.unparse(each) in ("property", "cached_property") for each in node.decorator_list
    )
    returns = f" -> {ast.unparse(node.returns)}" if node.returns else ""
    head = (
        f"{node.name}{returns.replace(' -> ', ': ')}"
        if property_of
        else f"{node.name}({arguments}){returns}"
    )
    return f"```text\n{head}\n```\n\n{_text(node)}"


def _text(node: ast.ClassDef | ast.FunctionDef) -> str:
    """A docstring as paragraphs; what stands indented in it as a block."""
    text = ast.get_docstring(node) or ""
    lines: list[str] = []
    for paragraph in text.split("\n\n"):
        head, *rest = paragraph.split("\n")
        if head in ("Args:", "Raises:", "Returns:"):
            lines.append(f"**{head.rstrip(':')}**\n")
            lines += [f"- {' '.join(item.split())}" for item in _items(rest)]
            lines.append("")
        elif head.startswith("    "):
            lines.append(f"```text\n{textwrap.dedent(paragraph)}\n```\n")
        else:
            lines.append(f"{' '.join(paragraph.split())}\n")
    return "\n".join(lines)


def _items(lines: Sequence[str]) -> list[str]:
    """Entries of a list of arguments, continued lines joined."""
    items: list[str] = []
    for line in textwrap.dedent("\n".join(lines)).split("\n"):
        if line.startswith(" ") and items:
            items[-1] += f" {line}"
        else:
            items.append(line)
    return [f"`{name}`: {text}" if colon else name for name, colon, text in map(_parted, items)]


def _parted(item: str) -> tuple[str, str, str]:
    name, colon, text = item.partition(":")
    return name, colon, text


def main(argv: Sequence[str] | None = None) -> int:
    """Write the page, or with --check only say whether it is current."""
    return write_or_check(
        argv, module=MODULE, description=__doc__, default_path=DOCUMENT, document=document
    )


if __name__ == "__main__":
    sys.exit(main())
