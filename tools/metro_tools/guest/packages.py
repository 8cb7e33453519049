"""Debian packages, downloaded and unpacked into a cache, without installation or root rights."""

import fcntl
import hashlib
import lzma
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from metro_tools.guest import qemu
from metro_tools.guest.debian_offers import PINNED, Package, offered, settle, sources_line
from metro_tools.guest.elf_interpreter import with_interpreter
from metro_tools.guest.initial_files import archive
from metro_tools.guest.kernel_modules import in_load_order, module_name
from metro_tools.guest.kernels import GuestKernel
from metro_tools.guest.plan import NoKernelError, library_names

TOOLBOX: Final = "toolbox"
EMULATOR: Final = "emulator"
PC_KERNEL_PACKAGE: Final = "linux-image-amd64"
EMULATOR_PACKAGES: Final = (
    *("qemu-system-x86", "qemu-system-common", "qemu-system-data", "seabios"),
)
LOADER: Final = "ld-linux-x86-64.so.2"
KEYRINGS: Final = (
    "/usr/share/keyrings/debian-archive-keyring.pgp",
    "/usr/share/keyrings/debian-archive-keyring.gpg",
)
TOOL_PACKAGES: Final = ("can-utils", "iproute2")
REQUIRED_MODULES: Final = ("overlay", "can-dev", "vcan", "can", "can-raw")
MODULES: Final = (
    *("ipv6", "overlay", "vcan", "vxcan", "slcan"),
    *("can", "can-raw", "can-bcm", "can-gw", "can-j1939"),
)
"""Modules to load. Modules built into a kernel have no file; only the required ones must have a
file."""
FETCH_TIMEOUT_S: Final = 600
DEPENDENCY_DEPTH_MAX: Final = 6

Say = Callable[[str], None]


def default_cache() -> Path:
    """Return the folder for the unpacked guest, below the user's cache directory."""
    base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(base) / "metro-bench" / "vcan-guest"


def parts_of(kernel: GuestKernel) -> tuple[str, ...]:
    """Return the folders of the cache that a guest with this kernel needs."""
    bundled = kernel is GuestKernel.QEMU and shutil.which(qemu.PROGRAM) is None
    return (kernel.value, TOOLBOX, *([EMULATOR] if bundled else []))


def fill_cache(cache: Path, kernel: GuestKernel, say: Say) -> None:
    """Ensure that the parts of this kernel are in the cache.

    An existing part is complete.

    Raises:
        NoKernelError: no apt, no such package, no network.
    """
    if all((cache / part).exists() for part in parts_of(kernel)):
        return
    for program in ("apt-get", "apt-cache", "dpkg-deb"):
        if shutil.which(program) is None:
            raise NoKernelError(
                f"{program} is missing: the guest's kernel is unpacked from Debian packages, so "
                "this takes a Debian 12 or later (a container of one is enough)"
            )
    try:
        cache.mkdir(parents=True, exist_ok=True)
        with _locked(cache / "lock"):
            for part in parts_of(kernel):
                if not (cache / part).exists():
                    _fill(cache, part, say)
    except OSError as error:
        raise NoKernelError(f"cannot write the cache {cache}: {error.strerror or error}") from error


def _fill(cache: Path, part: str, say: Say) -> None:
    for stale in cache.glob("new.*"):
        shutil.rmtree(stale, ignore_errors=True)
    new = Path(tempfile.mkdtemp(prefix="new.", dir=cache))
    try:
        FILLERS[part](_Apt(new / "apt", say), new / "deb", new / part)
        (new / part).rename(cache / part)
    finally:
        shutil.rmtree(new, ignore_errors=True)


def _fill_stock(apt: "_Apt", tree: Path, to: Path) -> None:
    apt.unpack(("user-mode-linux", "busybox-static"), tree)
    _arrange_user_mode(tree, to)


def _fill_newer(apt: "_Apt", tree: Path, to: Path) -> None:
    """Unpack the newer kernel with its own C library, because the host's may be too old."""
    apt.unpack(("busybox-static",), tree)
    apt.unstable().unpack_pinned(PINNED, tree)
    _arrange_user_mode(tree, to)
    shutil.copytree(_loader(tree).parent, to / "lib", symlinks=True)
    kernel = to / "linux"
    # A relative path, because the kernel starts in its own folder, which may be moved.
    kernel.write_bytes(with_interpreter(kernel.read_bytes(), f"lib/{LOADER}"))


def _fill_qemu(apt: "_Apt", tree: Path, to: Path) -> None:
    apt.unpack((*apt.needed_by(PC_KERNEL_PACKAGE, "linux-image-"), "busybox-static"), tree)
    _arrange(tree, to, (*MODULES, "can-isotp"))
    shutil.copy2(_only(tree, "boot", "vmlinuz-*"), to / "linux")
    early = _modules(tree, qemu.EARLY_MODULES)
    files = {f"modules/{name}": content for name, content in early.items()}
    files |= {"init": qemu.INIT.encode(), "bin/busybox": (to / "busybox").read_bytes()}
    (to / "initrd").write_bytes(archive(("bin", "modules", "proc", "root"), files))


