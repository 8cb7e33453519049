"""Finds, starts and enters the copy of the programs with compiled modules in the user's cache.

The copy gives the same bytes, faster. It belongs to one state of the sources: any change of a file
asks for another copy. There is one for runs of trains and one for the line simulator. One
background process builds it; until it is ready, programs run the sources. VOBC_NATIVE chooses: `on`
(default) builds in the background, `wait` waits for the build, `ready` never builds but uses what
was built, `wire` uses C for codec, bus and logs only, and `off` runs Python alone.
"""

import enum
import fcntl
import hashlib
import importlib.util
import os
import subprocess
import sys
import sysconfig
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from firmware_py.native.build import CompileTarget, cache_folder, compiler, here, shipped_folder

SWITCH: Final = "VOBC_NATIVE"
PACKAGES: Final = (
    *("can_dbc", "canlog", "firmware_py", "metro_hil"),
    *("metro_tools", "plant_emulator", "vobc", "zenoh_config"),
)
BUILT: Final = (".so", ".pyc")
FOLDER: Final = "copies"
LIBRARY: Final = "lib"
"""Folder of the packages in a copy."""
FORMAT: Final = b"3"
"""Changes when the same sources are compiled in another way."""
EXIT_USAGE: Final = 2
ENTER: Final = "import sys; from metro_hil.cli.entry import {name}; sys.exit({name}())"


class Part(enum.Enum):
    """Parts of the programs for which there are copies."""

    TRAIN = "train"
    SIMULATOR = "simulator"


class Native(enum.Enum):
    """Values of VOBC_NATIVE."""

    OFF = "off"
    WIRE = "wire"
    READY = "ready"
    ON = "on"
    WAIT = "wait"


def native_choice() -> Native:
    """Return the user's choice. A value that is none ends the program with one line."""
    given = os.environ.get(SWITCH) or Native.ON.value
    try:
        return Native(given)
    except ValueError:
        names = ", ".join(each.value for each in Native)
        print(f"{SWITCH}={given}: no such choice; use one of {names}", file=sys.stderr)
        raise SystemExit(EXIT_USAGE) from None


def package_folders() -> dict[str, Path]:
    """Return the folder of each package, in a checkout or as installed."""
    found = {}
    for name in PACKAGES:
        spec = importlib.util.find_spec(name)
        assert spec is not None
        assert spec.submodule_search_locations is not None
        found[name] = Path(next(iter(spec.submodule_search_locations)))
    return found


def copies_folder() -> Path:
    """Return the folder of all copies. Raises OSError."""
    folder = cache_folder() / FOLDER
    folder.mkdir(mode=0o700, exist_ok=True)
    return folder


def sources_key(
    folders: Mapping[str, Path], part: Part, target: CompileTarget | None = None
) -> str:
    """Return the name of the copy for these sources, this part of them, and this Python.

    Extension modules fit every Python of the same minor version, so its other numbers do not count.
    """
    target = target or here()
    digest = hashlib.sha256(FORMAT + part.value.encode())
    digest.update(repr((sys.implementation.cache_tag, target.suffix, target.machine)).encode())
    for name, folder in sorted(folders.items()):
        for path in _files(folder):
            digest.update(f"{name}/{path.relative_to(folder)}\0".encode())
            digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()[:24]


def _files(folder: Path) -> Iterator[Path]:
    for place, folders, names in os.walk(folder):
        folders[:] = sorted(each for each in folders if each != "__pycache__")
        yield from (Path(place) / name for name in sorted(names) if not name.endswith(BUILT))


def ready_copy(part: Part = Part.TRAIN) -> Path | None:
    """Return the packages of the copy that fits the sources; None until it is built."""
    key = sources_key(package_folders(), part)
    shipped = shipped_folder()
    if shipped is not None and (shipped / FOLDER / key / LIBRARY).is_dir():
        return shipped / FOLDER / key / LIBRARY
    try:
        library = copies_folder() / key / LIBRARY
        if not library.is_dir():
            return None
        os.utime(library)
    except OSError:
        return None
    return library


def usable_copy() -> Path | None:
    """Return the packages of the copy of the train if the user wants it and it is ready."""
    return None if native_choice() in (Native.OFF, Native.WIRE) else ready_copy()


