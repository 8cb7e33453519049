"""The compiled copy in the cache: one build for many processes, its key, and how it is entered."""

import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest

from firmware_py.native.build import CompileTarget, here
from metro_hil.cli.vobc import main
from metro_hil.model import native_copy
from metro_hil.model.native_copy import (
    Native,
    Part,
    package_folders,
    prepare,
    ready_copy,
    sources_key,
    worker_environment,
)
from metro_tools import compiled
from metro_tools.compiled import KEPT, MODULES, QUICK, CompileError, build, hot_modules, units


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


def marked(library: Path, part: Part, target: CompileTarget) -> None:
    (library / "metro_hil" / "one.so").write_text(part.value)


def started(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """Commands of processes that would be started."""
    found: list[list[str]] = []
    monkeypatch.setattr(
        subprocess, "Popen", lambda command, **options: found.append([*command, str(options)])
    )
    return found


def test_a_build_makes_the_copy_of_these_sources_and_no_other(sources: Path) -> None:
    assert ready_copy() is None

    assert build(Part.TRAIN, wait=False) == 0

    library = ready_copy()
    assert library is not None
    assert (library / "metro_hil" / "one.py").read_text() == "ONE = 1\n"
    assert (library / "metro_hil" / "one.so").exists()
    (sources / "one.py").write_text("ONE = 2\n")
    assert ready_copy() is None


def test_the_key_depends_on_names_and_contents_but_not_on_built_files(sources: Path) -> None:
    folders = {"metro_hil": sources}
    before = sources_key(folders, Part.TRAIN)

    (sources / "__pycache__").mkdir()
    (sources / "__pycache__" / "one.cpython-311.pyc").write_bytes(b"x")
    (sources / "one.so").write_bytes(b"x")
    assert sources_key(folders, Part.TRAIN) == before
    (sources / "one.py").rename(sources / "other.py")
    assert sources_key(folders, Part.TRAIN) != before


def test_the_copy_has_the_same_key_as_its_sources(sources: Path) -> None:
    build(Part.TRAIN, wait=False)
    library = ready_copy()

    assert library is not None
    assert library.parent.name == sources_key({"metro_hil": library / "metro_hil"}, Part.TRAIN)


def test_a_compiled_wheel_brings_the_copy_and_needs_no_cache(
    sources: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(native_copy, "shipped_folder", lambda: tmp_path / "shipped")
    key = sources_key({"metro_hil": sources}, Part.TRAIN)
    shipped = tmp_path / "shipped" / "copies" / key / "lib"
    shipped.mkdir(parents=True)
    monkeypatch.setattr(native_copy, "missing_tools", lambda: "no C compiler")

    assert native_copy.prepare("vobc") == shipped
    assert not (tmp_path / "cache").exists()
    (sources / "one.py").write_text("ONE = 2\n")
    assert native_copy.prepare("vobc") is None


def test_the_key_holds_for_one_machine_and_one_minor_version_of_python(sources: Path) -> None:
    folders = {"metro_hil": sources}
    arm = here()._replace(machine="aarch64")

    assert sources_key(folders, Part.TRAIN, here()) == sources_key(folders, Part.TRAIN)
    assert sources_key(folders, Part.TRAIN, arm) != sources_key(folders, Part.TRAIN)


def test_the_first_run_starts_one_build_and_says_so_once(
    sources: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found = started(monkeypatch)

    assert prepare("vobc") is None

    ((_, *words, options),) = found
    assert words == ["-m", "metro_tools.compiled", "--part", "train"]
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
    build(Part.TRAIN, wait=False)
    monkeypatch.setenv(native_copy.SWITCH, choice)

    assert prepare("vobc") is None
    assert found == []
    assert capsys.readouterr().err == ""


def test_the_user_can_refuse_builds_and_still_use_what_was_built(
    sources: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found = started(monkeypatch)
    monkeypatch.setenv(native_copy.SWITCH, "ready")

    assert prepare("vobc") is None
    assert native_copy.controller_text() == "Python, not compiled (VOBC_NATIVE=ready)"
    build(Part.TRAIN, wait=False)

    assert prepare("vobc") == ready_copy() is not None
    assert native_copy.controller_text() == "compiled"
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
    assert words == "VOBC_NATIVE=yes: no such choice; use one of off, wire, ready, on, wait\n"


def test_waiting_uses_the_copy_at_once(sources: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(native_copy.SWITCH, "wait")

    def run_builder(command: list[str], **options: Any) -> None:
        assert command[-1] == "--wait"
        assert options["env"][native_copy.SWITCH] == "wire"
        build(Part.TRAIN, wait=True)

    monkeypatch.setattr(subprocess, "run", run_builder)

    assert prepare("vobc") == ready_copy() is not None


def test_of_two_builds_at_once_one_compiles_and_the_waiting_one_finds_its_copy(
    sources: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[Part] = []
    begun, go_on = threading.Event(), threading.Event()

    def slow(library: Path, part: Part, target: CompileTarget) -> None:
        calls.append(part)
        begun.set()
        assert go_on.wait(30.0)
        marked(library, part, target)

    monkeypatch.setattr(compiled, "compile_into", slow)
    first = threading.Thread(target=build, args=(Part.TRAIN,), kwargs={"wait": False})
    first.start()
    assert begun.wait(30.0)
    assert build(Part.TRAIN, wait=False) == 0
    assert ready_copy() is None
    second = threading.Thread(target=build, args=(Part.TRAIN,), kwargs={"wait": True})
    second.start()
    go_on.set()
    first.join()
    second.join()

    assert calls == [Part.TRAIN]
    assert ready_copy() is not None


def test_a_failed_build_is_not_tried_again_before_the_sources_change(
    sources: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing(library: Path, part: Part, target: CompileTarget) -> None:
        raise CompileError("mypyc failed")

    found = started(monkeypatch)
    monkeypatch.setattr(compiled, "compile_into", failing)

    assert compiled.main([]) == 3
    assert prepare("vobc") is None
    assert found == []
    assert "the build failed" in native_copy.controller_text()
    (sources / "one.py").write_text("ONE = 3\n")
    prepare("vobc")
    assert len(found) == 1


def test_parts_of_killed_builds_and_unused_copies_are_removed(sources: Path) -> None:
    (native_copy.copies_folder() / ".part.killed" / "lib").mkdir(parents=True)
    built: list[Path] = []
    for number in range(KEPT + 3):
        (sources / "one.py").write_text(f"ONE = {number}\n")
        build(Part.TRAIN, wait=False)
        library = ready_copy()
        assert library is not None
        built.append(library.parent)
        # The first one is in use, the others were entered years ago, one after the other.
        if number > 0:
            os.utime(library, (float(number), float(number)))

    left = {path for path in native_copy.copies_folder().iterdir() if path.is_dir()}
    # Of the years-old copies before the last build, the one in use and the newest stay.
    assert left == {built[0], *built[-KEPT:]}


def test_a_run_becomes_the_same_program_in_the_copy(
    sources: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    build(Part.TRAIN, wait=False)
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


@pytest.mark.parametrize("choice", ["on", "wait", "ready", "wire", "off"])
def test_a_run_in_real_time_enters_a_ready_copy_and_never_builds_one(
    choice: str, sources: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(native_copy.SWITCH, choice)
    entered: list[list[str]] = []
    monkeypatch.setattr(os, "execve", lambda path, words, env: entered.append(words))
    begun = started(monkeypatch)

    native_copy.enter("vobc", builds=False)
    assert begun == entered == []

    build(Part.TRAIN, wait=False)
    native_copy.enter("vobc", builds=False)
    assert len(entered) == (0 if choice in ("wire", "off") else 1)
    assert begun == []


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
    build(Part.TRAIN, wait=False)
    assert main(["--version", "-v"]) == 0

    _, wire, before, _, _, after = capsys.readouterr().out.splitlines()
    assert wire.startswith("codec, bus and logs: ")
    assert before == "controller: Python, not compiled yet"
    assert after == "controller: compiled"


def test_the_parts_have_copies_of_their_own(
    sources: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found = started(monkeypatch)
    build(Part.TRAIN, wait=False)

    assert ready_copy(Part.SIMULATOR) is None
    assert prepare("hil", part=Part.SIMULATOR) is None
    assert found[0][1:5] == ["-m", "metro_tools.compiled", "--part", "simulator"]
    assert "compiling the simulator in the background" in capsys.readouterr().err
    assert compiled.main(["--part", "simulator", "--wait"]) == 0
    assert capsys.readouterr().out == f"{ready_copy(Part.SIMULATOR)}\n"
    assert ready_copy(Part.SIMULATOR) != ready_copy(Part.TRAIN)


@pytest.mark.parametrize("patterns", [*MODULES.values(), QUICK])
def test_every_pattern_of_hot_modules_matches(patterns: tuple[str, ...]) -> None:
    folders = package_folders()

    for pattern in patterns:
        assert hot_modules(folders, [pattern]), pattern
    assert "zenoh_config/sessions.py" not in hot_modules(folders, patterns)


def test_c_files_are_compiled_in_units_and_only_some_are_optimised(tmp_path: Path) -> None:
    names = {"__native_vobc___one.c": 5, "__native_vobc___two.c": 4, "__native_vobc___wide.c": 9}
    sources = [tmp_path / name for name in (*names, "__native_0a.c")]
    for path in sources:
        path.write_bytes(b"x" * names.get(path.name, 1))

    found = units(sources, {"vobc/wide"}, unit_bytes=6)

    assert [(quick, [path.stem[9:] for path in paths]) for quick, paths in found] == [
        (True, ["vobc___wide"]),
        (False, ["vobc___one"]),
        (False, ["vobc___two", "0a"]),
    ]


def test_modules_with_equal_last_names_start_in_different_libraries() -> None:
    names = ["can_dbc.codec", "vobc.wire.frames", "zenoh_config.codec"]

    assert compiled.without_equal_last_names(names) == [names[:2], names[2:]]


def test_a_failed_step_of_the_build_names_the_program_and_its_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, c_compiler: str
) -> None:
    (tmp_path / "bad.c").write_text("int x = ;\n")
    with pytest.raises(CompileError, match=r"(?s)failed:.*bad.c:1.*error"):
        compiled._run_compiler(tmp_path, [c_compiler, "-c", "bad.c", "-o", "bad.o"])

    monkeypatch.setattr(compiled, "GENERATE", "raise SystemExit({modules!r})")
    with pytest.raises(CompileError, match=r"mypyc failed:\n\['vobc/one.py'\]"):
        compiled._generated(tmp_path, ["vobc/one.py"])


def test_a_worker_imports_from_the_copy_and_then_from_where_the_user_said(tmp_path: Path) -> None:
    assert worker_environment({"HOME": "x"}, tmp_path) == {
        "HOME": "x",
        "PYTHONPATH": str(tmp_path),
        "PYTHONSAFEPATH": "1",
    }
    assert worker_environment({"HOME": "x"}, None) == {"HOME": "x"}
    more = worker_environment({"PYTHONPATH": "/mine"}, tmp_path)
    assert more["PYTHONPATH"] == f"{tmp_path}{os.pathsep}/mine"
