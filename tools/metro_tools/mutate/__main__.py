"""`make mutate`: tries all mutants of the safety code and reports the survivors."""

import argparse
import dataclasses
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from metro_tools.mutate.memory import Memory, Tests, recall
from metro_tools.mutate.mutations import Mutant, mutants_of
from metro_tools.mutate.result import (
    NOT_NOTICED,
    PAGE_FILE,
    Tried,
    as_difference,
    as_page,
    is_equivalent,
    scores,
    stale,
    survivors,
    table,
)
from metro_tools.mutate.targets import (
    Equivalent,
    TargetError,
    TargetGroup,
    chosen,
    read_equivalents,
    read_groups,
)
from metro_tools.mutate.task import MutantTask
from metro_tools.mutate.trial import try_group

EXIT_OK: Final = 0
EXIT_SURVIVORS: Final = 1
EXIT_USAGE: Final = 2
SAVE_EVERY: Final = 25
TOLD_EVERY: Final = 25


class TrialError(Exception):
    """The tests of a group fail even without a mutant."""


def main(argv: Sequence[str] | None = None) -> int:
    """Return 0 when every mutant is detected or equivalent, 1 with survivors or stale entries,
    otherwise 2.
    """
    options = _parser().parse_args(argv)
    root: Path = options.root.resolve()
    if options.worker is not None:
        return _work(options.worker)
    if options.write and (options.modules or options.only):
        print("mutate: --write needs a run of all modules", file=sys.stderr)
        return EXIT_USAGE
    tried: list[Tried] = []
    unfit: list[str] = []
    try:
        equivalents = read_equivalents(root)
        for group in chosen(read_groups(root), options.modules):
            run = _Run(root, group, equivalents, options)
            try:
                tried += run.tried()
            except TrialError as error:
                unfit.append(str(error))
    except TargetError as error:
        print(f"mutate: {error}", file=sys.stderr)
        return EXIT_USAGE
    if options.json is not None:
        options.json.write_text(json.dumps([dataclasses.asdict(item) for item in tried], indent=1))
    status = _print_report(tried, equivalents, whole=not options.only) if tried else EXIT_USAGE
    for words in unfit or (() if tried else ("nothing to try",)):
        print(f"mutate: {words}", file=sys.stderr)
    if options.write and not unfit:
        (root / PAGE_FILE).write_text(as_page(scores(tried, equivalents)), encoding="utf-8")
    return EXIT_USAGE if unfit else status


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="mutate", description=__doc__)
    parser.add_argument("modules", nargs="*", help="paths; default: all of mutation_targets.toml")
    parser.add_argument(
        "--only", action="append", default=[], metavar="KEY", help="try only this mutant"
    )
    parser.add_argument(
        "--fresh",
        action="store_true",
        help="ignore earlier results; without it a mutant is tried again when its module changed,"
        " when the test that detected it changed, or when it survived and any test changed",
    )
    parser.add_argument(
        "--jobs",
        type=int,
        default=os.cpu_count() or 1,
        help="number of processes; default: number of processors",
    )
    parser.add_argument("--write", action="store_true", help=f"also write {PAGE_FILE}")
    parser.add_argument("--root", type=Path, default=Path.cwd(), help="the checkout")
    parser.add_argument("--json", type=Path, help="write all results to this file, too")
    parser.add_argument("--worker", help=argparse.SUPPRESS)
    return parser


def _print_report(tried: Sequence[Tried], equivalents: Sequence[Equivalent], *, whole: bool) -> int:
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


