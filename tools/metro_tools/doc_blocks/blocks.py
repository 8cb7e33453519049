"""Code blocks of a Markdown document, with the mark above each that says how it is treated.

A mark is an HTML comment directly above the fence, so readers of the page do not see it:

    <!-- run: prints "run folder", "exit reason" -->    executed; the output must contain the texts
    <!-- run: exits 1, prints "FAILED" -->              executed; the last command must exit with 1
    <!-- skip: needs a CAN interface -->                not executed, for this reason
    <!-- file: runaway.toml -->                         saved under this name for the blocks below

Every block of shell or Python has one of them; blocks of other languages may be files.
"""

import re
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Final

CONSOLE: Final = "console"
SHELL: Final = frozenset({"sh", "bash", "shell", CONSOLE})
PYTHON: Final = frozenset({"python", "py"})
PROGRAMS: Final = frozenset(
    {"vobc", "plant", "hil", "vcan", "canlog", "make", "python", "python3", "pip", "pytest"}
)
"""Programs that mark a block as shell commands, whatever the language of its fence is."""
FENCE: Final = re.compile(r"^( {0,3})(`{3,}|~{3,})\s*(.*?)\s*$")
MARK: Final = re.compile(r"^\s*<!--\s*(run|skip|file)\s*:\s*(.*?)\s*-->\s*$")
LIKE_MARK: Final = re.compile(r"^\s*<!--\s*(run|skip|file)\b")
INDENTED: Final = re.compile(r"^(?: {4,}|\t)(\S+)")
EXITS: Final = re.compile(r"^exits (\d{1,3})$")
PRINTS: Final = re.compile(r'^prints ("[^"]+"(?:\s*,\s*"[^"]+")*)$')
RUN_FORM: Final = 'write <!-- run: prints "text" --> or <!-- run: exits 1, prints "text" -->'


@dataclass(frozen=True, slots=True)
class BlockMark:
    """How one block is treated."""

    run: bool = False
    prints: tuple[str, ...] = ()
    """Texts that the output must contain."""
    exits: int = 0
    """Exit status of the last command."""
    skip: str = ""
    """Reason; empty for a block that is not skipped."""
    file: str = ""
    """Name under which the block is saved; empty for none."""


@dataclass(frozen=True, slots=True)
class Block:
    language: str
    line: int
    """Number of the line with the opening fence, from 1."""
    text: tuple[str, ...]
    """Lines between the fences."""
    mark: BlockMark

    @property
    def is_python(self) -> bool:
        return self.language in PYTHON

    @property
    def commands(self) -> list[str]:
        """Lines for bash. In a block of `console` the lines without a prompt are output."""
        if self.language != CONSOLE:
            return list(self.text)
        return [line[2:] if line.startswith("$ ") else "" for line in self.text]

    @property
    def end(self) -> int:
        """Number of the line with the closing fence."""
        return self.line + len(self.text) + 1


@dataclass(frozen=True, slots=True)
class DocumentFault:
    """An error in a document, found before any block is run."""

    line: int
    text: str


def read_blocks(text: str) -> tuple[list[Block], list[DocumentFault]]:
    """Return all fenced blocks of a document in order, and the errors in their marks."""
    blocks: list[Block] = []
    faults: list[DocumentFault] = []
    lines = text.splitlines()
    number = 0
    while number < len(lines):
        number += 1
        line = lines[number - 1]
        opening = FENCE.match(line)
        if opening is None:
            faults += _outside(lines, number)
            continue
        indent, fence, info = opening.groups()
        inside = list(_inside(lines[number:], fence, len(indent)))
        mark, wrong = _mark_above(lines, number)
        language = info.split()[0].lower() if info else ""
        block = Block(language, number, tuple(inside), mark)
        blocks.append(block)
        faults += wrong or _complaints(block, closed=block.end <= len(lines))
        number = block.end
    return blocks, faults


def _outside(lines: Sequence[str], number: int) -> Iterator[DocumentFault]:
    """Find commands outside of any fence, and marks that stand above no fence."""
    line = lines[number - 1]
    indented = INDENTED.match(line)
    before = lines[number - 2].strip() if number > 1 else ""
    if indented and indented[1] in PROGRAMS and not before:
        yield DocumentFault(number, "a command in an indented block; put it between ```sh and ```")
    if LIKE_MARK.match(line):
        below = next((each for each in lines[number:] if each.strip()), "")
        if not FENCE.match(below):
            yield DocumentFault(
                number, "this mark stands above no block; move it directly above a fence"
            )


def _inside(lines: Sequence[str], fence: str, indent: int) -> Iterator[str]:
    for line in lines:
        closing = FENCE.match(line)
        if closing and not closing[3] and closing[2].startswith(fence):
            return
        yield line[indent:] if not line[:indent].strip() else line


def _mark_above(lines: Sequence[str], number: int) -> tuple[BlockMark, list[DocumentFault]]:
    """Return the mark in the last non-empty line above a fence."""
    above = number - 1
    while above > 0 and not lines[above - 1].strip():
        above -= 1
    if above == 0 or not LIKE_MARK.match(lines[above - 1]):
        return BlockMark(), []
    found = MARK.match(lines[above - 1])
    if found is None:
        return BlockMark(), [
            DocumentFault(above, f"this mark is empty; {RUN_FORM}, or give the reason")
        ]
    kind, text = found.groups()
    if kind == "skip":
        wrong = (
            [] if text else [DocumentFault(above, "skip without a reason; write why it is not run")]
        )
        return BlockMark(skip=text), wrong
    if kind == "file":
        name = PurePosixPath(text)
        good = text and not name.is_absolute() and ".." not in name.parts
        return BlockMark(file=text), [] if good else [
            DocumentFault(above, f"{text!r} is not the name of a file")
        ]
    return _run_mark(text, above)


def _run_mark(text: str, line: int) -> tuple[BlockMark, list[DocumentFault]]:
    head, comma, tail = text.partition(", prints ")
    exits = EXITS.match(head)
    if exits and comma:
        prints = PRINTS.match(f"prints {tail}")
    else:
        exits, prints = None, PRINTS.match(text)
    if prints is None:
        return BlockMark(run=True), [DocumentFault(line, f"{text!r} expects nothing; {RUN_FORM}")]
    texts = tuple(re.findall(r'"([^"]+)"', prints[1]))
    return BlockMark(run=True, prints=texts, exits=int(exits[1]) if exits else 0), []


def _complaints(block: Block, *, closed: bool) -> Iterator[DocumentFault]:
    if not closed:
        yield DocumentFault(block.line, "this block is never closed")
    shell = block.language in SHELL
    if not block.language and block.text and _program(block.text[0]) in PROGRAMS:
        yield DocumentFault(block.line, "a block of commands without a language; write ```sh")
    mark = block.mark
    if mark.run and not (shell or block.is_python):
        yield DocumentFault(
            block.line, f"a block of {block.language or 'no language'} cannot be run"
        )
    if (shell or block.is_python) and not (mark.run or mark.skip or mark.file):
        yield DocumentFault(
            block.line,
            f"this block of {block.language} says neither what it prints nor why it is not run; "
            f"{RUN_FORM}, or <!-- skip: reason --> above it",
        )


def _program(line: str) -> str:
    try:
        words = shlex.split(line.removeprefix("$ "), comments=True)
    except ValueError:
        return ""
    return words[0] if words else ""