def _fill_emulator(apt: "_Apt", tree: Path, to: Path) -> None:
    apt.unpack(apt.with_libraries(EMULATOR_PACKAGES), tree)
    merge_usr(tree)
    for part in ("bin", "lib", "share/qemu", "share/seabios"):
        shutil.copytree(tree / "usr" / part, to / part, symlinks=True)


def _fill_toolbox(apt: "_Apt", tree: Path, to: Path) -> None:
    apt.unpack(apt.with_libraries(TOOL_PACKAGES), tree)
    merge_usr(tree)
    tree.rename(to)


FILLERS: Final = {
    GuestKernel.STOCK.value: _fill_stock,
    GuestKernel.NEWER.value: _fill_newer,
    GuestKernel.QEMU.value: _fill_qemu,
    EMULATOR: _fill_emulator,
    TOOLBOX: _fill_toolbox,
}


def release(cache: Path, kernel: GuestKernel) -> str:
    """Return the version of a kernel in the cache, as from `uname -r`."""
    return (cache / kernel.value / "release").read_text().strip()


def _arrange_user_mode(tree: Path, to: Path) -> None:
    _arrange(tree, to, MODULES)
    shutil.copy2(_only(tree, "bin", "linux.uml"), to / "linux")


def _arrange(tree: Path, to: Path, modules: Sequence[str]) -> None:
    """Copy busybox, the modules and their release out of the unpacked packages."""
    (to / "modules").mkdir(parents=True)
    shutil.copy2(_only(tree, "bin", "busybox"), to / "busybox")
    found = _modules(tree, modules)
    for name, content in found.items():
        (to / "modules" / name).write_bytes(content)
    present = {module_name(name.partition("-")[2]) for name in found}
    if missing := [name for name in REQUIRED_MODULES if module_name(name) not in present]:
        raise NoKernelError(f"the kernel's package has no module {', '.join(missing)}")
    (to / "release").write_text(f"{next(tree.rglob('modules/*/kernel')).parent.name}\n")


def _modules(tree: Path, names: Sequence[str]) -> dict[str, bytes]:
    """Return file names and contents of the modules and all their dependencies.

    The number in a file's name makes a shell's * list them in load order.
    """
    files = {module_name(path.name): path for path in tree.rglob("*.ko*")}

    def content(name: str) -> bytes | None:
        if (path := files.get(name)) is None:
            return None
        packed = path.read_bytes()
        return lzma.decompress(packed) if path.suffix == ".xz" else packed

    found = in_load_order(names, content)
    return {f"{number}-{name}.ko": found[name] for number, name in enumerate(found, start=100)}


def _only(tree: Path, folder: str, name: str) -> Path:
    for path in tree.rglob(name):
        if path.is_file() and not path.is_symlink() and path.parent.name == folder:
            return path
    raise NoKernelError(f"the unpacked packages have no {folder}/{name}")


def _loader(tree: Path) -> Path:
    """Return the C library's dynamic loader; its folder is that of the library."""
    for path in tree.rglob(LOADER):
        if path.is_file() and path.with_name("libc.so.6").exists():
            return path
    raise NoKernelError(f"the package libc6 has no {LOADER}")


def merge_usr(tree: Path) -> None:
    """Move /bin, /sbin and /lib of a tree below /usr.

    The tree is mounted under a root where these are links; directories of that name would conflict.
    """
    for name in ("bin", "sbin", "lib"):
        source = tree / name
        if source.is_dir() and not source.is_symlink():
            shutil.copytree(source, tree / "usr" / name, symlinks=True, dirs_exist_ok=True)
            shutil.rmtree(source)


