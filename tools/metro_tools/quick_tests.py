"""Runs the tests that a change can affect, the closest first, for about a minute.

`python -m metro_tools.quick_tests` compares the files with the last commit that the branch shares
with its remote branch. The fewer imports lie between a test file and a changed module, the closer
it is. Tests in the mirrored folder, and tests of rules for the whole tree, come first. The program
names test files that do not fit into the minute.
"""

import argparse
import re
import shutil
import subprocess
import sys
import tomllib
import xml.etree.ElementTree as ElementTree
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Final, NamedTuple, Protocol

import grimp

TESTS: Final = "hil_tests"
SECONDS: Final = "hil_tests/test_seconds.toml"
"""Time that each test file takes."""
SECONDS_MIN: Final = 2
"""Shorter files are not listed, and count as 1 s."""
BUDGET_S: Final = 110.0
"""Sum of the times of the chosen files. Four workers take a minute for it, start included."""
ROOTS: Final[Mapping[str, str]] = {
    "can_dbc": "can_dbc",
    "canlog": "tools/canlog",
    "firmware_py": "firmware_py",
    "hil_tests": TESTS,
    "metro_hil": "hil_tests/metro_hil",
    "metro_tools": "tools/metro_tools",
    "plant_emulator": "plant_emulator",
    "vobc": "vobc",
    "zenoh_config": "zenoh_config",
}
"""Folder of each package."""
NAMED: Final = re.compile(rf"\b(?:{'|'.join(ROOTS)})\.[\w.]*")
"""Module that a program imports by its name in a text; with a dot at its end, any of a package."""
WHOLE_TREE: Final = (
    "hil_tests/contract/test_project_documents.py",
    "hil_tests/contract/test_project_files.py",
    "hil_tests/contract/test_project_layers.py",
    "hil_tests/contract/test_project_units.py",
    "hil_tests/contract/test_project_walls.py",
    "hil_tests/contract/test_sensitivity_lists.py",
)
"""Tests that read all files instead of importing them, so any change can affect them."""
FOR_ALL: Final = frozenset({"constraints.txt", "hil_tests/conftest.py", "pyproject.toml"})
"""Files that all tests depend on, though none imports them."""
FAR: Final = 1000
"""Distance of tests that depend on a change only by one of these files."""
DOCUMENTS: Final = "hil_tests/contract/test_*document*.py"
REMOTE: Final = ("@{upstream}", "origin/HEAD", "origin/main")
"""Names of the remote branch; the first that exists counts."""
FOLLOWED: Final = ("-n", "4")
EXIT_USAGE: Final = 2
NO_TESTS: Final = 5
"""Exit code of pytest when the options of the user select no test."""


class ImportLookup(Protocol):
    """The import graph, as far as it is needed."""

    @property
    def modules(self) -> set[str]: ...

    def add_import(self, *, importer: str, imported: str) -> None: ...

    def find_modules_that_directly_import(self, module: str) -> set[str]: ...


class QuickChoice(NamedTuple):
    """Test files that a change can affect."""

    chosen: list[str]
    left_out: list[str]
    """Files for which there is no time, the closest first."""


class GitAnswerError(Exception):
    """git cannot answer; the text is its message."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the chosen tests; options after `--` go to pytest."""
    parser = argparse.ArgumentParser(prog="python -m metro_tools.quick_tests", description=__doc__)
    parser.add_argument("--since", metavar="REV", help="compare with this commit")
    parser.add_argument("--list", action="store_true", help="name the test files and run none")
    parser.add_argument("--learn", metavar="XML", help=f"renew {SECONDS} from a JUnit file")
    parser.add_argument("pytest", nargs="*", help="options for pytest, after --")
    options = parser.parse_args(argv)
    root = Path()
    if options.learn:
        return _learn(root, Path(options.learn))
    try:
        since = options.since or shared_commit(root)
        changed = changed_files(root, since)
    except GitAnswerError as error:
        print(f"quick_tests: {error}", file=sys.stderr)
        return EXIT_USAGE
    if not changed:
        print(f"nothing changed since {since}: no test to run; `make test` runs all")
        return 0
    graph = grimp.build_graph(*ROOTS, cache_dir=None)
    add_named(graph, root)
    found = choose(changed, graph, test_files(root), seconds_of_files(root))
    _describe(changed, since, found)
    if options.list or not found.chosen:
        return 0
    words = [sys.executable, "-m", "pytest", *FOLLOWED, *options.pytest, *found.chosen]
    code = subprocess.run(words, check=False).returncode  # noqa: S603 - our own interpreter
    return 0 if code == NO_TESTS and options.pytest else code


