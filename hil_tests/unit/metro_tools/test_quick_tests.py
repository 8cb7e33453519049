"""The tests that a change can affect: by imports, by names in programs, and within the minute."""

import subprocess
from pathlib import Path

import pytest

from metro_tools import quick_tests
from metro_tools.quick_tests import choose, modules_of, seconds_of_files, steps_to

FILES = {
    "vobc.atp.braking": set[str](),
    "vobc.atp.station": set[str](),
    "vobc.controller": {"vobc.atp.braking"},
    "metro_hil.run.case": {"vobc.controller"},
    "hil_tests.unit.vobc.atp.test_braking": {"vobc.atp.braking"},
    "hil_tests.unit.vobc.test_controller": {"vobc.controller"},
    "hil_tests.closed_loop.test_case": {"metro_hil.run.case"},
    "hil_tests.unit.canlog.test_log": set[str](),
}
"""Modules and what they import."""
TESTS = ["hil_tests/" + name for name in (
    "unit/vobc/atp/test_braking.py", "unit/vobc/test_controller.py", "closed_loop/test_case.py",
    "unit/canlog/test_log.py", "contract/test_project_files.py", "contract/test_hil_document.py",
)]  # fmt: skip
BRAKING, CONTROLLER, CASE, LOG, RULES, DOCUMENT = TESTS


class Graph:
    """An import graph of few modules."""

    def __init__(self) -> None:
        self.modules = set(FILES)
        self._imports = {module: set(imported) for module, imported in FILES.items()}

    def add_import(self, *, importer: str, imported: str) -> None:
        self._imports[importer].add(imported)

    def find_modules_that_directly_import(self, module: str) -> set[str]:
        return {each for each, imported in self._imports.items() if module in imported}


def test_the_closest_tests_come_first_and_others_are_not_chosen() -> None:
    found = choose(["vobc/atp/braking.py"], Graph(), TESTS, {})

    assert found.chosen == [RULES, BRAKING, CONTROLLER, CASE]
    assert found.left_out == []


def test_what_does_not_fit_into_the_minute_is_named() -> None:
    seconds = {CONTROLLER: 50.0, CASE: 2.0}

    found = choose(["vobc/atp/braking.py"], Graph(), TESTS, seconds, budget_s=10.0)

    assert found.chosen == [RULES, BRAKING, CASE]
    assert found.left_out == [CONTROLLER]


def test_a_changed_test_is_chosen_whatever_it_takes() -> None:
    found = choose([CASE], Graph(), TESTS, {CASE: 900.0}, budget_s=1.0)

    assert found.chosen == [CASE]
    assert found.left_out == [RULES]


def test_a_changed_document_concerns_the_tests_of_documents() -> None:
    assert choose(["docs/guide/hil.md"], Graph(), TESTS, {}).chosen == [DOCUMENT, RULES]


@pytest.mark.parametrize("name", ["hil_tests/conftest.py", "pyproject.toml", "constraints.txt"])
def test_a_file_on_which_all_tests_depend_chooses_all(name: str) -> None:
    found = choose([name], Graph(), TESTS, {})

    assert sorted(found.chosen + found.left_out) == sorted(TESTS)


@pytest.mark.parametrize(
    ("name", "modules"),
    [
        ("vobc/atp/braking.py", {"vobc.atp.braking"}),
        ("vobc/atp/limits.toml", {"vobc.atp.braking", "vobc.atp.station"}),
        ("vobc/atp/files/florence.toml", {"vobc.atp.braking", "vobc.atp.station"}),
        ("hil_tests/metro_hil/run/case.py", {"metro_hil.run.case"}),
        ("hil_tests/test_seconds.toml", set()),
        ("vobc/atp/removed.py", set()),
        ("README.md", set()),
    ],
)
def test_a_change_touches_the_module_or_those_beside_a_file(name: str, modules: set[str]) -> None:
    assert modules_of([name], FILES) == modules


def test_a_module_that_is_imported_by_its_name_is_an_import(tmp_path: Path) -> None:
    (tmp_path / "vobc").mkdir()
    (tmp_path / "vobc" / "controller.py").write_text('RUN = "metro_hil.run.case:run"\n')
    (tmp_path / "vobc" / "atp").mkdir()
    (tmp_path / "vobc" / "atp" / "station.py").write_text('name = f"vobc.atp.{verb}"\n')
    graph = Graph()

    quick_tests.add_named(graph, tmp_path)

    assert steps_to(graph, {"metro_hil.run.case"})["vobc.controller"] == 1
    assert steps_to(graph, {"vobc.atp.braking"})["vobc.atp.station"] == 1


def git(folder: Path, *words: str) -> None:
    name = ["-c", "user.name=a", "-c", "user.email=a@b"]
    subprocess.run(["git", *name, *words], cwd=folder, check=True, capture_output=True)


@pytest.fixture
def repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A repository of one committed file."""
    monkeypatch.chdir(tmp_path)
    git(tmp_path, "init", "-q", "-b", "main")
    (tmp_path / "kept.py").write_text("1\n")
    git(tmp_path, "add", "-A")
    git(tmp_path, "commit", "-qm", "one")
    return tmp_path


def test_without_a_change_no_test_runs(
    repository: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert quick_tests.main([]) == 0
    assert "nothing changed since HEAD" in capsys.readouterr().out


def test_changed_new_and_deleted_files_count_and_commits_that_were_not_pushed(
    repository: Path,
) -> None:
    git(repository, "update-ref", "refs/remotes/origin/main", "HEAD")
    (repository / "committed.py").write_text("2\n")
    git(repository, "add", "-A")
    git(repository, "commit", "-qm", "two")
    (repository / "kept.py").unlink()
    (repository / "new.py").write_text("3\n")

    since = quick_tests.shared_commit(repository)

    found = quick_tests.changed_files(repository, since)
    assert found == ["committed.py", "kept.py", "new.py"]


def test_an_unknown_commit_is_one_line(
    repository: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert quick_tests.main(["--since", "yesterday"]) == 2
    assert capsys.readouterr().err == "quick_tests: fatal: bad revision 'yesterday'\n"


def test_times_are_learnt_from_a_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "hil_tests").mkdir()
    (tmp_path / "hil_tests" / "test_seconds.toml").write_text('# head\n"old.py" = 3\n')
    case = '<testcase classname="hil_tests.unit.{}" name="a" time="{}"/>'
    cases = [case.format("test_b", 1.6), case.format("test_b", 2.0), case.format("test_c", 0.1)]
    (tmp_path / "run.xml").write_text(f"<x>{''.join(cases)}</x>")
    monkeypatch.chdir(tmp_path)

    assert quick_tests.main(["--learn", "run.xml"]) == 0

    assert (tmp_path / "hil_tests" / "test_seconds.toml").read_text().startswith("# head\n")
    assert seconds_of_files(tmp_path) == {"hil_tests/unit/test_b.py": 4.0}


def test_a_missing_report_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)

    assert quick_tests.main(["--learn", "none.xml"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_without_a_table_no_time_is_known(tmp_path: Path) -> None:
    assert seconds_of_files(tmp_path) == {}
