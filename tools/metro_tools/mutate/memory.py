"""Stored result of each mutant, for as long as it is still valid.

There is one file for each module, in a folder outside of version control. A change of the module or
of this program discards all its results. A detected mutant stays detected while the test that
detected it is unchanged; a survivor stays one while all its tests are unchanged. Changes of other
modules, which could hide a mutant from its test, are not considered: `--fresh` tries everything.
"""

import ast
import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from metro_tools.mutate.result import NOT_NOTICED
from metro_tools.mutate.targets import TargetGroup

FOLDER: Final = ".mutation"
DRIVER: Final = Path(__file__).parent
_DIGITS: Final = 16


@dataclass(frozen=True, slots=True)
class Remembered:
    """A result, with a digest of the tests that it depends on."""

    result: str
    by: str
    rests_on: str


@dataclass(slots=True)
class Memory:
    """The results of one module."""

    path: Path
    module: str
    """Digest of the module and of this program."""
    tests: "Tests"
    results: dict[int, Remembered] = field(default_factory=dict)

    def holds(self, entry: Remembered) -> bool:
        """Return whether the tests that a result depends on are unchanged."""
        return entry.rests_on == self._rests_on(entry.result, entry.by)

    def is_of(self, path: Path) -> bool:
        """Return whether the results belong to the present module."""
        return self.module == module_digest(path)

    def note(self, number: int, result: str, by: str) -> None:
        self.results[number] = Remembered(result, by, self._rests_on(result, by))

    def save(self) -> None:
        entries = {
            str(number): [entry.result, entry.by, entry.rests_on]
            for number, entry in sorted(self.results.items())
        }
        self.path.parent.mkdir(exist_ok=True)
        part = self.path.with_suffix(".part")
        part.write_text(json.dumps({"module": self.module, "results": entries}), encoding="utf-8")
        part.replace(self.path)

    def _rests_on(self, result: str, by: str) -> str:
        return self.tests.all if result in NOT_NOTICED else self.tests.of(by)


class Tests:
    """Digests of a group's tests: of each test, and of all with the modules beside them."""

    def __init__(self, root: Path, group: TargetGroup) -> None:
        self._root = root
        self._of: dict[str, str] = {}
        self._files: dict[str, Mapping[str, str]] = {}
        beside = {
            path
            for name in group.tests
            for path in (root / name).parent.glob("*.py")
            if not path.name.startswith("test_")
        }
        self.all = _digest(
            path.read_bytes() for path in (*(root / name for name in group.tests), *sorted(beside))
        )

    def of(self, name: str) -> str:
        """Return the digest of one test by its pytest name.

        A removed test has a digest that no other has.
        """
        if not name:
            return ""
        if name not in self._of:
            path, *parts = name.split("[")[0].split("::")
            tests = self._tests_of(path)
            self._of[name] = tests.get(".".join(parts), tests[""])
        return self._of[name]

    def _tests_of(self, path: str) -> Mapping[str, str]:
        if path not in self._files:
            try:
                source = (self._root / path).read_text(encoding="utf-8")
                found = {name: _digest([text.encode()]) for name, text in _functions(source)}
                found[""] = _digest([source.encode()])
            except (OSError, SyntaxError):
                found = {"": "gone"}
            self._files[path] = found
        return self._files[path]


def recall(root: Path, module: str, tests: Tests, *, fresh: bool) -> Memory:
    """Return the valid stored results of a module's mutants; none from an unreadable file."""
    digest = module_digest(root / module)
    memory = Memory(root / FOLDER / f"{module.replace('/', '.')}.json", digest, tests)
    if fresh:
        return memory
    try:
        told = json.loads(memory.path.read_text(encoding="utf-8"))
        if told["module"] == digest:
            memory.results = {int(n): Remembered(*entry) for n, entry in told["results"].items()}
    except (OSError, ValueError, KeyError, TypeError):
        pass
    return memory


def module_digest(path: Path) -> str:
    """Return the digest of the present module and of this program."""
    return _digest(each.read_bytes() for each in (path, *sorted(DRIVER.glob("*.py"))))


def _functions(source: str) -> Iterator[tuple[str, str]]:
    """Yield all tests of a file with their text, without comments and line numbers."""
    for statement in ast.parse(source).body:
        inner = statement.body if isinstance(statement, ast.ClassDef) else ()
        outer = f"{statement.name}." if isinstance(statement, ast.ClassDef) else ""
        for prefix, node in (("", statement), *((outer, part) for part in inner)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                yield prefix + node.name, ast.dump(node)


def _digest(parts: Iterable[bytes]) -> str:
    whole = hashlib.sha256()
    for part in parts:
        whole.update(hashlib.sha256(part).digest())
    return whole.hexdigest()[:_DIGITS]
