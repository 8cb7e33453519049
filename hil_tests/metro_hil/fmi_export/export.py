"""Builds the FMU of a train or a controller: shim, descriptions, command and hello."""

import functools
import json
import platform
import subprocess
import sys
import tempfile
import uuid
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from firmware_py import __version__
from firmware_py.native.build import BuildError, compiler
from firmware_py.storage.whole_file import whole_file
from metro_hil.fmi_export.descriptions import manifest, model_description, terminals

SHIM: Final = Path(__file__).with_name("shim.c")
COMPILE_S: Final = 120.0
MANIFEST: Final = "extra/org.fmi-standard.fmi-ls-bus/fmi-ls-manifest.xml"
SYSTEMS: Final[Mapping[str, tuple[str, str]]] = {
    "linux": ("linux", ".so"),
    "darwin": ("darwin", ".dylib"),
}
"""Name of the system and suffix of libraries in FMI 3.0, by that of Python."""


def write_fmu(
    path: Path,
    name: str,
    words: Sequence[str],
    told: Mapping[str, Any],
    truth: Sequence[str] = (),
) -> None:
    """Write an FMU for this machine. Raises BuildError and OSError.

    Args:
        name: model name and identifier.
        words: command of the program.
        told: content of its hello.
        truth: names of the truth signals in its yields.
    """
    hello = json.dumps({"type": "hello", "version": 1, "told": told}, sort_keys=True)
    # Equal content has an equal token, so that equal exports are equal files.
    token = str(uuid.uuid5(uuid.NAMESPACE_OID, "\n".join([name, *words, hello, *truth])))
    folder, suffix = binaries_folder()
    files: dict[str, bytes] = {
        "modelDescription.xml": model_description(
            name, token, truth, f"metro-vobc-bench {__version__}"
        ).encode(),
        "terminalsAndIcons/terminalsAndIcons.xml": terminals().encode(),
        MANIFEST: manifest().encode(),
        "resources/command.txt": "".join(f"{word}\n" for word in words).encode(),
        "resources/hello.json": hello.encode(),
        "resources/token.txt": token.encode(),
        f"{folder}/{name}{suffix}": _library(),
    }
    with whole_file(path) as place, zipfile.ZipFile(place, "w", zipfile.ZIP_DEFLATED) as fmu:
        for member, content in files.items():
            fmu.writestr(zipfile.ZipInfo(member), content, zipfile.ZIP_DEFLATED)


def binaries_folder() -> tuple[str, str]:
    """Folder of this machine's libraries in an FMU of FMI 3.0, and their suffix."""
    machine = platform.machine().lower()
    processor = "aarch64" if machine in ("aarch64", "arm64") else "x86_64"
    if sys.platform not in SYSTEMS:
        raise BuildError(f"FMUs cannot be built on {sys.platform}; use Linux or macOS")
    system, suffix = SYSTEMS[sys.platform]
    return f"binaries/{processor}-{system}", suffix


@functools.cache
def _library() -> bytes:
    """The shim, compiled once in a process."""
    command = compiler()
    if command is None:
        raise BuildError("no C compiler; install gcc or clang, or `pip install ziglang`")
    with tempfile.TemporaryDirectory(prefix="fmu-") as folder:
        made = Path(folder) / "shim"
        flags = ("-std=c11", "-O2", "-w", "-fPIC", "-shared")
        done = subprocess.run(
            [*command, *flags, str(SHIM), "-o", str(made), "-lm"],
            check=False,
            capture_output=True,
            text=True,
            timeout=COMPILE_S,
        )
        if done.returncode != 0:
            lines = done.stderr.splitlines()
            fault = next((line for line in lines if "error" in line), "no message")
            raise BuildError(f"{command[0]} failed: {fault}")
        return made.read_bytes()
