"""The compiled copy in the cache: one build for many processes, its key, and how it is entered."""

import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest

from metro_hil.cli.vobc import main
from metro_hil.model import native_copy
from metro_hil.model.native_copy import Native, prepare, ready_copy, sources_key
from metro_tools import compiled
from metro_tools.compiled import HOT, LOCKSTEP, CompileError, build_cached, hot_modules


@pytest.fixture
def sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package of one file as the sources, an empty cache, and a compiler that only leaves a
    mark."""
    folder = tmp_path / "sources" / "metro_hil"
    folder.mkdir(parents=True)
    (folder / "one.py").write_text("ONE = 1\n")
    folders = {"metro_hil": folder}
    for module in (native_copy, compiled):
        monkeypatch.setattr(module, "package_folders", lambda: folders)
    monkeypatch.setattr(native_copy, "missing_tools", lambda: "")
    monkeypatch.setattr(compiled, "compile_into", marked)
    monkeypatch.setattr(os, "nice", lambda more: 0)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv(native_copy.SWITCH, "on")
    return folder


def marked(library: Path, level: str, *, lockstep: bool) -> None:
    assert lockstep
    (library / "metro_hil" / "one.so").write_text(level)


def started(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """Commands of processes that would be started."""
    found: list[list[str]] = []
    monkeypatch.setattr(
        subprocess, "Popen", lambda command, **options: found.append([*command, str(options)])
    )
    return found


def test_a_build_makes_the_copy_of_these_sources_and_no_other(sources: Path) -> None:
    assert ready_copy() is None

    assert build_cached(wait=False) == 0

    library = ready_copy()
    assert library is not None
    assert (library / "metro_hil" / "one.py").read_text() == "ONE = 1\n"
    assert (library / "metro_hil" / "one.so").exists()
    (sources / "one.py").write_text("ONE = 2\n")
    assert ready_copy() is None


def test_the_key_depends_on_names_and_contents_but_not_on_built_files(sources: Path) -> None:
    folders = {"metro_hil": sources}
    before = sources_key(folders)

    (sources / "__pycache__").mkdir()
    (sources / "__pycache__" / "one.cpython-311.pyc").write_bytes(b"x")
    (sources / "one.so").write_bytes(b"x")
    assert sources_key(folders) == before
    (sources / "one.py").rename(sources / "other.py")
    assert sources_key(folders) != before


def test_the_copy_has_the_same_key_as_its_sources(sources: Path) -> None:
    build_cached(wait=False)
    library = ready_copy()

    assert library is not None
    assert library.parent.name == sources_key({"metro_hil": library / "metro_hil"})


def test_the_first_run_starts_one_build_and_says_so_once(
    sources: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found = started(monkeypatch)

    assert prepare("vobc") is None

    ((_, *words, options),) = found
    assert words == ["-m", "metro_tools.compiled", "--cached"]
    assert "'start_new_session': True" in options
    assert capsys.readouterr().err.count("\n") == 1
    with native_copy.build_lock(wait=False) as mine:
        assert mine
        assert prepare("vobc") is None
    assert len(found) == 1
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("choice", ["off", "wire"])
def test_the_user_can_refuse(
    choice: str, sources: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found = started(monkeypatch)
    build_cached(wait=False)
    monkeypatch.setenv(native_copy.SWITCH, choice)

    assert prepare("vobc") is None
    assert found == []
    assert capsys.readouterr().err == ""


def test_a_wrong_choice_is_a_usage_error_that_lists_the_choices(
    sources: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(native_copy.SWITCH, "yes")

    with pytest.raises(SystemExit) as ended:
        prepare("vobc")

    assert ended.value.code == 2
    words = capsys.readouterr().err
    assert words == "VOBC_NATIVE=yes: no such choice; use one of off, wire, on, wait\n"


def test_waiting_uses_the_copy_at_once(sources: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(native_copy.SWITCH, "wait")

    def build(command: list[str], **options: Any) -> None:
        assert command[-1] == "--wait"
        assert options["env"][native_copy.SWITCH] == "wire"
        build_cached(wait=True)

    monkeypatch.setattr(subprocess, "run", build)

    assert prepare("vobc") == ready_copy() is not None


def test_of_two_builds_at_once_one_compiles_and_the_waiting_one_finds_its_copy(
    sources: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[str] = []
    begun, go_on = threading.Event(), threading.Event()

    def slow(library: Path, level: str, *, lockstep: bool) -> None:
        calls.append(level)
        begun.set()
        assert go_on.wait(30.0)
        marked(library, level, lockstep=lockstep)

    monkeypatch.setattr(compiled, "compile_into", slow)
    first = threading.Thread(target=build_cached, kwargs={"wait": False})
    first.start()
    assert begun.wait(30.0)
    assert build_cached(wait=False) == 0
    assert ready_copy() is None
    second = threading.Thread(target=build_cached, kwargs={"wait": True})
    second.start()
    go_on.set()
    first.join()
    second.join()

    assert calls == ["1"]
    assert ready_copy() is not None


def test_a_failed_build_is_not_tried_again_before_the_sources_change(
    sources: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing(library: Path, level: str, *, lockstep: bool) -> None:
        raise CompileError("mypyc failed")

    found = started(monkeypatch)
    monkeypatch.setattr(compiled, "compile_into", failing)

    assert compiled.main(["--cached"]) == 3
    assert prepare("vobc") is None
    assert found == []
    assert "the build failed" in native_copy.controller_text()
    (sources / "one.py").write_text("ONE = 3\n")
    prepare("vobc")
    assert len(found) == 1


def test_parts_of_killed_builds_and_unused_copies_are_removed(sources: Path) -> None:
    build_cached(wait=False)
    old = ready_copy()
    assert old is not None
    (native_copy.copies_folder() / ".part.killed" / "lib").mkdir(parents=True)
    os.utime(old, (1.0, 1.0))
    (sources / "one.py").write_text("ONE = 4\n")

    build_cached(wait=False)

    left = [path for path in native_copy.copies_folder().iterdir() if path.is_dir()]
    new = ready_copy()
    assert new is not None
    assert left == [new.parent]


def test_a_run_becomes_the_same_program_in_the_copy(
    sources: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    build_cached(wait=False)
    entered: list[tuple[list[str], dict[str, str]]] = []
    monkeypatch.setattr(os, "execve", lambda path, words, env: entered.append((words, env)))
    monkeypatch.setattr(sys, "argv", ["vobc", "run", "--lockstep", "--seed", "7"])
    monkeypatch.setenv("PYTHONPATH", "/mine")

    native_copy.enter("vobc")

    ((words, environment),) = entered
    assert words[0] == sys.executable
    assert words[3:] == ["run", "--lockstep", "--seed", "7"]
    assert environment["PYTHONPATH"] == f"{ready_copy()}:/mine"
    assert environment[native_copy.SWITCH] == Native.WIRE.value


def test_without_a_cache_runs_use_the_sources(
    sources: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    found = started(monkeypatch)

    assert prepare("vobc") is None
    assert found == []


def test_the_version_says_how_runs_are_executed(
    sources: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(native_copy.SWITCH, "on")
    assert main(["--version", "-v"]) == 0
    build_cached(wait=False)
    assert main(["--version", "-v"]) == 0

    _, wire, before, _, _, after = capsys.readouterr().out.splitlines()
    assert wire.startswith("codec, bus and logs: ")
    assert before == "controller: Python, not compiled yet"
    assert after == "controller: compiled"


def test_the_cached_copy_compiles_modules_whose_bytes_are_compared(checkout: Path) -> None:
    """`test_compiled_copy` compares the bytes of a copy in which all hot modules are compiled."""
    for pattern in LOCKSTEP:
        assert hot_modules(checkout, [pattern]), pattern
    assert {*hot_modules(checkout, LOCKSTEP)} <= {*hot_modules(checkout, HOT)}


def test_setuptools_gets_a_compiler_that_is_a_python_package(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The linker of zig does not know the options that setuptools takes from this Python."""
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(compiled, "compiler", lambda: ("/my python", "-m", "ziglang", "cc"))
    assert compiled.setuptools_compiler() == {
        "CC": "'/my python' -m ziglang cc",
        "LDSHARED": "'/my python' -m ziglang cc -shared",
    }
    monkeypatch.setattr(compiled, "compiler", lambda: ("/usr/bin/cc",))
    assert compiled.setuptools_compiler() == {}
