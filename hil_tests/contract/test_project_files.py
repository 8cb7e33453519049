"""Rules for every file of the project: size, first sentence, and no trace of a single machine."""

import ast
import functools
import re
import signal
import subprocess
import tomllib
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import pytest

from hil_tests.conftest import COMPUTING, ON_ITS_OWN, REALTIME, heed_ctrl_c, is_realtime

ROOT: Final = Path(__file__).resolve().parents[2]
MODULE_LINES_MAX: Final = 500
TEST_LINES_MAX: Final = 800
"""Longest test file in lines; tests are read one at a time."""
FUNCTION_LINES_MAX: Final = 70

UNFINISHED: Final = re.compile(r"\b(?:TODO|FIXME|XXX|HACK)\b|NotImplementedError")
ONE_MACHINE: Final = re.compile(r"/work/|/home/[a-z]|/root/|/Users/|/opt/[a-z]|C:\\Users")
REGISTRY: Final = re.compile(
    r"pypi\.org|pythonhosted|artifactory|--(?:extra-index|index-url|find-links)"
)
NOT_SEARCHED: Final = ("LICENSE", "hil_tests/contract/test_project_files.py")
"""Files without this check: the licence has another author, and this file holds the patterns."""


def tracked() -> list[Path]:
    """All existing files that git tracks."""
    listing = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    paths = (ROOT / name for name in listing.stdout.split("\0") if name)
    return sorted(path for path in paths if path.is_file())


def texts() -> Iterator[tuple[str, str]]:
    """Name and content of each tracked text file."""
    for path in tracked():
        try:
            yield str(path.relative_to(ROOT)), path.read_text(encoding="utf-8")
        except UnicodeDecodeError:
            continue


PYTHON_FILES: Final = [path for path in tracked() if path.suffix == ".py"]


@functools.cache
def trees() -> dict[Path, ast.Module]:
    """The syntax trees of all Python files."""
    return {path: ast.parse(path.read_text(encoding="utf-8")) for path in PYTHON_FILES}


def test_git_tracks_files() -> None:
    assert len(PYTHON_FILES) > 50


@pytest.mark.parametrize(
    ("pattern", "what"),
    [
        (UNFINISHED, "a mark of something unfinished"),
        (ONE_MACHINE, "a path of one machine"),
        (REGISTRY, "a package registry"),
    ],
    ids=["unfinished", "one_machine", "registry"],
)
def test_no_file_holds(pattern: re.Pattern[str], what: str) -> None:
    found = [
        f"{name}:{text.count(chr(10), 0, match.start()) + 1}: {match[0]!r} is {what}"
        for name, text in texts()
        if name not in NOT_SEARCHED
        for match in pattern.finditer(text)
    ]

    assert found == []


def test_the_search_finds_the_patterns() -> None:
    assert UNFINISHED.search("# TODO: later")
    assert ONE_MACHINE.search("open('/home/me/x')")
    assert REGISTRY.search("--index-url=x")
    assert not ONE_MACHINE.search("network/workspace homework/")


def test_every_module_has_a_docstring() -> None:
    mute = [
        str(path.relative_to(ROOT))
        for path, tree in trees().items()
        if tree.body and not ast.get_docstring(tree)
    ]

    assert mute == []


def test_long_modules_are_reported() -> None:
    """A long module is no error, so pytest reports it as a warning."""
    for path in PYTHON_FILES:
        lines = len(path.read_text(encoding="utf-8").splitlines())
        if lines > (TEST_LINES_MAX if path.name.startswith("test_") else MODULE_LINES_MAX):
            warnings.warn(f"{path.relative_to(ROOT)} has {lines} lines", stacklevel=1)


def test_no_function_is_too_long() -> None:
    long = [
        f"{path.relative_to(ROOT)}:{node.lineno}: {node.name}"
        for path, tree in trees().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and (node.end_lineno or node.lineno) - node.lineno + 1 > FUNCTION_LINES_MAX
    ]

    assert long == []


def test_no_public_class_name_is_used_twice() -> None:
    """One name means one thing in the whole product; tests may name their rigs freely."""
    places: dict[str, list[str]] = {}
    for path, tree in trees().items():
        where = path.relative_to(ROOT)
        if where.parts[0] == "hil_tests" and where.parts[1] != "metro_hil":
            continue
        for node in tree.body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places.setdefault(node.name, []).append(str(where))

    assert {name: where for name, where in places.items() if len(where) > 1} == {}


def test_test_files_have_unique_names() -> None:
    names = [path.name for path in PYTHON_FILES if path.name.startswith("test_")]

    assert sorted(names) == sorted(set(names))


def test_no_test_is_skipped_or_expected_to_fail() -> None:
    """Only the guest may skip tests; it reports this loudly and fails in CI."""
    marks = re.compile(r"pytest\.(?:mark\.)?(?:sk" r"ip|xf" r"ail|importor" r"skip)")

    found = [name for name, text in texts() if name.endswith(".py") and marks.search(text)]

    assert found == ["hil_tests/conftest.py"]


def test_every_toml_file_is_valid() -> None:
    for path in tracked():
        if path.suffix == ".toml":
            tomllib.loads(path.read_text(encoding="utf-8"))


def test_programs_can_be_executed_and_name_their_interpreter() -> None:
    programs = [
        path
        for path in tracked()
        if path.parent in (ROOT / "tools", ROOT / ".ci") and not path.suffix
    ]

    assert len(programs) >= 3
    for path in programs:
        assert path.stat().st_mode & 0o100, path
        assert path.read_bytes().startswith(b"#!"), path


def test_shell_scripts_can_be_read_by_their_shells() -> None:
    for path in tracked():
        first = path.read_bytes().splitlines()[:1]
        if first and first[0].startswith(b"#!") and b"sh" in first[0]:
            shell = "bash" if b"bash" in first[0] else "sh"
            done = subprocess.run([shell, "-n", str(path)], capture_output=True, check=False)
            assert (done.returncode, done.stderr) == (0, b""), path


def test_the_constraints_pin_everything_and_name_no_location() -> None:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pins = [line for line in lines if line and not line.startswith("#")]

    assert all(re.fullmatch(r"[A-Za-z0-9_.-]+==[0-9][A-Za-z0-9.+!]*", pin) for pin in pins)
    pinned = {re.split("==", pin)[0].lower().replace("_", "-") for pin in pins}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = [*project["dependencies"], *project["optional-dependencies"]["dev"], "hatchling"]
    missing = {re.split("[<>=!~]", need)[0].strip() for need in wanted} - pinned
    assert missing == set()


def test_tests_by_the_real_clock_are_told_from_those_that_compute(checkout: Path) -> None:
    folder = checkout / "hil_tests" / REALTIME

    names = {path.stem for path in folder.glob("test_*.py")}

    assert names >= COMPUTING | ON_ITS_OWN
    assert {
        path.stem for path in folder.glob("test_*.py") if is_realtime(path)
    } == names - COMPUTING


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (signal.SIG_IGN, signal.default_int_handler),
        (signal.default_int_handler, signal.default_int_handler),
        (signal.SIG_DFL, signal.SIG_DFL),
    ],
    ids=["in the background of a script", "in the foreground", "by default"],
)
def test_tests_in_the_background_of_a_script_heed_ctrl_c(
    before: Callable[..., object] | signal.Handlers, after: Callable[..., object] | signal.Handlers
) -> None:
    kept = signal.signal(signal.SIGINT, before)
    try:
        heed_ctrl_c()

        assert signal.getsignal(signal.SIGINT) is after
    finally:
        signal.signal(signal.SIGINT, kept)
