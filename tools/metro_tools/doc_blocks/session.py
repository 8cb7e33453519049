"""Runs one document in one bash, block by block, as a reader would type it.

The script for bash has each line at its number in the document. A failing command is therefore
reported with the line number of the document.
"""

import os
import selectors
import shlex
import signal
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from metro_tools.doc_blocks.blocks import Block

BLOCK_SECONDS: Final = 300.0
"""Time limit of one block, s. Blocks take seconds; only a hanging block takes longer."""
SHOWN_LINES: Final = 12
ENVIRONMENT: Final = {"TERM": "dumb", "PAGER": "cat", "COLUMNS": "120", "NO_COLOR": "1"}
DROPPED: Final = ("PYTHONPATH", "PYTHONSAFEPATH", "PYTHONDONTWRITEBYTECODE", "MAKEFLAGS", "CI")
TRACEBACK: Final = "Traceback (most recent call last)"
PROLOGUE: Final = r"""
set -E
_block_starts() {
    exec >"$DOC_BLOCKS_OUT/$1.txt" 2>&1 </dev/null
    echo "starts $1" >&"$DOC_BLOCKS_FD"
    [ "$2" != strict ] || trap '_command_failed $? $LINENO' ERR
}
_command_failed() {
    trap - ERR
    echo "failed $2 $1" >&"$DOC_BLOCKS_FD"
    exit 1
}
_block_ends() {
    local status=$?
    trap - ERR
    echo "ends $1 $status" >&"$DOC_BLOCKS_FD"
}
"""


@dataclass(frozen=True, slots=True)
class BlockFailure:
    """A block that did not do what the document says."""

    document: str
    line: int
    text: str
    output: str = ""
    """Last part of the block's output."""

    def __str__(self) -> str:
        shown = "".join(f"\n    | {line}" for line in self.output.splitlines()[-SHOWN_LINES:])
        return f"{self.document}:{self.line}: {self.text}{shown}"


@dataclass(frozen=True, slots=True)
class DocumentOutcome:
    """Result of one document."""

    ran: int
    """Number of blocks executed to their end."""
    failure: BlockFailure | None
    """The first failure; the blocks after it were not executed, because they may depend on it."""


def run_document(
    name: str,
    text: str,
    blocks: Sequence[Block],
    clone: Path,
    environment: Mapping[str, str],
    *,
    block_seconds: float = BLOCK_SECONDS,
) -> DocumentOutcome:
    """Execute the marked blocks of one document in the clone.

    Args:
        environment: variables of the shell.
    """
    marked = [block for block in blocks if block.mark.run or block.mark.file]
    if not marked:
        return DocumentOutcome(0, None)
    with tempfile.TemporaryDirectory(prefix="doc-blocks-") as scratch:
        place = Path(scratch)
        (place / "prologue").write_text(PROLOGUE, encoding="utf-8")
        script = _script(len(text.splitlines()), marked, place)
        (place / "script").write_text(script, encoding="utf-8")
        follow = _Follow(name, blocks, place)
        return follow.outcome(clone, environment, block_seconds)


def _script(length: int, blocks: Sequence[Block], place: Path) -> str:
    """Return the bash script, with each line of a block at its number in the document."""
    lines = [""] * (length + 1)
    for block in blocks:
        before, after = block.line - 1, block.end - 1
        if block.mark.file:
            saved = place / f"{block.line}.saved"
            saved.write_text("".join(f"{line}\n" for line in block.text), encoding="utf-8")
            target = shlex.quote(block.mark.file)
            lines[before] = (
                f"mkdir -p -- $(dirname -- {target}) && cp -- {shlex.quote(str(saved))} {target}"
            )
            continue
        manner = "lenient" if block.mark.exits else "strict"
        lines[before] = f"_block_starts {block.line} {manner}"
        lines[after] = f"_block_ends {block.line}"
        if block.is_python:
            # Leading empty lines give tracebacks the line numbers of the document.
            program = place / f"{block.line}.py"
            program.write_text("\n".join([*[""] * block.line, *block.text, ""]), encoding="utf-8")
            lines[block.line] = f"python {shlex.quote(str(program))}"
        else:
            lines[block.line : after] = block.commands
    return "\n".join(lines) + "\n"


