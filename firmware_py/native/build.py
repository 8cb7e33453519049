"""Builds C code into the user's cache: a library for each content of its sources, built once.

Without a C compiler, or without a folder to build in, there is no library, and the callers use
their Python code, which gives the same results.
"""

import hashlib
import importlib.util
import os
import platform
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Final, NamedTuple

FLAGS: Final = ("-O2", "-shared", "-fPIC", "-std=gnu11", "-ffp-contract=off", "-fno-math-errno")
"""Compiler flags. Without contraction a product and a sum round twice, as in Python."""
COMPILERS: Final = ("cc", "gcc", "clang")
COMPILE_S: Final = 180
"""Greatest duration of a build. The first call of zig builds its own libraries, too."""
ZIG: Final = "ziglang"
"""Python package with a C compiler, for machines without one."""
FOLDER: Final = "metro-bench"
"""Folder in the user's cache."""
SHIPPED: Final = "metro_native"
"""Package with ready code, which compiled wheels bring."""
LIBRARIES: Final = "libraries"
"""Its folder of libraries."""


class BuildError(Exception):
    """A library cannot be built; the text gives the reason."""


class CompileTarget(NamedTuple):
    """A compiler, and the machine and Python for which it compiles.

    Attributes:
        command: the compiler's name and first arguments.
        machine: name of the processor as `uname -m` prints it.
        suffix: ending of the file names of extension modules, with its dot.
        headers: folder of Python's headers, whether they are there or not.
    """

    command: tuple[str, ...]
    machine: str
    suffix: str
    headers: str


def here(command: tuple[str, ...] = ()) -> CompileTarget:
    """Return this machine and this Python."""
    suffix = sysconfig.get_config_var("EXT_SUFFIX") or ".so"
    return CompileTarget(command, platform.machine(), suffix, sysconfig.get_path("include"))


def shipped_folder() -> Path | None:
    """Return the folder of ready code in a compiled wheel; None if the installation has none."""
    spec = importlib.util.find_spec(SHIPPED)
    if spec is None or not spec.submodule_search_locations:
        return None
    return Path(next(iter(spec.submodule_search_locations)))


def compiler() -> tuple[str, ...] | None:
    """Return the command of the C compiler; None if there is none."""
    found = next((path for name in COMPILERS if (path := shutil.which(name))), None)
    if found is not None:
        return (found,)
    if importlib.util.find_spec(ZIG) is not None:
        return (sys.executable, "-m", ZIG, "cc")
    return None


def cache_folder() -> Path:
    """Return a cache folder that only this user can write to: programs run what they load from it.

    Raises OSError if there is none.
    """
    base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    folder = Path(base) / FOLDER
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    state = folder.stat()
    if state.st_uid != os.getuid() or state.st_mode & 0o022:
        raise OSError(f"{folder}: others may write to it")
    return folder


def library_name(
    stem: str, sources: Mapping[str, bytes], flags: Sequence[str], suffix: str, machine: str
) -> str:
    """Return the file name of the library: it changes with its sources, flags and machine."""
    mark = hashlib.sha256(repr((sorted(sources.items()), flags, machine)).encode())
    return f"{stem}-{mark.hexdigest()[:16]}{suffix}"


def library(
    stem: str,
    sources: Mapping[str, bytes],
    flags: Sequence[str] = FLAGS,
    suffix: str = ".so",
    include: str = "",
) -> Path:
    """Return the shared library of these sources: from a compiled wheel, from the cache, or built.

    Args:
        stem: begin of the library's name. The source `{stem}.c` is compiled; the others are
            headers.
        sources: content of each file by its name.
        flags: flags for the compiler.
        suffix: ending of the library's file name.
        include: folder of Python's headers, if the sources need them.

    Raises BuildError.
    """
    name = library_name(stem, sources, flags, suffix, platform.machine())
    shipped = shipped_folder()
    if shipped is not None and (shipped / LIBRARIES / name).is_file():
        return shipped / LIBRARIES / name
    if include and not (Path(include) / "Python.h").is_file():
        raise BuildError(f"{include}: has no Python.h; install the headers of Python")
    try:
        path = cache_folder() / name
        if not path.is_file():
            command = compiler()
            if command is None:
                raise BuildError("no C compiler; install gcc or clang, or `pip install ziglang`")
            compile_library(command, stem, sources, _with_include(flags, include), path)
    except (OSError, subprocess.TimeoutExpired, RuntimeError) as error:
        raise BuildError(str(error)) from error
    return path


def _with_include(flags: Sequence[str], include: str) -> list[str]:
    return [*flags, f"-I{include}"] if include else [*flags]


def extension(stem: str, sources: Mapping[str, bytes]) -> ModuleType:
    """Build an extension module of this Python and import it. Raises BuildError."""
    python = here()
    path = library(stem, sources, FLAGS, python.suffix, python.headers)
    spec = importlib.util.spec_from_file_location(stem, path)
    assert spec is not None
    assert spec.loader is not None
    try:
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    except ImportError as error:
        raise BuildError(f"{path}: {error}") from error
    return module


def compile_library(
    command: Sequence[str],
    stem: str,
    sources: Mapping[str, bytes],
    flags: Sequence[str],
    path: Path,
) -> None:
    """Compile in a folder of its own, so that another process never sees half a file.

    Raises BuildError.
    """
    with tempfile.TemporaryDirectory(dir=path.parent) as place:
        folder = Path(place)
        for name, content in sources.items():
            (folder / name).write_bytes(content)
        made = folder / path.name
        done = subprocess.run(  # noqa: S603 - a compiler and our own sources
            [*command, *flags, str(folder / f"{stem}.c"), "-o", str(made), "-lm"],
            check=False,
            capture_output=True,
            text=True,
            timeout=COMPILE_S,
        )
        if done.returncode != 0:
            lines = done.stderr.splitlines()
            fault = next((line for line in lines if "error" in line), "no message")
            raise BuildError(f"{command[0]} failed: {fault}")
        made.replace(path)
