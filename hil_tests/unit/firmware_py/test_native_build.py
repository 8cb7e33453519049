"""C code is built once into a folder of the user alone, and every reason against it is named."""

from pathlib import Path

import pytest

from firmware_py.native import build

SOURCES = {"tiny.c": b"int tiny;\n"}
COMPILER = """#!/bin/sh
echo call >>{calls}
while [ "$1" != -o ]; do shift; done
echo built >"$2"
"""


@pytest.fixture
def calls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The file in which a pretended compiler counts its calls; cache and PATH are empty else."""
    tools, counted = tmp_path / "tools", tmp_path / "calls"
    tools.mkdir()
    (tools / "cc").write_text(COMPILER.format(calls=counted))
    (tools / "cc").chmod(0o755)
    monkeypatch.setenv("PATH", f"{tools}:/usr/bin:/bin")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return counted


def test_a_library_is_built_once_for_each_content(calls: Path) -> None:
    first = build.library("tiny", SOURCES)
    again = build.library("tiny", SOURCES)
    other = build.library("tiny", {"tiny.c": b"int other;\n"})

    assert first == again != other
    assert first.read_text() == "built\n"
    assert calls.read_text().count("call") == 2
    assert [path.name for path in first.parent.iterdir() if path.is_dir()] == []


def test_a_compiled_wheel_brings_its_libraries(
    calls: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shipped = calls.parent / "metro_native"
    (shipped / "libraries").mkdir(parents=True)
    monkeypatch.setattr(build, "shipped_folder", lambda: shipped)
    name = build.library_name("tiny", SOURCES, build.FLAGS, ".so", build.here().machine)
    (shipped / "libraries" / name).write_text("shipped\n")

    assert build.library("tiny", SOURCES).read_text() == "shipped\n"
    assert build.library("tiny", {"tiny.c": b"int other;\n"}).read_text() == "built\n"


def test_a_failing_compiler_is_named_with_its_first_error(calls: Path) -> None:
    compiler = calls.parent / "tools" / "cc"
    compiler.write_text("#!/bin/sh\necho 'tiny.c:1: error: no such type' >&2; exit 1\n")

    with pytest.raises(build.BuildError, match=r"cc failed: tiny\.c:1: error: no such type"):
        build.library("tiny", SOURCES)


def test_without_a_compiler_the_error_says_what_to_install(
    calls: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(calls.parent))
    monkeypatch.setattr(build, "ZIG", "no_such_package")

    with pytest.raises(build.BuildError, match="install gcc or clang"):
        build.library("tiny", SOURCES)
    assert build.compiler() is None


def test_a_folder_that_others_can_write_to_is_refused(calls: Path) -> None:
    folder = build.cache_folder()
    folder.chmod(0o777)

    with pytest.raises(build.BuildError, match="others may write to it"):
        build.library("tiny", SOURCES)
    assert not calls.exists()


def test_a_file_that_is_no_module_is_an_error(calls: Path) -> None:
    with pytest.raises(build.BuildError, match="tiny"):
        build.extension("tiny", SOURCES)


def test_without_pythons_headers_no_module_is_built(
    calls: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sysconfig.get_path", lambda name: str(calls.parent))

    with pytest.raises(build.BuildError, match=r"has no Python\.h"):
        build.extension("tiny", SOURCES)
    assert not calls.exists()
