"""Every block of commands in the documents is run, or has a reason why not."""

from pathlib import Path
from typing import Final

from metro_tools.doc_blocks.blocks import read_blocks
from metro_tools.doc_blocks.order import documents

ROOT: Final = Path(__file__).resolve().parents[2]


def test_every_block_of_commands_is_run_or_has_a_reason() -> None:
    faults = [
        f"{name}:{fault.line}: {fault.text}"
        for name in documents(ROOT)
        for fault in read_blocks((ROOT / name).read_text(encoding="utf-8"))[1]
    ]

    assert faults == []


def test_most_documents_with_commands_have_one_that_is_run() -> None:
    """No test checks a skipped block, so skipped ones must stay the minority."""
    marks = [
        block.mark
        for name in documents(ROOT)
        for block in read_blocks((ROOT / name).read_text(encoding="utf-8"))[0]
    ]

    assert sum(mark.run for mark in marks) >= 20
    assert sum(mark.run for mark in marks) >= sum(bool(mark.skip) for mark in marks) * 0.8
