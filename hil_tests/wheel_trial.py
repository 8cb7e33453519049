"""`python -m hil_tests.wheel_trial`: a compiled wheel runs alone, as fast and with the same frames.

`make wheels` runs this on the wheel for this machine. The trial installs the wheel in a fresh
environment without any compiler. It is no test of the suite, because wheels take minutes to build.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from metro_hil.model.native_copy import SWITCH, Native

RUN = ["vobc", "run", "--lockstep", "--line", "florence", "--from", "II", "--to", "III"]


def frame_hash(programs: Path, environment: dict[str, str], folder: Path) -> str:
    """Hash of all frames of a run by these programs."""
    words = [programs / RUN[0], *RUN[1:], "--json", "--out", folder]
    subprocess.run(words, env=environment, capture_output=True, check=True)
    return str(json.loads((folder / "results.json").read_bytes())["frame_log_sha256"])


def main() -> int:
    """Compare a run of the wheel with one of the sources; a difference is an error."""
    parser = argparse.ArgumentParser(prog="python -m hil_tests.wheel_trial", description=__doc__)
    parser.add_argument("wheel", type=Path)
    parser.add_argument("--constraints", type=Path, default=Path("constraints.txt"))
    options = parser.parse_args()
    ours = Path(sys.executable).parent
    with tempfile.TemporaryDirectory() as scratch:
        place = Path(scratch)
        subprocess.run([sys.executable, "-m", "venv", place / "venv"], check=True)
        programs = place / "venv" / "bin"
        pip = [programs / "python", "-m", "pip", "install", "--quiet", "-c", options.constraints]
        subprocess.run([*pip, options.wheel], check=True)
        bare = {"PATH": str(place), "HOME": str(place), "XDG_CACHE_HOME": str(place / "none")}
        version = subprocess.run(
            [programs / "vobc", "--version", "-v"], env=bare, capture_output=True, text=True
        ).stdout
        print(version, end="")
        if "bus and logs: C\n" not in version or "controller: compiled\n" not in version:
            print("wheel: does not run compiled code", file=sys.stderr)
            return 1
        sources = {**os.environ, SWITCH: Native.OFF.value}
        of_wheel = frame_hash(programs, bare, place / "wheel")
        of_sources = frame_hash(ours, sources, place / "sources")
    if of_wheel != of_sources:
        print(f"wheel: frame hash {of_wheel}, sources {of_sources}", file=sys.stderr)
        return 1
    print("wheel: compiled, and the same frames as the sources")
    return 0


if __name__ == "__main__":
    sys.exit(main())
