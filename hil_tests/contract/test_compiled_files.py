"""Test files that run on the compiled copy: their reports are those of a run in place."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from hil_tests.compiled_files import GROUP, ON_COPY, SOURCES, TOGETHER, CompiledFiles, group_of
from hil_tests.conftest import scope_of

SAMPLE = """\
import os
from only_in_the_copy import NUMBER

def test_good():
    assert NUMBER == 7

def test_bad():
    assert NUMBER == 8

def test_dies():
    os._exit(0)

def test_marked():
    assert False
"""


def test_the_named_files_exist(checkout: Path) -> None:
    names = [path.stem for path in (checkout / "hil_tests").rglob("test_*.py")]

    named = [*ON_COPY, *TOGETHER]
    assert [names.count(name) for name in named] == [1] * len(named)
    assert not ON_COPY & TOGETHER


def test_shorter_files_share_a_process_and_a_worker() -> None:
    shorter = [f"hil_tests/unit/{name}.py" for name in sorted(TOGETHER)]

    assert {group_of(Path(name)) for name in shorter} == {GROUP}
    assert {scope_of(name) for name in shorter} == {GROUP}
    assert sorted(group_of(Path(f"{name}.py")) for name in ON_COPY) == sorted(ON_COPY)


def ran(request: pytest.FixtureRequest, folder: Path, copy: Path | None) -> Any:
    """Return whether each of the sample's tests was run on the copy, their reports, and the item
    after each one that was.

    The last test has the mark that keeps it on the sources.
    """
    path = folder / "test_sample.py"
    path.write_text(SAMPLE, encoding="utf-8")
    found: dict[str, list[pytest.TestReport]] = {}
    followers: list[Any] = []
    hook = SimpleNamespace(
        pytest_runtest_logstart=lambda nodeid, location: found.setdefault(nodeid, []),
        pytest_runtest_logreport=lambda report: found[report.nodeid].append(report),
        pytest_runtest_logfinish=lambda nodeid, location: None,
    )
    standing = SimpleNamespace(teardown_exact=followers.append)
    session = SimpleNamespace(items=[], _setupstate=standing)
    for name in ("good", "bad", "dies", "marked"):
        item: dict[str, Any] = {
            "nodeid": f"test_sample.py::test_{name}",
            "location": ("test_sample.py", 0, name),
        }
        marks = {SOURCES} if name == "marked" else set()
        item["get_closest_marker"] = lambda mark, marks=marks: mark if mark in marks else None
        session.items.append(SimpleNamespace(path=path, session=session, ihook=hook, **item))
    config: Any = SimpleNamespace(rootpath=folder, hook=request.config.hook)
    files = CompiledFiles(config, frozenset({"test_sample"}), lambda: copy)
    items = session.items
    taken = [
        files.pytest_runtest_protocol(item, following)
        for item, following in zip(items, [*items[1:], None], strict=True)
    ]
    return taken, found, [each and each.nodeid for each in followers]


def test_each_test_on_the_copy_is_reported_and_one_without_a_report_fails(
    request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    copy = tmp_path / "copy"
    copy.mkdir()
    (copy / "only_in_the_copy.py").write_text("NUMBER = 7\n", encoding="utf-8")

    taken, found, _ = ran(request, tmp_path, copy)

    outcomes = {
        name.partition("::test_")[2]: [each.outcome for each in reports if each.when == "call"]
        for name, reports in found.items()
    }
    assert taken == [True, True, True, None]
    assert outcomes == {"good": ["passed"], "bad": ["failed"], "dies": ["failed"]}
    assert "assert 7 == 8" in found["test_sample.py::test_bad"][1].longreprtext


def test_without_a_copy_the_worker_runs_the_tests_itself(
    request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    assert ran(request, tmp_path, None) == ([None] * 4, {}, [])


def test_what_the_test_before_left_standing_is_torn_down_for_the_next_one(
    request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    _, _, followers = ran(request, tmp_path, tmp_path)

    assert followers == [
        "test_sample.py::test_bad",
        "test_sample.py::test_dies",
        "test_sample.py::test_marked",
    ]
