"""Settings of a guest before it boots: memory, kernel arguments, scripts. Pure."""

import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import PurePath
from typing import Final

MIB: Final = 1024 * 1024
MEMORY_LEAST_MIB: Final = 384
"""Minimum memory for Python with numpy beside the kernel."""
MEMORY_MARGIN_MIB: Final = 64
"""Memory left free in the file system of the guest's memory, for its other users."""
KILL_GRACE_S: Final = 10
"""Time from SIGTERM at the command's time limit to SIGKILL."""
C_LIBRARY: Final = ("libc6", "libgcc", "libcrypt1")
INTERFACE_NAME_MAX: Final = 15
"""IFNAMSIZ minus the terminating zero."""


class GuestError(Exception):
    """Why there is no guest; the text says what to do about it."""


class NoKernelError(GuestError):
    """One kernel is unavailable or does not boot.

    The command has not begun, and another kernel may work.
    """


class Engine(Enum):
    """Program that runs the guest's kernel; the value is that of `VCAN_GUEST` in the guest."""

    UML = "uml"
    QEMU = "qemu"


@dataclass(frozen=True, slots=True)
class GuestRequest:
    """The command that runs in the guest, and its environment."""

    command: tuple[str, ...]
    directory: str
    """Working directory, the same inside and outside."""
    environment: Mapping[str, str]
    umask: int
    interfaces: tuple[str, ...]
    """Virtual CAN interfaces that are up before the command starts."""
    writable: tuple[str, ...]
    """Directories whose changes reach the host; all other writes go to memory."""
    timeout_s: int
    """Time limit; 0: none."""
    hostname: str
    one_stream: bool
    """Standard output and standard error go to the same place and must keep their order."""


@dataclass(frozen=True, slots=True)
class MemoryPlace:
    """A file system that could hold the guest's memory."""

    path: str
    kind: str
    """File system type as in /proc/mounts."""
    executable: bool
    free_mib: int


@dataclass(frozen=True, slots=True)
class GuestFolders:
    """Locations of the unpacked guest and of the files of this run."""

    engine: Engine
    kernel: PurePath
    busybox: PurePath
    modules: PurePath
    toolbox: PurePath
    run_dir: PurePath
    libraries: PurePath | None = None
    """Shared libraries that the kernel or its emulator uses instead of the host's."""
    emulator: PurePath | None = None
    """Program that emulates a PC."""
    firmware: Sequence[PurePath] = ()
    """Directories with the PC's firmware; empty: the emulator's defaults."""


def choose_memory(places: Iterable[MemoryPlace], wanted_mib: int) -> tuple[MemoryPlace, int]:
    """Choose location and size (MiB) of the guest's memory.

    User-mode Linux maps its memory from a file and runs code in it, so it needs a tmpfs that is not
    mounted noexec. The first place with the full size is used, otherwise the largest one.

    Raises:
        NoKernelError: no place is usable; the text lists each with its reason.
    """
    usable: list[tuple[int, MemoryPlace]] = []
    refused: list[str] = []
    for place in places:
        room_mib = place.free_mib - MEMORY_MARGIN_MIB
        if place.kind != "tmpfs":
            refused.append(f"{place.path} is not a tmpfs")
        elif not place.executable:
            refused.append(f"{place.path} is mounted noexec")
        elif room_mib < MEMORY_LEAST_MIB:
            refused.append(f"{place.path} has only {place.free_mib} MiB free")
        else:
            usable.append((room_mib, place))
    if not usable:
        raise NoKernelError(
            f"no room for the guest's memory: {'; '.join(refused) or 'there is no tmpfs'}. "
            f"It takes {MEMORY_LEAST_MIB + MEMORY_MARGIN_MIB} MiB or more of an executable tmpfs; "
            "with Docker: --tmpfs /dev/shm:rw,exec,size=3g"
        )
    for room_mib, place in usable:
        if room_mib >= wanted_mib:
            return place, wanted_mib
    room_mib, place = max(usable, key=lambda pair: pair[0])
    return place, room_mib