class _Apt:
    """The package tools, with own package lists in case the machine's are missing or too old."""

    def __init__(self, state: Path, say: Say) -> None:
        self._state = state
        self._say = say
        self._options: tuple[str, ...] = ("-q", "-o", "APT::Sandbox::User=root")

    def unstable(self) -> "_Apt":
        """Return the same tools for Debian unstable, from the mirror that this machine uses."""
        words = ["apt-get", *self._options, "indextargets", "--format", "$(REPO_URI)"]
        keyring = next((path for path in KEYRINGS if Path(path).exists()), None)
        return self.with_sources(sources_line(_call(words, Path("/")), keyring))

    def with_sources(self, text: str) -> "_Apt":
        """Return the same tools for other sources, whatever releases this machine has or
        prefers.
        """
        state = Path(tempfile.mkdtemp(prefix="apt.", dir=self._state.parent))
        other = _Apt(state, self._say)
        (state / "sources.list").write_text(text)
        for setting in (
            f"Dir::Etc::sourcelist={state / 'sources.list'}",
            *("Dir::Etc::sourceparts=/dev/null", "APT::Default-Release="),
            *("Dir::Etc::preferences=/dev/null", "Dir::Etc::preferencesparts=/dev/null"),
            "APT::Update::Error-Mode=any",
        ):
            other._options += ("-o", setting)
        other._update()
        return other

    def unpack(self, packages: Sequence[str], to: Path) -> None:
        """Download packages, which checks signatures and hashes, and unpack them."""
        self._say(f"downloading {_listed(packages)} (once)")
        debs = self._new_folder("debs.")
        fetch = ("-o", "Acquire::Retries=3", "download", *packages)
        try:
            self._get(fetch, debs)
        except NoKernelError:
            # Missing or outdated lists are the usual reason for a first failure.
            self._update()
            self._get(fetch, debs)
        _unpack_all(debs, to)

    def unpack_pinned(self, packages: Sequence[Package], to: Path) -> None:
        """Download the pinned versions or their successors, check their hashes, and unpack them."""
        taken = []
        for pinned in packages:
            shown = _call(["apt-cache", *self._options, "show", pinned.name], Path("/"))
            package, remark = settle(pinned, offered(pinned.name, shown))
            if remark:
                self._say(remark)
            taken.append(package)
        names = [f"{package.name}={package.version}" for package in taken]
        self._say(f"downloading {' '.join(names)} (once)")
        debs = self._new_folder("debs.")
        self._get(("-o", "Acquire::Retries=3", "download", *names), debs)
        for package in taken:
            (deb,) = debs.glob(f"{package.name}_*.deb")
            if hashlib.sha256(deb.read_bytes()).hexdigest() != package.sha256:
                raise NoKernelError(f"{deb.name} does not have SHA-256 {package.sha256}")
        _unpack_all(debs, to)

    def with_libraries(self, packages: Sequence[str]) -> list[str]:
        """Return the packages and, up to a depth limit, the libraries that they depend on."""
        known, new = set(packages), set(packages)
        for _ in range(DEPENDENCY_DEPTH_MAX):
            new = library_names(self._depends(sorted(new))) - known
            known |= new
            if not new:
                break
        return sorted(known)

    def needed_by(self, package: str, prefix: str) -> list[str]:
        """Return the packages with this prefix that a package depends on."""
        words = [line.split() for line in self._depends([package]).splitlines()]
        return [w[1] for w in words if w[:1] == ["Depends:"] and w[1].startswith(prefix)]

    def _depends(self, packages: Sequence[str]) -> str:
        words = ["apt-cache", *self._options, "depends", *packages]
        try:
            return _call(words, Path("/"))
        except NoKernelError:
            self._update()
            return _call(["apt-cache", *self._options, "depends", *packages], Path("/"))

    def _new_folder(self, prefix: str) -> Path:
        return Path(tempfile.mkdtemp(prefix=prefix, dir=self._state.parent))

    def _get(self, words: Sequence[str], directory: Path) -> None:
        _call(["apt-get", *self._options, *words], directory)

    def _update(self) -> None:
        """Fetch own package lists, because only root may change the machine's."""
        lists = self._state / "lists"
        (lists / "partial").mkdir(parents=True, exist_ok=True)
        self._say("fetching the lists of packages")
        self._options += ("-o", f"Dir::State::lists={lists}", "-o", f"Dir::Cache={self._state}")
        self._get(("update",), self._state)


def _listed(packages: Sequence[str]) -> str:
    libraries = [name for name in packages if name.startswith("lib")]
    others = " ".join(name for name in packages if name not in libraries)
    return f"{others} with {len(libraries)} libraries" if libraries else others


def _unpack_all(debs: Path, to: Path) -> None:
    for deb in sorted(debs.glob("*.deb")):
        _call(["dpkg-deb", "-x", str(deb), str(to)], to.parent)
    shutil.rmtree(debs)


def _call(words: Sequence[str], directory: Path) -> str:
    """Run a program and return its output; its error messages go into the exception."""
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
        raise NoKernelError(f"{words[0]} did not end within {FETCH_TIMEOUT_S} s") from error
    if done.returncode != 0:
        complaint = "\n  ".join((done.stderr or done.stdout).strip().splitlines()[-5:])
        short = " ".join(word for word in words if word[0] != "-" and "::" not in word)
        hint = "; is a mirror reachable?" if words[0] == "apt-get" else ""
        raise NoKernelError(f"{short} failed{hint}\n  {complaint}")
    return done.stdout


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold a lock file, so that simultaneous runs download only once."""
    with path.open("a") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
