"""Writes docs/reference/laws/LAW.md for each control law from its LAW.toml, or checks it."""

import argparse
import ast
import dataclasses
import importlib
import inspect
import json
import sys
import textwrap
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from firmware_py.storage.whole_file import write_whole

LAWS: Final = "docs/reference/laws"
RESULTS: Final = "hil_tests/metro_hil/law_results.json"
EXIT_OK: Final = 0
EXIT_OUTDATED: Final = 1
EXIT_USAGE: Final = 2
TEXTS: Final = ("title", "summary", "source")
TABLES: Final[Mapping[str, tuple[str, ...]]] = {
    "block": ("id", "label", "what"),
    "link": ("from", "to", "label"),
    "equation": ("text", "source", "code"),
    "remark": ("text",),
}
MAY_BE_EMPTY: Final = ("link.label",)
UNITS: Final[Mapping[str, str]] = {
    "mps": "m/s",
    "mps2": "m/s²",
    "mps3": "m/s³",
    "mps4": "m/s⁴",
    "m": "m",
    "s": "s",
    "s2": "s²",
    "ms": "ms",
    "ns": "ns",
    "kg": "kg",
    "n": "N",
    "a": "A",
    "ma": "mA",
    "hz": "Hz",
    "ratio": "1",
    "percent": "%",
    "permille": "‰",
    "v": "V",
    "w": "W",
    "ohm": "Ω",
    "kpa": "kPa",
}
HEADS: Final = (
    "scenario",
    "stops",
    "mean, cm [95 %]",
    "worst, cm",
    "bound, cm",
    "within 10 cm [at least]",
    "run, s",
    "over the shortest, %",
    "asked: m/s², m/s³",
    "felt: m/s², m/s³ over 1 s, m/s³ at 2 Hz",
    "EN 12299",
)
ASKED: Final = ("commanded_accel_max_mps2", "commanded_jerk_max_mps3")
FELT: Final = ("felt_accel_max_mps2", "felt_jerk_1s_mps3", "felt_jerk_2hz_mps3")


class LawDocError(Exception):
    """A file from which no page can be generated; the text names file, key and value."""


def document(law: str, table: Mapping[str, Any], results: Mapping[str, Any]) -> str:
    """Return the page of one law.

    Args:
        table: content of its TOML file.
        results: figures by scenario, as `hil laws --write` stores them for this law.

    Raises LawDocError.
    """
    where = f"{LAWS}/{law}.toml"
    _check(table, where)
    parts = [
        f"# {table['title']}\n",
        f"Generated from `{where}`, the settings in the code and `{RESULTS}` by\n"
        "`python -m metro_tools.law_doc` (`make docs`); change those and generate it again.\n",
        f"{_prose(table['summary'])}\n",
        f"Source: {_prose(table['source']).rstrip('.')}. `vobc run --ato {law}` drives with it; a "
        f'campaign does with `believed = {{ "ato.strategy" = "{law}" }}` in its `[train]`.\n',
        *_diagram(table, where),
        *_equations(table["equation"], where),
        *_settings(table["settings"], where),
        *_figures(results),
        *_remarks(table.get("remark", [])),
    ]
    return "\n".join(parts)


def _check(table: Mapping[str, Any], where: str) -> None:
    for key in table:
        if key not in (*TEXTS, "settings", *TABLES):
            raise LawDocError(f"{where}: unknown key {key}")
    for key in TEXTS:
        _text(table, key, f"{where}: {key}")
    settings = table.get("settings")
    if not isinstance(settings, list) or not all(isinstance(name, str) for name in settings):
        raise LawDocError(f"{where}: settings is not a list of texts: {settings!r}")
    for name, keys in TABLES.items():
        entries = table.get(name, [])
        if not isinstance(entries, list) or (name != "remark" and not entries):
            raise LawDocError(f"{where}: {name}: write [[{name}]] at least once")
        for number, entry in enumerate(entries, start=1):
            for key in {*keys, *entry}:
                if key not in keys:
                    raise LawDocError(f"{where}: {name} {number}: unknown key {key}")
                empty = f"{name}.{key}" in MAY_BE_EMPTY
                if not empty or key in entry:
                    _text(entry, key, f"{where}: {name} {number}: {key}", empty=empty)


def _text(table: Mapping[str, Any], key: str, where: str, *, empty: bool = False) -> None:
    value = table.get(key)
    if not isinstance(value, str) or not (value.strip() or empty):
        raise LawDocError(f"{where} is not a text: {value!r}")


