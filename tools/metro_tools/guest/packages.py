"""Debian packages, fetched and unpacked into a cache; installs nothing and needs no rights."""

import fcntl
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from metro_tools.guest.plan import GuestError, library_names

KERNEL_PACKAGES: Final = ("user-mode-linux", "busybox-static")
TOOL_PACKAGES: Final = ("can-utils", "iproute2")
REQUIRED_MODULES: Final = ("overlay", "can-dev", "vcan", "can", "can-raw")
MODULES: Final = (
    *("crc-ccitt", "ipv6", "overlay", "can-dev", "vcan", "vxcan", "slcan"),
    *("can", "can-raw", "can-bcm", "can-gw", "can-j1939"),
)
"""In the order to load. What a kernel has built in has no file; only the required must have one."""
FETCH_TIMEOUT_S: Final = 600
DEPENDENCY_DEPTH_MAX: Final = 6

Say = Callable[[str], None]


def default_cache() -> Path:
    """Where the unpacked guest is kept: below the user's cache directory."""
    base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(base) / "metro-bench" / "vcan-guest"


def fill_cache(cache: Path, say: Say) -> None:
    """Make sure `kernel` and `toolbox` are in the cache and whole.

    Raises:
        GuestError: no apt, no such package, no network.
    """
    if (cache / "complete").exists():
        return
    for program in ("apt-get", "apt-cache", "dpkg-deb"):
        if shutil.which(program) is None:
            raise GuestError(
                f"{program} is missing: the guest's kernel is unpacked from Debian packages, so "
                "this takes a Debian 12 or later (a container of one is enough)"
            )
    try:
        cache.mkdir(parents=True, exist_ok=True)
        with _locked(cache / "lock"):
            if not (cache / "complete").exists():
                _fill(cache, say)
    except OSError as error:
        raise GuestError(f"cannot write the cache {cache}: {error.strerror or error}") from error


def _fill(cache: Path, say: Say) -> None:
    for stale in (*cache.glob("new.*"), *(cache / part for part in ("kernel", "toolbox"))):
        shutil.rmtree(stale, ignore_errors=True)
    new = Path(tempfile.mkdtemp(prefix="new.", dir=cache))
    try:
        apt = _Apt(cache / "apt", say)
        apt.unpack(KERNEL_PACKAGES, new / "deb")
        _arrange_kernel(new / "deb", new / "kernel")
        apt.unpack(apt.with_libraries(TOOL_PACKAGES), new / "toolbox")
        merge_usr(new / "toolbox")
        (new / "kernel").rename(cache / "kernel")
        (new / "toolbox").rename(cache / "toolbox")
    finally:
        shutil.rmtree(new, ignore_errors=True)
        shutil.rmtree(cache / "apt", ignore_errors=True)
    (cache / "complete").touch()


def _arrange_kernel(tree: Path, to: Path) -> None:
    """Copy the kernel, busybox and the modules out of the unpacked packages."""
    (to / "modules").mkdir(parents=True)
    shutil.copy2(_only(tree, "linux.uml"), to / "linux")
    shutil.copy2(_only(tree, "busybox"), to / "busybox")
    for number, name in enumerate(MODULES, start=100):
        found = next(tree.rglob(f"{name}.ko"), None)
        if found is not None:
            # The number makes a shell's * give them in the order to load.
            shutil.copy2(found, to / "modules" / f"{number}-{name}.ko")
        elif name in REQUIRED_MODULES:
            raise GuestError(
                f"the package user-mode-linux has no module {name}; Debian 12's has it"
            )


def _only(tree: Path, name: str) -> Path:
    for path in tree.rglob(name):
        if path.is_file() and not path.is_symlink() and path.parent.name == "bin":
            return path
    raise GuestError(f"no program {name} in the packages {', '.join(KERNEL_PACKAGES)}")


def merge_usr(tree: Path) -> None:
    """Move /bin, /sbin and /lib of a tree below /usr.

    The tree is laid under a root where these are links; directories of that name would clash.
    """
    for name in ("bin", "sbin", "lib"):
        source = tree / name
        if source.is_dir() and not source.is_symlink():
            shutil.copytree(source, tree / "usr" / name, symlinks=True, dirs_exist_ok=True)
            shutil.rmtree(source)


class _Apt:
    """The package tools, with lists of their own for when the machine's are missing or too old."""

    def __init__(self, state: Path, say: Say) -> None:
        self._state = state
        self._say = say
        self._options: tuple[str, ...] = ("-q", "-o", "APT::Sandbox::User=root")

    def unpack(self, packages: Sequence[str], to: Path) -> None:
        """Download, which checks signatures and hashes, and unpack."""
        self._say(f"downloading {' '.join(packages)} (once)")
        debs = Path(tempfile.mkdtemp(prefix="debs.", dir=to.parent))
        fetch = ("-o", "Acquire::Retries=3", "download", *packages)
        try:
            self._get(fetch, debs)
        except GuestError:
            # Lists that are missing or out of date are the usual reason for a first failure.
            self._update()
            self._get(fetch, debs)
        for deb in sorted(debs.glob("*.deb")):
            _call(["dpkg-deb", "-x", str(deb), str(to)], to.parent)
        shutil.rmtree(debs)

    def with_libraries(self, packages: Sequence[str]) -> list[str]:
        """The packages and, over a few steps, the libraries that they depend on."""
        known, new = set(packages), set(packages)
        for _ in range(DEPENDENCY_DEPTH_MAX):
            text = _call(["apt-cache", *self._options, "depends", *sorted(new)], Path("/"))
            new = library_names(text) - known
            known |= new
            if not new:
                break
        return sorted(known)

    def _get(self, words: Sequence[str], directory: Path) -> None:
        _call(["apt-get", *self._options, *words], directory)

    def _update(self) -> None:
        """Fetch package lists of our own: the machine's may be changed by root only."""
        lists = self._state / "lists"
        (lists / "partial").mkdir(parents=True, exist_ok=True)
        self._say("fetching the lists of packages")
        self._options += ("-o", f"Dir::State::lists={lists}", "-o", f"Dir::Cache={self._state}")
        self._get(("update",), self._state)


def _call(words: Sequence[str], directory: Path) -> str:
    """Run a program and return what it says; what it complains of goes into the error."""
    environment = {**os.environ, "LC_ALL": "C.UTF-8"}
    try:
        done = subprocess.run(  # noqa: S603 # fixed programs, no shell
            words,
            cwd=directory,
            env=environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=FETCH_TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise GuestError(f"{words[0]} did not end within {FETCH_TIMEOUT_S} s") from error
    if done.returncode != 0:
        complaint = "\n  ".join((done.stderr or done.stdout).strip().splitlines()[-5:])
        raise GuestError(f"{' '.join(words)} failed:\n  {complaint}")
    return done.stdout


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold a lock file, so that runs that start together download once."""
    with path.open("a") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