def missing_tools() -> str:
    """Return what the build needs and this installation lacks; an empty text if nothing."""
    if compiler() is None:
        return "no C compiler"
    if not (Path(sysconfig.get_path("include")) / "Python.h").is_file():
        return "no headers of Python"
    for name in ("mypyc", "setuptools"):
        if importlib.util.find_spec(name) is None:
            return f"no {name}; `pip install '.[native]'` brings it"
    return ""


@contextmanager
def build_lock(*, wait: bool) -> Iterator[bool]:
    """Hold the right to build within the block; yield False if another process has it."""
    with (copies_folder() / "lock").open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except BlockingIOError:
            yield False
            return
        yield True


def being_built() -> bool:
    with build_lock(wait=False) as free:
        return not free


def failure_file(key: str) -> Path:
    """Return the file with the reason why the copy of these sources could not be built."""
    return copies_folder() / f"{key}.failed"


def prepare(program: str, *, part: Part = Part.TRAIN, choice: Native | None = None) -> Path | None:
    """Return the copy if it is ready; else start its build or, if the user asked so, wait for it.

    A build that failed is not tried again before the sources change.
    """
    choice = choice or native_choice()
    if choice in (Native.OFF, Native.WIRE):
        return None
    library = ready_copy(part)
    if library is not None or choice is Native.READY or missing_tools():
        return library
    name = "simulator" if part is Part.SIMULATOR else "controller"
    try:
        if failure_file(sources_key(package_folders(), part)).exists():
            return None
        if choice is Native.WAIT:
            print(f"{program}: waiting for the compiled {name}", file=sys.stderr, flush=True)
            subprocess.run(_builder(part, "--wait"), check=False, env=_environment())
            return ready_copy(part)
        if not being_built():
            print(
                f"{program}: compiling the {name} in the background; later runs are faster"
                f" ({SWITCH}=wire: never)",
                file=sys.stderr,
                flush=True,
            )
            _start(part)
    except OSError:
        # Without a cache there is no copy; the sources do the same.
        return None
    return None


def worker_environment(environment: Mapping[str, str], library: Path | None) -> dict[str, str]:
    """Environment of a worker that imports these packages from the copy, and others from where
    the user said; unchanged if there is no copy."""
    if library is None:
        return dict(environment)
    paths = [str(library), *filter(None, [environment.get("PYTHONPATH")])]
    return {**environment, "PYTHONPATH": os.pathsep.join(paths), "PYTHONSAFEPATH": "1"}


def _builder(part: Part, *options: str) -> list[str]:
    return [sys.executable, "-m", "metro_tools.compiled", "--part", part.value, *options]


def _environment() -> dict[str, str]:
    return {**os.environ, SWITCH: Native.WIRE.value}


def _start(part: Part) -> None:
    """Start the build in a session of its own, which outlives this program and its terminal."""
    silent = subprocess.DEVNULL
    subprocess.Popen(
        _builder(part),
        stdin=silent,
        stdout=silent,
        stderr=silent,
        env=_environment(),
        start_new_session=True,
    )


def enter(program: str, part: Part = Part.TRAIN, *, builds: bool = True) -> None:
    """Go on in the copy if it is ready: this process becomes the same program there.

    Args:
        builds: a copy that is missing may be built now.
    """
    choice = native_choice()
    if not builds and choice in (Native.ON, Native.WAIT):
        choice = Native.READY
    library = prepare(program, part=part, choice=choice)
    if library is None:
        return
    os.execve(  # noqa: S606 - our own interpreter and program
        sys.executable,
        [sys.executable, "-c", ENTER.format(name=program), *sys.argv[1:]],
        worker_environment(_environment(), library),
    )


def controller_text() -> str:
    """Say in one line how runs in virtual time execute the controller."""
    choice = native_choice()
    if choice in (Native.OFF, Native.WIRE):
        return f"Python ({SWITCH}={choice.value})"
    if ready_copy() is not None:
        return "compiled"
    if choice is Native.READY:
        return f"Python, not compiled ({SWITCH}={choice.value})"
    if lack := missing_tools():
        return f"Python ({lack})"
    try:
        failed = failure_file(sources_key(package_folders(), Part.TRAIN))
        if failed.exists():
            return f"Python (the build failed: {failed})"
        return "Python, compiled in the background" if being_built() else "Python, not compiled yet"
    except OSError as error:
        return f"Python ({error})"
