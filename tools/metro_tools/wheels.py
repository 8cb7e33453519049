"""Builds wheels with compiled code: programs run at full speed where there is no C compiler.

A wheel brings the packages as they are, and beside them `metro_native`: the copies with compiled
modules, and the libraries in C. Programs find both by the hash of their sources. `ziglang` compiles
for each machine, against an old glibc, so that the wheels suit old distributions, too.
"""

import argparse
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Final, NamedTuple

from can_dbc import c_source
from canlog.kernel import FLAGS as KERNEL_FLAGS
from canlog.kernel import STEM as KERNEL
from firmware_py.assertions import require_assertions
from firmware_py.native.build import (
    FLAGS,
    LIBRARIES,
    SHIPPED,
    ZIG,
    BuildError,
    CompileTarget,
    compile_library,
    library_name,
)
from firmware_py.native.core import STEM as CORE
from firmware_py.native.core import core_sources
from metro_hil.model.native_copy import FOLDER, LIBRARY, PACKAGES, Part, sources_key
from metro_tools.compiled import CompileError, compile_into, copy_sources

MACHINES: Final = ("x86_64", "aarch64")
GLIBC: Final = (2, 17)
"""Version of glibc that a machine needs at least, as with `manylinux2014`."""
CONFIG: Final = "pyconfig.h"
CODEC: Final = "codec"
NOTE: Final = (
    '"""Compiled code of these packages, which programs find by the hash of their sources."""\n'
)
EXIT_ENVIRONMENT: Final = 3


class WheelError(Exception):
    """A wheel cannot be built; the text gives the reason."""


class CLibrary(NamedTuple):
    """Source of a library in C.

    Attributes:
        stem: name of the file that is compiled, without its ending.
        sources: content of each file by its name.
        flags: flags for the compiler.
        of_python: whether Python imports the library; else ctypes loads it.
    """

    stem: str
    sources: dict[str, bytes]
    flags: tuple[str, ...]
    of_python: bool


def c_libraries() -> list[CLibrary]:
    """Return codec, bus with logs, and the kernel of canlog."""
    kernel = (resources.files("canlog") / f"{KERNEL}.c").read_bytes()
    return [
        CLibrary(CODEC, dict(c_source.sources()), FLAGS, True),
        CLibrary(CORE, dict(core_sources()), FLAGS, True),
        CLibrary(KERNEL, {f"{KERNEL}.c": kernel}, KERNEL_FLAGS, False),
    ]


def target_of(machine: str, headers: Path) -> CompileTarget:
    """Return the compiler for Linux on this machine, with these headers of Python."""
    command = (sys.executable, "-m", ZIG, "cc", "-target", f"{machine}-linux-gnu.{_glibc('.')}")
    tag = sys.implementation.cache_tag
    return CompileTarget(command, machine, f".{tag}-{machine}-linux-gnu.so", str(headers))


def _glibc(between: str) -> str:
    return between.join(str(number) for number in GLIBC)


def build_wheel(checkout: Path, machine: str, out: Path) -> Path:
    """Build the wheel for this machine, and return its path.

    Args:
        checkout: folder with `pyproject.toml`.
        machine: one of `MACHINES`.
        out: folder for the wheel; it is created.

    Raises WheelError, CompileError, BuildError and OSError.
    """
    with tempfile.TemporaryDirectory() as scratch:
        place = Path(scratch)
        target = target_of(machine, _copy_headers(place / "headers"))
        _run("pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", place, checkout)
        (plain,) = place.glob("*.whl")
        _run("wheel", "unpack", "--dest", place / "unpacked", plain)
        (folder,) = (place / "unpacked").iterdir()
        _add_native(folder, target, place)
        plain.unlink()
        _run("wheel", "pack", "--dest-dir", place, folder)
        (packed,) = place.glob("*.whl")
        python = sys.implementation.cache_tag.replace("cpython-", "cp")
        platform = f"manylinux_{_glibc('_')}_{machine}"
        tags = ("--python-tag", python, "--abi-tag", python, "--platform-tag", platform)
        _run("wheel", "tags", "--remove", *tags, packed)
        (made,) = place.glob("*.whl")
        out.mkdir(parents=True, exist_ok=True)
        return Path(shutil.move(made, out / made.name))


def _copy_headers(folder: Path) -> Path:
    """Copy the headers of this Python. They suit all machines with 64-bit addresses.

    Debian's `pyconfig.h` includes one from a folder for this machine; the copy has that one itself.
    """
    headers = Path(sysconfig.get_path("include"))
    shutil.copytree(headers, folder)
    real = headers.parent / str(sysconfig.get_config_var("MULTIARCH")) / headers.name / CONFIG
    if real.is_file():
        shutil.copyfile(real, folder / CONFIG)
    return folder


def _add_native(folder: Path, target: CompileTarget, scratch: Path) -> None:
    """Add `metro_native` to an unpacked wheel."""
    native = folder / SHIPPED
    libraries = native / LIBRARIES
    libraries.mkdir(parents=True)
    (native / "__init__.py").write_text(NOTE, encoding="utf-8")
    for each in c_libraries():
        suffix = target.suffix if each.of_python else ".so"
        flags = [*each.flags, f"-I{target.headers}"] if each.of_python else [*each.flags]
        name = library_name(each.stem, each.sources, each.flags, suffix, target.machine)
        compile_library(target.command, each.stem, each.sources, flags, libraries / name)
    packages = {name: folder / name for name in PACKAGES}
    for part in Part:
        # Apart from the wheel's packages: mypyc would take the copy for a part of them.
        copy = scratch / part.value / LIBRARY
        copy_sources(packages, copy)
        compile_into(copy, part, target)
        _replace_links(copy)
        shutil.move(copy, native / FOLDER / sources_key(packages, part, target) / LIBRARY)


def _replace_links(copy: Path) -> None:
    """Replace links by the files they point to, because a wheel has no links."""
    for path in copy.rglob("*.so"):
        if path.is_symlink():
            content = path.read_bytes()
            path.unlink()
            path.write_bytes(content)


def _run(*words: str | Path) -> None:
    done = subprocess.run(  # noqa: S603 - our own interpreter
        [sys.executable, "-m", *map(str, words)], capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        lines = (done.stderr or done.stdout).strip().splitlines() or ["no message"]
        raise WheelError(f"{words[0]} {words[1]} failed: {lines[-1]}")


def main(argv: Sequence[str] | None = None) -> int:
    """Build the wheels; a missing tool gives one message."""
    require_assertions("wheels")
    parser = argparse.ArgumentParser(prog="python -m metro_tools.wheels", description=__doc__)
    parser.add_argument("--machine", choices=MACHINES, action="append", help="default: all")
    parser.add_argument("--out", type=Path, default=Path("dist"), help="folder for the wheels")
    options = parser.parse_args(argv)
    try:
        for machine in options.machine or MACHINES:
            made = build_wheel(Path.cwd(), machine, options.out)
            print(f"{made}: {made.stat().st_size / 1e6:.1f} MB", flush=True)
    except (WheelError, CompileError, BuildError, OSError) as error:
        print(f"wheels: {error}", file=sys.stderr)
        return EXIT_ENVIRONMENT
    return 0


if __name__ == "__main__":
    sys.exit(main())
