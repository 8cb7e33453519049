"""`python -m metro_tools.doc_blocks`: runs the documents, or lists how each block is treated."""

import argparse
import sys
import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Final

from firmware_py.assertions import require_assertions
from firmware_py.clock.clock import WallClock
from metro_hil.model.native_copy import usable_copy
from metro_tools.doc_blocks.blocks import Block, read_blocks
from metro_tools.doc_blocks.clone import VENV, CloneError, make_clone
from metro_tools.doc_blocks.order import README, documents
from metro_tools.doc_blocks.session import environment_of, run_document
from metro_tools.warm.programs import warm_programs

EXIT_OK: Final = 0
EXIT_FAILED: Final = 1
EXIT_USAGE: Final = 2
EXIT_ENVIRONMENT: Final = 3
AGAIN: Final = "correct the command or the document, then run `make examples DOCUMENTS={}`"
NS_PER_S: Final = 1e9


def main(argv: Sequence[str] | None = None) -> int:
    """Return exit code 1 when a block does not do what its document says."""
    require_assertions("doc_blocks")
    options = _parser().parse_args(argv)
    root = Path(options.root).resolve()
    known = documents(root)
    wanted = [Path(name).as_posix() for name in options.document]
    unknown = [name for name in wanted if name not in known]
    if unknown:
        words = (
            f"{unknown[0]}: not a document of this project; choose README.md or one of docs/**/*.md"
        )
        print(f"doc_blocks: {words}", file=sys.stderr)
        return EXIT_USAGE
    # A reader starts with the README, and later documents use files that its commands created.
    chosen = [name for name in known if not wanted or name in (README, *wanted)]
    try:
        return _list(root, chosen) if options.list else _run(root, chosen)
    except CloneError as error:
        print(f"doc_blocks: {error}", file=sys.stderr)
        return EXIT_ENVIRONMENT


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m metro_tools.doc_blocks", description=__doc__)
    parser.add_argument(
        "document", nargs="*", help="README.md always goes first; default: all documents"
    )
    parser.add_argument("--list", action="store_true", help="run nothing, list every block")
    parser.add_argument("--root", default=".", help="the project's folder; default: here")
    return parser


def _read(root: Path, name: str) -> tuple[str, list[Block], list[str]]:
    text = (root / name).read_text(encoding="utf-8")
    blocks, faults = read_blocks(text)
    return text, blocks, [f"{name}:{fault.line}: {fault.text}" for fault in faults]


def _list(root: Path, names: Sequence[str]) -> int:
    wrong: list[str] = []
    for name in names:
        _, blocks, faults = _read(root, name)
        wrong += faults
        for block in blocks:
            print(f"{name}:{block.line}: {block.language or '-'}: {_fate(block)}")
    print("".join(f"{line}\n" for line in wrong), end="", file=sys.stderr)
    return EXIT_FAILED if wrong else EXIT_OK


def _fate(block: Block) -> str:
    mark = block.mark
    if mark.run:
        return f"run, must print {', '.join(mark.prints)}"
    if mark.file:
        return f"saved as {mark.file}"
    return f"skipped: {mark.skip}" if mark.skip else "shown"


def _run(root: Path, names: Sequence[str]) -> int:
    clock = WallClock()
    ran = 0
    failures: list[str] = []
    with tempfile.TemporaryDirectory(prefix="docs-") as scratch:
        # The embedded bus puts sockets here, and their paths are limited to about 100 bytes.
        runtime = Path(scratch) / "r"
        runtime.mkdir(mode=0o700)
        clone = Path(scratch) / "clone"
        make_clone(root, clone)
        environment = environment_of(clone, runtime)
        with ExitStack() as warm:
            for name in names:
                text, blocks, faults = _read(root, name)
                failures += faults
                began_ns = clock.now_ns()
                outcome = run_document(name, text, blocks, clone, environment)
                ran += outcome.ran
                if outcome.failure is not None:
                    failures.append(str(outcome.failure))
                if outcome.ran:
                    took_s = (clock.now_ns() - began_ns) / NS_PER_S
                    print(f"{name}: {outcome.ran} blocks, {took_s:.1f} s", flush=True)
                if name == README:
                    # The README starts each program as a reader does; the other documents fork.
                    warm.enter_context(
                        warm_programs(clone / VENV, environment, usable_copy(), runtime)
                    )
    for failure in failures:
        document = failure.partition(":")[0]
        print(f"{failure}\n    {AGAIN.format(document)}", file=sys.stderr)
    print(f"{ran} blocks did what their documents say, {len(failures)} failed")
    return EXIT_FAILED if failures else EXIT_OK


if __name__ == "__main__":
    sys.exit(main())