def environment_of(clone: Path, runtime: Path) -> Mapping[str, str]:
    """Return the variables of a shell in the clone.

    Args:
        runtime: folder for the sockets of embedded buses in this session; its path must be short.
    """
    kept = {name: value for name, value in os.environ.items() if name not in DROPPED}
    path = f"{clone / '.venv' / 'bin'}{os.pathsep}{kept.get('PATH', os.defpath)}"
    return kept | ENVIRONMENT | {"PATH": path, "XDG_RUNTIME_DIR": str(runtime)}


class _Follow:
    """Reads the reports of bash about each block, and checks each block when it ends."""

    def __init__(self, name: str, blocks: Sequence[Block], place: Path) -> None:
        self._name = name
        self._blocks = {block.line: block for block in blocks}
        self._place = place
        self._current: Block | None = None
        self._failure: BlockFailure | None = None
        self._ran = 0

    def outcome(
        self, clone: Path, environment: Mapping[str, str], seconds: float
    ) -> DocumentOutcome:
        reading, writing = os.pipe()
        told = {"DOC_BLOCKS_OUT": str(self._place), "DOC_BLOCKS_FD": str(writing)}
        both = ". " + shlex.quote(str(self._place / "prologue"))
        both += "; . " + shlex.quote(str(self._place / "script"))
        with (self._place / "between.txt").open("wb") as between:
            bash = subprocess.Popen(  # noqa: S603
                ["bash", "-c", both],  # noqa: S607
                cwd=clone,
                env={**environment, **told},
                stdin=subprocess.DEVNULL,
                stdout=between,
                stderr=subprocess.STDOUT,
                pass_fds=(writing,),
                start_new_session=True,
            )
        os.close(writing)
        try:
            self._follow(bash, reading, seconds)
        finally:
            # End programs that a block left in the background.
            with suppress(ProcessLookupError):
                os.killpg(bash.pid, signal.SIGKILL)
            bash.wait()
            os.close(reading)
        return DocumentOutcome(self._ran, self._failure)

    def _follow(self, bash: "subprocess.Popen[bytes]", reading: int, seconds: float) -> None:
        os.set_blocking(reading, False)
        pidfd = os.pidfd_open(bash.pid)
        with selectors.DefaultSelector() as selector:
            selector.register(reading, selectors.EVENT_READ)
            selector.register(pidfd, selectors.EVENT_READ)
            rest = ""
            while self._failure is None:
                ready = {key.fd for key, _ in selector.select(seconds)}
                if not ready:
                    self._fail(f"not done after {seconds:g} s; shorten it or mark it with skip")
                rest = self._take(rest + _text(reading))
                if pidfd in ready:
                    self._take(rest + _text(reading))
                    break
        os.close(pidfd)
        if self._failure is None and (self._current is not None or bash.wait() != 0):
            self._fail("bash ended here; correct the command, or remove `exit` from the block")

    def _take(self, text: str) -> str:
        """Process all complete lines of the reports; return the rest."""
        *lines, rest = text.split("\n")
        for line in lines:
            verb, *numbers = line.split()
            first, status = (*map(int, numbers), 0)[:2]
            if verb == "starts":
                self._current = self._blocks[first]
            elif verb == "failed" and self._current is not None:
                command = self._current.text[max(0, first - self._current.line - 1)].strip()
                self._fail(f"exit status {status} of: {command}", line=first)
            elif verb == "ends" and self._failure is None:
                self._judge(self._blocks[first], status)
                self._current = None
        return rest

    def _judge(self, block: Block, status: int) -> None:
        output = self._output(block)
        mark = block.mark
        missing = [text for text in mark.prints if text not in output]
        if status != mark.exits:
            self._fail(f"exit status {status}; the mark above this block expects {mark.exits}")
        elif TRACEBACK in output:
            self._fail("a program of this block ended with a traceback")
        elif missing:
            texts = ", ".join(f'"{text}"' for text in missing)
            self._fail(f"the output lacks {texts}; correct the block, or the mark above it")
        else:
            self._ran += 1

    def _fail(self, text: str, line: int | None = None) -> None:
        block = self._current
        where = block.line if block is not None else 1
        output = self._output(block) if block is not None else ""
        self._failure = BlockFailure(self._name, where if line is None else line, text, output)

    def _output(self, block: Block) -> str:
        path = self._place / f"{block.line}.txt"
        return path.read_text(encoding="utf-8", errors="replace") if path.exists() else ""


def _text(reading: int) -> str:
    try:
        return os.read(reading, 1 << 16).decode()
    except BlockingIOError:
        return ""
