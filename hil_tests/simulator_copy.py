"""`python -m hil_tests.simulator_copy`: the compiled simulator gives the results of the sources.

`make compiled` runs this. It is no test of the suite, because the copy takes a minute to build.
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from metro_hil.model.native_copy import SWITCH, Native, Part, ready_copy, worker_environment

SEEDS = "7..9"
MINUTES = "0.2"


def digests(library: Path | None) -> list[tuple[int, str]]:
    """Seed and digest of each simulated line; None for the library runs the sources."""
    with tempfile.TemporaryDirectory() as place:
        journal = Path(place) / "seeds.jsonl"
        words = ["simulate", "--seeds", SEEDS, "--minutes", MINUTES, "--journal", str(journal)]
        subprocess.run(
            [sys.executable, "-m", "metro_hil.cli.hil", *words],
            env=worker_environment({**os.environ, SWITCH: Native.WIRE.value}, library),
            stdout=subprocess.DEVNULL,
            check=True,
        )
        lines = [json.loads(line) for line in journal.read_text(encoding="utf-8").splitlines()]
    return sorted((each["seed"], each["digest"]) for each in lines)


def main() -> int:
    """Compare both; a difference, or a missing copy, is an error."""
    library = ready_copy(Part.SIMULATOR)
    if library is None:
        print("simulator: there is no compiled copy of these sources", file=sys.stderr)
        return 3
    compiled, plain = digests(library), digests(None)
    if not plain or compiled != plain:
        print(f"simulator: compiled {compiled}, sources {plain}", file=sys.stderr)
        return 1
    print(f"simulator: {len(plain)} seeds, same digests compiled and not")
    return 0


if __name__ == "__main__":
    sys.exit(main())
