"""Start of a kernel from the cache: files, command line and environment."""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Final

from metro_tools.guest import packages, plan, qemu
from metro_tools.guest.kernels import GuestKernel
from metro_tools.guest.plan import Engine, GuestFolders
from metro_tools.guest.wires import GuestWires

NEWER_LIBRARIES: Final = PurePath("lib")
"""Library folder, relative to the kernel's folder, in which the kernel starts."""
LIBRARY_FOLDER: Final = "lib/x86_64-linux-gnu"


@dataclass(frozen=True, slots=True)
class GuestMemory:
    """Location and size (MiB) of the guest's memory."""

    place: str | None
    """Directory of a tmpfs; None: memory of the process."""
    mib: int


@dataclass(frozen=True, slots=True)
class Launch:
    """A process that the host starts."""

    words: Sequence[str]
    settings: Mapping[str, str]
    """Environment variables in addition to the launcher's own."""


def machine_for(kernel: GuestKernel, cache: Path, run_dir: Path) -> GuestFolders:
    """Return the locations of a guest's parts for this kernel."""
    folder, emulator = cache / kernel.value, cache / packages.EMULATOR
    own = shutil.which(qemu.PROGRAM)
    firmware: tuple[Path, ...] = ()
    libraries: PurePath | None = None
    if kernel is GuestKernel.NEWER:
        libraries = NEWER_LIBRARIES
    elif kernel is GuestKernel.QEMU and own is None:
        libraries = emulator / LIBRARY_FOLDER
        firmware = (emulator / "share/qemu", emulator / "share/seabios")
    return GuestFolders(
        engine=Engine.QEMU if kernel is GuestKernel.QEMU else Engine.UML,
        kernel=folder / "linux",
        busybox=folder / "busybox",
        modules=folder / "modules",
        toolbox=cache / packages.TOOLBOX,
        run_dir=run_dir,
        libraries=libraries,
        emulator=PurePath(own) if own else emulator / "bin" / qemu.PROGRAM,
        firmware=firmware,
    )


def launch(machine: GuestFolders, memory: GuestMemory, wires: GuestWires) -> Launch:
    """Return command line and environment.

    It creates links for the pipes of the control line in the run directory.
    """
    settings = {}
    if machine.libraries is not None:
        settings["LD_LIBRARY_PATH"] = str(machine.libraries)
    streams = [write for _, write, _ in wires.streams]
    if machine.engine is Engine.UML:
        control = (wires.orders_in, wires.reports_out)
        words = plan.kernel_arguments(machine, memory.mib, control=control, streams=streams)
        return Launch(words, settings | {"TMPDIR": memory.place or ""})
    for end, descriptor in (("in", wires.orders_in), ("out", wires.reports_out)):
        pipe = Path(machine.run_dir) / f"{qemu.CONTROL_PIPE}.{end}"
        pipe.symlink_to(f"/dev/fd/{descriptor}")
    if machine.firmware:
        settings["QEMU_MODULE_DIR"] = str(PurePath(machine.libraries or "") / "qemu")
    return Launch(qemu.arguments(machine, memory.mib, streams=streams), settings)