def emulated_memory_mib(available_mib: int, wanted_mib: int) -> int:
    """Return how many MiB of the machine's available memory an emulated PC gets.

    Raises:
        NoKernelError: too little is available.
    """
    room_mib = available_mib - MEMORY_MARGIN_MIB
    if room_mib < MEMORY_LEAST_MIB:
        raise NoKernelError(
            f"only {available_mib} MiB of memory are available; an emulated PC takes "
            f"{MEMORY_LEAST_MIB + MEMORY_MARGIN_MIB} MiB or more"
        )
    return min(room_mib, wanted_mib)


def interface_name_fault(name: str) -> str | None:
    """Return why the kernel would refuse a network interface of this name; None if it would not."""
    if not name:
        return "an interface name cannot be empty"
    if len(name.encode()) > INTERFACE_NAME_MAX:
        return f"{name!r} has {len(name.encode())} bytes; the kernel takes {INTERFACE_NAME_MAX}"
    if name in (".", "..") or any(c in "/:%" or c.isspace() or not c.isprintable() for c in name):
        return f"{name!r} is not an interface name: no blanks, '/', ':' or '%' in it"
    if name.startswith("-"):
        return f"{name!r} would be taken for an option"
    return None


def kernel_arguments(
    machine: GuestFolders, memory_mib: int, control: tuple[int, int], streams: Sequence[int]
) -> list[str]:
    """Return the command line of the user-mode kernel.

    Args:
        machine: its `run_dir` must not contain blanks, which separate kernel arguments.
        memory_mib: the chosen size.
        control: descriptors to read orders from and to write reports to.
        streams: descriptors for the command's standard output and, if separate, standard error.
    """
    assert " " not in str(machine.run_dir)
    lines = [f"ssl0=fd:{control[0]},fd:{control[1]}"]
    lines += [f"ssl{number}=null,fd:{fd}" for number, fd in enumerate(streams, start=1)]
    return [
        str(machine.kernel),
        f"mem={memory_mib}M",
        *("root=/dev/root", "rootfstype=hostfs", "rootflags=/", "ro"),
        f"init={machine.run_dir}/init",
        *("con=null", "con0=null,fd:1", "ssl=null"),
        *lines,
        *(f"uml_dir={machine.run_dir}", "umid=guest"),
        # This initcall times RAID algorithms for most of a second, and the guest has no RAID.
        "initcall_blacklist=raid6_select_algo",
    ]


def settings_script(request: GuestRequest, machine: GuestFolders) -> str:
    """Return shell variables that PID 1 reads first."""
    values = {
        "engine": machine.engine.value,
        "run": str(machine.run_dir),
        "modules": str(machine.modules),
        "toolbox": str(machine.toolbox),
        "hostname": request.hostname,
        "streams": "1" if request.one_stream else "1 2",
        "interfaces": " ".join(request.interfaces),
    }
    return "".join(f"{name}={shlex.quote(value)}\n" for name, value in values.items())


def writable_list(request: GuestRequest) -> str:
    """Return the writable directories, one a line."""
    return "".join(f"{path}\n" for path in request.writable)


def command_script(
    request: GuestRequest, engine: Engine, busybox: str, timeout_program: str
) -> str:
    """Return the shell script that becomes the command, with the host's environment and
    directory.
    """
    environment = [f"{name}={value}" for name, value in request.environment.items()]
    limit = [timeout_program, "-k", str(KILL_GRACE_S), str(request.timeout_s)]
    words = [
        busybox,
        "env",
        "-i",
        *environment,
        f"VCAN_GUEST={engine.value}",
        *limit,
        *request.command,
    ]
    return (
        f"umask {request.umask:04o}\n"
        f"cd {shlex.quote(request.directory)} || exit 125\n"
        "echo $$ >/run/vcan-guest/command.pid\n"
        f"exec {shlex.join(words)}\n"
    )


def library_names(depends_text: str) -> set[str]:
    """Return the library packages in the output of `apt-cache depends`, without the C library.

    Every host already has the C library, and a second one would not match its loader.
    """
    names = set[str]()
    for line in depends_text.splitlines():
        relation, colon, name = line.strip().partition(":")
        name = name.strip()
        is_needed = bool(colon) and relation.lstrip("|") in ("Depends", "PreDepends")
        if is_needed and name.startswith(("lib", "zlib")) and not name.startswith(C_LIBRARY):
            names.add(name.partition(":")[0])
    return names