def _diagram(table: Mapping[str, Any], where: str) -> Iterator[str]:
    blocks = table["block"]
    ids = [block["id"] for block in blocks]
    for number, name in enumerate(ids, start=1):
        if not name.isidentifier() or name in ids[: number - 1]:
            raise LawDocError(
                f"{where}: block {number}: id {name!r} is not a name, or is defined twice"
            )
    lines = ["## Block diagram\n", "```mermaid", "flowchart LR"]
    lines += [f'    {block["id"]}["{_quoted(block["label"])}"]' for block in blocks]
    for number, link in enumerate(table["link"], start=1):
        for end in ("from", "to"):
            if link[end] not in ids:
                raise LawDocError(
                    f"{where}: link {number}: {end} {link[end]!r} is not the id of a block"
                )
        label = link.get("label", "")
        arrow = f'-- "{_quoted(label)}" -->' if label else "-->"
        lines.append(f"    {link['from']} {arrow} {link['to']}")
    yield "\n".join([*lines, "```\n"])
    yield _table(("block", "what"), [(block["label"], block["what"]) for block in blocks])


def _quoted(text: str) -> str:
    """Escape text for quotes in mermaid."""
    return " ".join(text.split()).replace('"', "#quot;")


def _equations(equations: Sequence[Mapping[str, str]], where: str) -> Iterator[str]:
    yield "## Equations\n"
    for number, equation in enumerate(equations, start=1):
        code = equation["code"]
        place = f"{where}: equation {number}: code"
        found(code, place)
        module, _, name = code.partition(":")
        path = f"../../../{module.replace('.', '/')}.py"
        text = equation["text"].strip("\n")
        yield f"```text\n{text}\n```\n"
        yield f"{_prose(equation['source']).rstrip('.')}. Code: [`{name}`]({path}).\n"


def found(code: str, where: str) -> Any:
    """Return the object named by `module:qualified name`. Raises LawDocError."""
    module, colon, names = code.partition(":")
    if not colon or not names:
        raise LawDocError(f"{where} {code!r} is not module:name")
    try:
        thing: Any = importlib.import_module(module)
    except ImportError as error:
        raise LawDocError(f"{where} {code!r}: {error}") from error
    for name in names.split("."):
        if not hasattr(thing, name) and name not in getattr(thing, "__annotations__", {}):
            raise LawDocError(f"{where} {code!r}: there is no {name}")
        thing = getattr(thing, name, None)
    return thing


def _settings(names: Sequence[str], where: str) -> Iterator[str]:
    yield "## Parameters\n"
    if not names:
        yield "It has no parameters of its own.\n"
    for number, code in enumerate(names, start=1):
        kind = found(code, f"{where}: settings {number}")
        if not (isinstance(kind, type) and dataclasses.is_dataclass(kind)):
            raise LawDocError(f"{where}: settings {number} {code!r} is not a class of settings")
        words, of_fields = docstrings(kind)
        yield f"### {kind.__name__}\n"
        if words:
            yield f"{_prose(words)}\n"
        rows = [
            (f"`{field.name}`", unit_of(field.name), _default(field), of_fields.get(field.name, ""))
            for field in dataclasses.fields(kind)
        ]
        yield _table(("name", "unit", "default", "meaning"), rows)


