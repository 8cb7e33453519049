"""`make mutate`: tries all mutants of the safety half and says who survived."""

import argparse
import dataclasses
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

from metro_tools.mutate.mutations import Mutant, mutants_of
from metro_tools.mutate.result import Tried, as_difference, scores, stale, survivors, table
from metro_tools.mutate.targets import (
    Equivalent,
    Group,
    TargetError,
    chosen,
    read_equivalents,
    read_groups,
)
from metro_tools.mutate.trial import Task, try_group

EXIT_OK: Final = 0
EXIT_SURVIVORS: Final = 1
EXIT_USAGE: Final = 2
DOT_EVERY: Final = 50


class TrialError(Exception):
    """The tests of a group do not even pass without a mutant."""


def main(argv: Sequence[str] | None = None) -> int:
    """0 when every mutant is noticed or equivalent, 1 with survivors or stale entries, else 2."""
    parser = argparse.ArgumentParser(prog="mutate", description=__doc__)
    parser.add_argument("modules", nargs="*", help="paths; default: all in mutation_targets.toml")
    parser.add_argument("--only", action="append", default=[], metavar="KEY", help="one mutant")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="default: processors")
    parser.add_argument("--root", type=Path, default=Path.cwd(), help="the checkout")
    parser.add_argument("--json", type=Path, help="write all results there, too")
    parser.add_argument("--worker", help=argparse.SUPPRESS)
    options = parser.parse_args(argv)
    root: Path = options.root.resolve()
    if options.worker is not None:
        return _work(options.worker)
    try:
        groups = chosen(read_groups(root), options.modules)
        equivalents = read_equivalents(root)
        tried = [
            item
            for group in groups
            for item in _tried(root, group, tuple(options.only), options.jobs)
        ]
    except (TargetError, TrialError) as error:
        print(f"mutate: {error}", file=sys.stderr)
        return EXIT_USAGE
    if options.json is not None:
        options.json.write_text(json.dumps([dataclasses.asdict(item) for item in tried], indent=1))
    return _told(tried, equivalents, whole=not options.only)


def _told(tried: Sequence[Tried], equivalents: Sequence[Equivalent], *, whole: bool) -> int:
    if not tried:
        print("mutate: nothing to try", file=sys.stderr)
        return EXIT_USAGE
    left = survivors(tried, equivalents)
    old = list(stale(tried, equivalents)) if whole else []
    for item in left:
        print(as_difference(item), end="\n\n")
    print(table(scores(tried, equivalents)))
    if not whole:
        for item in tried:
            print(f"{item.mutant.key}: {item.result} {item.by}")
    for words in old:
        print(words, file=sys.stderr)
    return EXIT_SURVIVORS if left or old else EXIT_OK


def _tried(root: Path, group: Group, keys: tuple[str, ...], jobs: int) -> Iterator[Tried]:
    """All mutants of a group, tried in a process of their own. Raises TrialError."""
    mutants = {
        module: mutants_of((root / module).read_text(encoding="utf-8")) for module in group.modules
    }
    count = sum(len(each) for each in mutants.values())
    print(f"{group.name}: {count} mutants, {len(group.tests)} files of tests ", end="", flush=True)
    task = Task(str(root), group.modules, group.tests, keys, jobs)
    for number, told in enumerate(_results(root, task)):
        if "error" in told:
            raise TrialError(f"{group.name}: {told['error']}")
        if number % DOT_EVERY == 0:
            print(".", end="", flush=True)
        yield _read(told, mutants)
    print()


def _read(told: dict[str, str | int], mutants: dict[str, list[Mutant]]) -> Tried:
    module, number = str(told["module"]), int(told["number"])
    return Tried(module, mutants[module][number], str(told["result"]), str(told["by"]))


def _results(root: Path, task: Task) -> Iterator[dict[str, str | int]]:
    """What the process that tries them tells, as soon as it does."""
    read_fd, write_fd = os.pipe()
    with tempfile.TemporaryFile() as output:
        argv = [sys.executable, "-m", "metro_tools.mutate", "--worker"]
        argv.append(json.dumps({**dataclasses.asdict(task), "fd": write_fd}))
        worker = subprocess.Popen(  # noqa: S603
            argv, cwd=root, stdout=output, stderr=subprocess.STDOUT, pass_fds=(write_fd,)
        )
        os.close(write_fd)
        ended = 0
        with os.fdopen(read_fd, encoding="utf-8") as lines:
            for line in lines:
                ended += 1
                yield json.loads(line)
        if worker.wait() != 0 and ended == 0:
            output.seek(0)
            raise TrialError(output.read().decode(errors="replace"))


def _work(told: str) -> int:
    """The process in which tests are collected once and forked for each mutant."""
    entries = json.loads(told)
    task = Task(
        root=entries["root"],
        modules=tuple(entries["modules"]),
        tests=tuple(entries["tests"]),
        keys=tuple(entries["keys"]),
        jobs=entries["jobs"],
    )
    os.set_inheritable(entries["fd"], False)
    with os.fdopen(entries["fd"], "w", encoding="utf-8") as report:
        return try_group(task, report)


if __name__ == "__main__":
    sys.exit(main())