class _Run:
    """One group: its stored results, and the mutants to try."""

    def __init__(
        self,
        root: Path,
        group: TargetGroup,
        equivalents: Sequence[Equivalent],
        options: argparse.Namespace,
    ) -> None:
        self._root, self._group, self._equivalents = root, group, equivalents
        self._jobs: int = options.jobs
        self._keys: frozenset[str] = frozenset(options.only)
        tests = Tests(root, group)
        self._mutants: dict[str, list[Mutant]] = {}
        self._memories: dict[str, Memory] = {}
        for module in group.modules:
            self._mutants[module] = mutants_of((root / module).read_text(encoding="utf-8"))
            self._memories[module] = recall(root, module, tests, fresh=options.fresh)
        self._progress = _Progress(group.name)

    def tried(self) -> list[Tried]:
        """Return all requested mutants in the order of the source. Raises TrialError."""
        found = {} if self._keys else dict(self._remembered())
        wanted = {
            module: tuple(
                mutant.number
                for mutant in mutants
                if (module, mutant.number) not in found
                and (not self._keys or mutant.key in self._keys)
            )
            for module, mutants in self._mutants.items()
        }
        count = sum(len(numbers) for numbers in wanted.values())
        self._progress.begin(count, len(found), len(self._group.tests))
        if count:
            found |= {(item.module, item.mutant.number): item for item in self._now(wanted, count)}
        return [found[name] for name in sorted(found, key=self._order)]

    def _order(self, name: tuple[str, int]) -> tuple[int, int]:
        return self._group.modules.index(name[0]), name[1]

    def _remembered(self) -> Iterator[tuple[tuple[str, int], Tried]]:
        for module, memory in self._memories.items():
            mutants = self._mutants[module]
            for number, entry in memory.results.items():
                item = Tried(module, mutants[number], entry.result, entry.by)
                # A mutant with an argument why no test can detect it is not tried again each time.
                if memory.holds(entry) or (
                    entry.result in NOT_NOTICED and is_equivalent(item, self._equivalents)
                ):
                    yield (module, number), item

    def _now(self, wanted: dict[str, tuple[int, ...]], count: int) -> Iterator[Tried]:
        task = MutantTask(
            str(self._root), self._group.modules, self._group.tests, wanted, self._jobs
        )
        ended = 0
        try:
            for told in _results(self._root, task):
                if "error" in told:
                    raise TrialError(f"{self._group.name}: {told['error']}")
                module, number = str(told["module"]), int(told["number"])
                result, by = str(told["result"]), str(told["by"])
                self._memories[module].note(number, result, by)
                ended += 1
                self._progress.told(ended, survived=result in NOT_NOTICED)
                if ended % SAVE_EVERY == 0:
                    self._save(wanted)
                yield Tried(module, self._mutants[module][number], result, by)
        finally:
            self._save(wanted)
            self._progress.end()
        if ended != count:
            raise TrialError(f"{self._group.name}: only {ended} of {count} mutants were tried")

    def _save(self, wanted: Mapping[str, Sequence[int]]) -> None:
        for module, numbers in wanted.items():
            memory = self._memories[module]
            if not memory.is_of(self._root / module):
                raise TrialError(f"{self._group.name}: {module} changed while it was tried")
            if numbers and memory.results:
                memory.save()


class _Progress:
    """Progress output: one line that is overwritten on a terminal, or a line now and then in a
    file.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._terminal = sys.stderr.isatty()
        self._every = 1 if self._terminal else TOLD_EVERY
        self._count = self._survived = 0

    def begin(self, count: int, known: int, tests: int) -> None:
        self._count = count
        print(
            f"{self._name}: {count} mutants to try, {known} known; {tests} test files",
            file=sys.stderr,
            flush=True,
        )

    def told(self, ended: int, *, survived: bool) -> None:
        self._survived += survived
        if ended % self._every == 0 or ended == self._count:
            words = f"{self._name}: {ended} of {self._count}, {self._survived} not detected"
            print(words, file=sys.stderr, end="\r" if self._terminal else "\n", flush=True)

    def end(self) -> None:
        if self._terminal and self._count:
            print(file=sys.stderr)


def _results(root: Path, task: MutantTask) -> Iterator[dict[str, Any]]:
    """Yield the reports of the worker process as they arrive."""
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
    """Run the worker process, which collects the tests once and forks for each mutant."""
    entries = json.loads(told)
    task = MutantTask(
        root=entries["root"],
        modules=tuple(entries["modules"]),
        tests=tuple(entries["tests"]),
        numbers={module: tuple(numbers) for module, numbers in entries["numbers"].items()},
        jobs=entries["jobs"],
    )
    os.set_inheritable(entries["fd"], False)
    with os.fdopen(entries["fd"], "w", encoding="utf-8") as report:
        return try_group(task, report)


if __name__ == "__main__":
    sys.exit(main())
