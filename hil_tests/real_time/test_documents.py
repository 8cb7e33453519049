"""The commands of README.md and docs, in the order in which a reader meets them, in a fresh
clone."""

import subprocess
import sys
from pathlib import Path


def test_every_documented_command_works_as_documented(checkout: Path) -> None:
    """The report of a failed block names file, line, command and the end of its output."""
    done = subprocess.run(
        [sys.executable, "-m", "metro_tools.doc_blocks", "--root", str(checkout)],
        capture_output=True,
        text=True,
        check=False,
    )

    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
    assert "0 failed" in done.stdout