def _describe(changed: Sequence[str], since: str, found: QuickChoice) -> None:
    few = ", ".join(changed[:3]) + (", ..." if len(changed) > 3 else "")
    print(f"{len(changed)} files changed since {since[:12]}: {few}")
    total = len(found.chosen) + len(found.left_out)
    print(f"{len(found.chosen)} of the {total} test files that this can affect:")
    print("".join(f"  {name}\n" for name in found.chosen), end="")
    if found.left_out:
        nearest = ", ".join(found.left_out[:3])
        print(f"{len(found.left_out)} are left to `make test`, such as {nearest}", flush=True)


def shared_commit(root: Path) -> str:
    """Return the last commit that HEAD shares with its remote branch; without one, HEAD."""
    for name in REMOTE:
        try:
            return _git(root, "merge-base", "HEAD", name).strip()
        except GitAnswerError:
            continue
    return "HEAD"


def changed_files(root: Path, since: str) -> list[str]:
    """Return changed, new and deleted files. Raises GitAnswerError."""
    changed = _git(root, "diff", "--name-only", "--no-renames", "-z", since, "--")
    new = _git(root, "ls-files", "--others", "--exclude-standard", "-z")
    return sorted({name for name in (changed + new).split("\0") if name})


def _git(root: Path, *words: str) -> str:
    git = shutil.which("git") or "git"
    try:
        done = subprocess.run(  # noqa: S603
            [git, *words], cwd=root, capture_output=True, text=True, check=False
        )
    except OSError as error:
        raise GitAnswerError(f"git: {error.strerror}; install it") from error
    if done.returncode != 0:
        raise GitAnswerError((done.stderr.strip().splitlines() or ["git failed"])[0])
    return done.stdout


def test_files(root: Path) -> list[str]:
    """All test files, relative to the checkout."""
    return sorted(path.relative_to(root).as_posix() for path in (root / TESTS).rglob("test_*.py"))


