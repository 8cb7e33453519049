"""An emulated PC as the guest's machine: its command line and its first program. Pure."""

from collections.abc import Sequence
from pathlib import PurePath
from typing import Final

from metro_tools.guest.plan import GuestFolders

PROGRAM: Final = "qemu-system-x86_64"
CONTROL_PIPE: Final = "control"
"""Base name in the run directory: QEMU opens it with `.in` and `.out` for the control line."""
EARLY_MODULES: Final = ("virtio_pci", "virtio_console", "9pnet_virtio", "9p")
"""Modules for the host's file system and for the lines."""

INIT: Final = """\
#!/bin/busybox sh
# Makes the host's file system the root and continues there.
b=/bin/busybox
$b mount -t proc proc /proc
for module in /modules/*; do $b insmod "$module"; done
$b mount -t 9p -o ro,trans=virtio,version=9p2000.L,msize=512000,cache=loose host /root &&
    $b umount /proc && exec $b switch_root /root "$run_dir/init"
echo "vcan-guest: cannot mount the host's file system"
$b poweroff -f
"""
"""First program of the initial file system; `run_dir` comes from the kernel's command line."""


def arguments(machine: GuestFolders, memory_mib: int, *, streams: Sequence[int]) -> list[str]:
    """Return the command line of the emulator.

    Line 0 is the control pipe, lines 1 and 2 are the streams.

    Args:
        machine: its `kernel` is a bzImage with `initrd` beside it.
        memory_mib: the chosen size.
        streams: descriptors for the command's standard output and, if separate, standard error.
    """
    assert " " not in str(machine.run_dir)
    words = [str(machine.emulator), *("-M", "q35"), *("-accel", "tcg,thread=multi")]
    for directory in machine.firmware:
        words += ["-L", str(directory)]
    # Page tables of five levels would only be slower to emulate.
    words += ["-cpu", "max,la57=off", "-smp", "2", "-m", str(memory_mib)]
    words += ["-nodefaults", "-no-user-config", "-display", "none", "-no-reboot"]
    words += ["-serial", "file:/dev/fd/1", "-device", "virtio-serial-pci"]
    words += _line(0, f"pipe,path={_escaped(machine.run_dir / CONTROL_PIPE)}")
    for number, descriptor in enumerate(streams, start=1):
        words += _line(number, f"file,path=/dev/fd/{descriptor}")
    words += _exported("host", PurePath("/"), "on")
    words += _exported("toolbox", machine.toolbox, "on")
    words += _exported("writable", PurePath("/"), "off")
    words += ["-kernel", str(machine.kernel), "-initrd", str(machine.kernel.with_name("initrd"))]
    kernel_words = f"console=ttyS0 panic=-1 mitigations=off nokaslr run_dir={machine.run_dir}"
    return [*words, "-append", kernel_words]


def _line(number: int, backend: str) -> list[str]:
    name = f"line{number}"
    kind, _, rest = backend.partition(",")
    device = f"virtconsole,chardev={name},nr={number}"
    return ["-chardev", f"{kind},id={name},{rest}", "-device", device]


def _exported(tag: str, directory: PurePath, read_only: str) -> list[str]:
    path = f"path={_escaped(directory)},security_model=none,readonly={read_only}"
    return [
        *("-fsdev", f"local,id={tag},{path},multidevs=remap"),
        *("-device", f"virtio-9p-pci,fsdev={tag},mount_tag={tag}"),
    ]


def _escaped(path: PurePath) -> str:
    """Double each comma, because a single one would end the value of an option."""
    return str(path).replace(",", ",,")
