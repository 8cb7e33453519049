"""Line numbers of the keys of a TOML file, so that a message can name the line of a mistake."""

import re
from collections.abc import Iterator, Mapping
from typing import Final

_PART: Final = re.compile(
    r'"""(?:\\.|[^\\])*?"""|'
    r"'''.*?'''|"
    r'"(?:\\.|[^"\\\n])*"|'
    r"'[^'\n]*'|"
    r"#[^\n]*|"
    r"[\[\]{}=.\n]|"
    r"[^\s\[\]{}=.\"'#]+|"
    r"[^\S\n]+",
    re.DOTALL,
)
_OPENING: Final = "[{"
_CLOSING: Final = "]}"


def key_lines(text: str) -> dict[str, int]:
    """Lines, counted from 1, of the keys and table headers of a valid TOML file.

    A key is written as in messages: `scenario[1].train.load`, without quotation marks. Keys within
    inline tables and lists are left out; the key that holds them has the line.
    """
    lines: dict[str, int] = {}
    counts: dict[str, int] = {}
    table = ""
    for number, parts in _statements(text):
        if parts[0] == "[":
            is_entry = parts[1] == "["
            table = _indexed([_plain(each) for each in parts if each not in "[]."], counts)
            if is_entry:
                index = counts.get(table, -1) + 1
                counts[table] = index
                table = f"{table}[{index}]"
            lines.setdefault(table, number)
        else:
            names = [_plain(each) for each in parts[: parts.index("=")] if each != "."]
            lines.setdefault(".".join([table, *names] if table else names), number)
    return lines


def line_of(lines: Mapping[str, int], message: str) -> int | None:
    """Line of the key with which a message begins, or of the nearest table that holds the key."""
    plain = message.replace('"', "")
    found = [key for key in lines if re.match(rf"{re.escape(key)}(?!\w)", plain)]
    return lines[max(found, key=len)] if found else None


def _statements(text: str) -> Iterator[tuple[int, list[str]]]:
    """Each key with its value, and each header: the line it begins on, and its parts."""
    line, depth = 1, 0
    begun, parts = 1, list[str]()
    for part in _PART.findall(text + "\n"):
        if part == "\n" and depth == 0:
            if parts:
                yield begun, parts
            parts = []
        elif not part.isspace() and not part.startswith("#"):
            begun = begun if parts else line
            parts.append(part)
            depth += (part in _OPENING) - (part in _CLOSING)
        line += part.count("\n")


def _indexed(names: list[str], counts: Mapping[str, int]) -> str:
    """The path of a header, in which each list of tables above has the index of its last entry."""
    path = ""
    for position, name in enumerate(names):
        path = f"{path}.{name}" if path else name
        if path in counts and position < len(names) - 1:
            path = f"{path}[{counts[path]}]"
    return path


def _plain(part: str) -> str:
    return part[1:-1] if part[0] in "\"'" else part