def seconds_of_files(root: Path) -> dict[str, float]:
    """Return the known time of each test file, s; nothing without the table."""
    try:
        table = tomllib.loads((root / SECONDS).read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    return {f"{TESTS}/{name}": float(seconds) for name, seconds in table.items()}


def choose(
    changed: Iterable[str],
    graph: ImportLookup,
    tests: Collection[str],
    seconds: Mapping[str, float],
    budget_s: float = BUDGET_S,
) -> QuickChoice:
    """Return the test files that a change can affect: the closest ones that fit into the budget.

    Changed test files are chosen whatever they take.
    """
    changed = list(changed)
    steps = steps_to(graph, modules_of(changed, graph.modules))
    near = dict.fromkeys(tests, FAR) if FOR_ALL.intersection(changed) else {}
    near |= {name: 1 for name in WHOLE_TREE if name in tests}
    if any(name.endswith((".md", ".toml")) for name in changed):
        near |= {name: 1 for name in tests if PurePosixPath(name).match(DOCUMENTS)}
    mirrored = tuple(mirrored_folders(changed))
    for name in tests:
        away = steps.get(module_of(name) or "")
        if away is not None:
            away = min(away, 1) if name.startswith(mirrored) else away
            near[name] = min(away, near.get(name, away))
    left_s = budget_s
    found = QuickChoice([], [])
    for name in sorted(near, key=lambda each: (near[each], seconds.get(each, 1.0), each)):
        takes_s = seconds.get(name, 1.0)
        if near[name] == 0 or takes_s <= left_s:
            left_s -= takes_s
            found.chosen.append(name)
        else:
            found.left_out.append(name)
    return found


def mirrored_folders(changed: Iterable[str]) -> set[str]:
    """Return the folders of unit tests that mirror the folders of changed modules."""
    packages = {_package_of(PurePosixPath(name).parent) for name in changed}
    return {f"{TESTS}/unit/{each.replace('.', '/')}/" for each in packages if each}


def add_named(graph: ImportLookup, root: Path) -> None:
    """Add the imports by name: commands, the functions of workers, and programs of tests."""
    known = frozenset(graph.modules)
    for name in _python_files(root):
        importer = module_of(name)
        if importer not in known:
            continue
        for word in set(NAMED.findall((root / name).read_text(encoding="utf-8"))):
            package, _, _ = word.rpartition(".")
            named = _directly_in(package, known) if word.endswith(".") else {word} & known
            for imported in named - {importer}:
                graph.add_import(importer=importer, imported=imported)


def _python_files(root: Path) -> list[str]:
    folders = {place for place in ROOTS.values() if place != "hil_tests/metro_hil"}
    return sorted(
        path.relative_to(root).as_posix()
        for folder in folders
        for path in (root / folder).rglob("*.py")
    )


def steps_to(graph: ImportLookup, changed: Iterable[str]) -> dict[str, int]:
    """Return the least number of imports between each module and a changed one."""
    steps = dict.fromkeys(changed, 0)
    wave = list(steps)
    while wave:
        reached = [
            (above, steps[module] + 1)
            for module in wave
            for above in graph.find_modules_that_directly_import(module)
        ]
        wave = []
        for module, away in reached:
            if module not in steps:
                steps[module] = away
                wave.append(module)
    return steps


def modules_of(changed: Iterable[str], known: Collection[str]) -> set[str]:
    """Return the modules that a change touches.

    A file of another kind belongs to the modules in its folder, or in the nearest folder above.
    Tests do not import such files.
    """
    found: set[str] = set()
    for name in changed:
        module = module_of(name)
        if module is not None:
            found |= {module} & set(known)
            continue
        package = _package_of(PurePosixPath(name).parent)
        if package.partition(".")[0] == TESTS:
            continue
        while package and not (beside := _directly_in(package, known)):
            package = package.rpartition(".")[0]
        if package:
            found |= beside
    return found


def _directly_in(package: str, known: Collection[str]) -> set[str]:
    return {each for each in known if each.rpartition(".")[0] == package}


def module_of(name: str) -> str | None:
    """Return the module of a file; None for files that are not Python of a package."""
    path = PurePosixPath(name)
    if path.suffix != ".py":
        return None
    package = _package_of(path.parent)
    if not package:
        return None
    return package if path.stem == "__init__" else f"{package}.{path.stem}"


def _package_of(folder: PurePosixPath) -> str:
    """Return the name under which a folder is imported; an empty text for none."""
    for package, place in sorted(ROOTS.items(), key=lambda item: -len(item[1])):
        if folder.is_relative_to(place):
            return ".".join([package, *folder.relative_to(place).parts])
    return ""


def _learn(root: Path, report: Path) -> int:
    try:
        cases = ElementTree.parse(report).getroot().iter("testcase")  # noqa: S314 - our own report
        took_s: defaultdict[str, float] = defaultdict(float)
        for case in cases:
            name = str(case.get("classname")).replace(".", "/").removeprefix(f"{TESTS}/")
            took_s[f"{name}.py"] += float(case.get("time") or 0.0)
    except (OSError, ElementTree.ParseError, ValueError) as error:
        print(f"quick_tests: --learn {report}: {error}; give a file of --junitxml", file=sys.stderr)
        return EXIT_USAGE
    path = root / SECONDS
    head = [line for line in path.read_text(encoding="utf-8").splitlines() if line[:1] == "#"]
    rows = {name: round(seconds) for name, seconds in took_s.items()}
    lines = [f'"{name}" = {rows[name]}' for name in sorted(rows) if rows[name] >= SECONDS_MIN]
    path.write_text("".join(f"{line}\n" for line in head + lines), encoding="utf-8")
    print(f"{path}: {len(lines)} files")
    return 0


if __name__ == "__main__":
    sys.exit(main())