def docstrings(kind: type) -> tuple[str, dict[str, str]]:
    """Return the docstring of a class, and those of its fields, from its source."""
    (node,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
    assert isinstance(node, ast.ClassDef)
    words: dict[str, str] = {}
    name = ""
    for part in node.body:
        if isinstance(part, ast.AnnAssign) and isinstance(part.target, ast.Name):
            name = part.target.id
        elif name and isinstance(part, ast.Expr) and isinstance(part.value, ast.Constant):
            words[name] = _prose(str(part.value.value))
            name = ""
        else:
            name = ""
    return ast.get_docstring(node) or "", words


def unit_of(name: str) -> str:
    """Return the unit by the end of the name: `kp_per_s2` is in 1/s², `jerk_mps3` in m/s³;
    otherwise a dash.
    """
    if name.endswith("_rad_s"):
        return "rad/s"
    head, per, below = name.rpartition("_per_")
    if per:
        above = UNITS.get(head.rpartition("_")[2], "1")
        return f"{above}/{UNITS.get(below, below)}"
    return UNITS.get(name.rpartition("_")[2], "–") if "_" in name else "–"


def _default(field: "dataclasses.Field[Any]") -> str:
    if field.default is not dataclasses.MISSING:
        return _value(field.default)
    if field.default_factory is not dataclasses.MISSING:
        return _value(field.default_factory())
    return "–"


def _value(value: Any) -> str:
    """Format numbers briefly, and nested settings by their fields."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.6g}"
    if dataclasses.is_dataclass(value):
        fields = dataclasses.fields(value)
        return ", ".join(f"{f.name} {_value(getattr(value, f.name))}" for f in fields)
    if isinstance(value, tuple | list):
        return ", ".join(map(_value, value)) or "none"
    return str(getattr(value, "name", value))


def _figures(results: Mapping[str, Any]) -> Iterator[str]:
    yield "## Figures\n"
    if not results:
        yield "None is stored yet; `hil laws --run FOLDER --write` stores them.\n"
        return
    yield (
        "From campaigns on the bench with all frames. Means of |stop error| with their bootstrap\n"
        "interval over seeds, shares with their lower bound by Clopper–Pearson, 95 % each;\n"
        "comfort is the greatest of all runs, felt in the worst car. *bound*: mean half width of\n"
        "the controller's position interval at the stops. *over the shortest*: running time over\n"
        "the shortest that speed limits, 0.8 m/s² and 0.6 m/s³ allow. *EN 12299*: index of the\n"
        "mean comfort, by longitudinal motion alone.\n"
    )
    yield _table(HEADS, [_figure_row(name, each) for name, each in results.items()])


def _figure_row(name: str, each: Mapping[str, Any]) -> tuple[str, ...]:
    of = each["figures"]
    mean = _centimetres(of["mean_m"], "{:.2f}")
    if of["mean_low_m"] != of["mean_high_m"]:
        low, high = (_centimetres(of[key], "{:.2f}") for key in ("mean_low_m", "mean_high_m"))
        mean += f" [{low}–{high}]"
    share = "–"
    if of["within_ratio"] is not None:
        share = f"{of['within_ratio'] * 100.0:.4g} % [{of['within_low_ratio'] * 100.0:.4g} %]"
    stops = f"{of['stops']}" + (f", {of['missed']} missed" if of["missed"] else "")
    return (
        f"{each['title'] or name} (`hil run {name}`)",
        stops,
        mean,
        _centimetres(of["worst_m"], "{:+.1f}"),
        _centimetres(of.get("bound_m"), "{:.1f}"),
        share,
        _number(of["run_s"], 1),
        _number(None if of.get("over_ratio") is None else of["over_ratio"] * 100.0, 1),
        ", ".join(_number(of["comfort"].get(key), 2) for key in ASKED),
        ", ".join(_number(of["comfort"].get(key), 2) for key in FELT),
        _number(of["comfort"].get("en12299_index_ratio"), 2),
    )


def _centimetres(value_m: float | None, form: str) -> str:
    return "–" if value_m is None else form.format(value_m * 100.0)


def _number(value: float | None, digits: int) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


def _remarks(remarks: Sequence[Mapping[str, str]]) -> Iterator[str]:
    if remarks:
        yield "## Remarks\n"
        yield "".join(f"- {_prose(remark['text'])}\n" for remark in remarks)


def _prose(text: str) -> str:
    """Return the text in one line, for tables and paragraphs."""
    return " ".join(text.split())


def _table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    body = [[_prose(cell).replace("|", "\\|") for cell in row] for row in rows]
    lines = [heads, ["---"] * len(heads), *body]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def read(path: Path) -> dict[str, Any]:
    """Read a TOML file. Raises LawDocError if it is not TOML."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise LawDocError(f"{path}: {error.strerror}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise LawDocError(f"{path}: not TOML: {error}") from error


def pages(root: Path) -> dict[Path, str]:
    """Return the expected pages of all laws with a file, by path. Raises LawDocError."""
    kept = root / RESULTS
    try:
        results: dict[str, Any] = json.loads(kept.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise LawDocError(f"{kept}: {error}") from error
    return {
        path.with_suffix(".md"): document(path.stem, read(path), results.get(path.stem, {}))
        for path in sorted((root / LAWS).glob("*.toml"))
    }


def main(argv: Sequence[str] | None = None) -> int:
    """Write the pages, or with --check only report whether they are current."""
    parser = argparse.ArgumentParser(prog="python -m metro_tools.law_doc", description=__doc__)
    parser.add_argument("root", nargs="?", default=".", help="the project's folder; default: here")
    parser.add_argument("--check", action="store_true", help="write nothing; exit 1 if outdated")
    options = parser.parse_args(argv)
    try:
        made = pages(Path(options.root))
    except LawDocError as error:
        print(f"law_doc: {error}", file=sys.stderr)
        return EXIT_USAGE
    code = EXIT_OK
    for path, text in made.items():
        if not options.check:
            write_whole(path, text)
        elif not path.is_file() or path.read_text(encoding="utf-8") != text:
            print(f"{path}: outdated; run python -m metro_tools.law_doc", file=sys.stderr)
            code = EXIT_OUTDATED
    return code


if __name__ == "__main__":
    sys.exit(main())
