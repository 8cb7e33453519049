"""Finds words of a private dialect in documents, comments, docstrings and messages.

`python -m metro_tools.prose` prints each finding with file, line, word and what to write instead.
Files that still hold such words stand in an allow-list that only shrinks: a listed file without a
finding is an error, too.
"""

import argparse
import io
import re
import shutil
import subprocess
import sys
import tokenize
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

ALLOWED: Final = "tools/metro_tools/prose_allowed.txt"
"""Files, one a line, that were written before the rules and still break them."""
RULES: Final = (
    (r"nobody", "name who does not: 'no train', 'the master never'"),
    (r"somebody", "name who does: 'a person', 'another train'"),
    (r"who(?:so)?ever", "name the agent"),
    (r"anew", "write 'again', or say what restarted"),
    (r"(?<!dead )reckon(?:s|ed|ing)?", "write 'compute' or 'assume'"),
    (r"in words", "write 'as text', or describe"),
    (r"(?:is|are|was|were) told", "write 'receives', 'is reported' or 'is given'"),
    (r"hears?", "write 'receives'"),
    (r"newborns?|reborn", "write 'restarted'"),
)
"""Word and what to write instead."""
AT_START: Final = (
    (r"so (?:much|long|far)\b", "say what the quantity is, as a noun phrase"),
    (r"of (?:the|what|which)\b[^.]*\bthat\b", "write a whole sentence"),
)
"""The same for the first words of a docstring."""
WORDS: Final = tuple((re.compile(rf"\b{word}\b", re.IGNORECASE), hint) for word, hint in RULES)
STARTS: Final = tuple((re.compile(word, re.IGNORECASE), hint) for word, hint in AT_START)
NOT_PROSE: Final = frozenset({"LICENSE", "tools/metro_tools/prose.py"})
FENCE: Final = re.compile(r"^\s*```")
PROSE_WORDS_MIN: Final = 3
"""Least number of words that make a string of the code a text for people."""


class ProseFinding(NamedTuple):
    """One word of the dialect in one file."""

    path: str
    line: int
    word: str
    hint: str

    def __str__(self) -> str:
        return f"{self.path}:{self.line}: '{self.word}': {self.hint}"


def main(argv: Sequence[str] | None = None) -> int:
    """Print the findings outside the allow-list; exit code 1 for any, or for a stale entry."""
    parser = argparse.ArgumentParser(prog="python -m metro_tools.prose", description=__doc__)
    parser.add_argument("paths", nargs="*", help="files to look at, listed or not; default: all")
    options = parser.parse_args(argv)
    root = Path()
    allowed = frozenset() if options.paths else allowed_files(root)
    found = {path: findings(root, path) for path in options.paths or tracked(root)}
    problems = [
        str(each) for path, all_of in found.items() if path not in allowed for each in all_of
    ]
    problems += [
        f"{ALLOWED}: {path} has no finding any more; remove its line"
        for path in sorted(allowed)
        if not found.get(path)
    ]
    print("\n".join(problems) or "prose: no finding outside the allow-list")
    return 1 if problems else 0


def tracked(root: Path) -> list[str]:
    """Documents and sources that git keeps, relative to `root`."""
    git = shutil.which("git") or "git"
    listing = subprocess.run(  # noqa: S603
        [git, "ls-files", "-z", "*.md", "*.py"],
        cwd=root,
        capture_output=True,
        text=True,
        check=True,
    )
    return [name for name in listing.stdout.split("\0") if name and (root / name).is_file()]


def allowed_files(root: Path) -> frozenset[str]:
    """The files of the allow-list; a line that begins with # is a comment."""
    lines = (root / ALLOWED).read_text(encoding="utf-8").splitlines()
    return frozenset(line for line in lines if line and not line.startswith("#"))


def findings(root: Path, path: str) -> list[ProseFinding]:
    """Everything that one file says in the dialect, in the order of its lines."""
    if path in NOT_PROSE:
        return []
    text = (root / path).read_text(encoding="utf-8")
    passages = _of_python(text) if path.endswith(".py") else _of_markdown(text)
    return [
        ProseFinding(path, line, word, hint)
        for first, passage in passages
        for line, word, hint in _in_passage(first, passage)
    ]


def _in_passage(first: int, passage: str) -> Iterator[tuple[int, str, str]]:
    for pattern, hint in STARTS:
        match = pattern.match(passage.lstrip('rfb"').lstrip())
        if match and passage.startswith(('"""', 'r"""')):
            yield first, match.group(), hint
    for pattern, hint in WORDS:
        for match in pattern.finditer(passage):
            yield first + passage.count("\n", 0, match.start()), match.group(), hint


def _of_python(text: str) -> Iterator[tuple[int, str]]:
    """Comments, and strings of at least a few words, with the line that each begins in."""
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        is_text = token.type == tokenize.STRING or token.type == FSTRING_PART
        if token.type == tokenize.COMMENT or (
            is_text and len(token.string.split()) >= PROSE_WORDS_MIN
        ):
            yield token.start[0], token.string


FSTRING_PART: Final = getattr(tokenize, "FSTRING_MIDDLE", -1)
"""From Python 3.12 on the tokenizer splits formatted strings into parts."""


def _of_markdown(text: str) -> Iterator[tuple[int, str]]:
    """Lines outside of fenced blocks."""
    fenced = False
    for number, line in enumerate(text.splitlines(), start=1):
        if FENCE.match(line):
            fenced = not fenced
        elif not fenced:
            yield number, line


if __name__ == "__main__":
    sys.exit(main())
