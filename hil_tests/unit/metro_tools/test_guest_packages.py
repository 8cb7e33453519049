"""The contents of the guest's cache: pinned packages, a patched loader, an initial file system."""

import dataclasses
import shutil
import subprocess
from pathlib import Path, PurePath

import pytest

from metro_tools.guest import qemu
from metro_tools.guest.debian_offers import (
    DEBIAN_MIRROR,
    PINNED,
    Package,
    offered,
    settle,
    sources_line,
)
from metro_tools.guest.elf_interpreter import with_interpreter
from metro_tools.guest.initial_files import archive
from metro_tools.guest.kernel_modules import dependencies, in_load_order, module_name
from metro_tools.guest.plan import Engine, GuestFolders, NoKernelError

PIN = Package("user-mode-linux", "7.2um1", "ab" * 32)
SHOWN = f"""Package: user-mode-linux
Version: 7.2um1
Depends: libc6 (>= 2.38)
Description: a kernel
 Version: of no meaning
SHA256: {"AB" * 32}

Package: user-mode-linux
Version: 6.1um4
SHA256: {"cd" * 32}
"""


def test_every_pin_has_a_version_and_a_whole_checksum() -> None:
    for package in PINNED:
        assert package.version
        assert len(bytes.fromhex(package.sha256)) == 32


def test_the_first_package_of_apts_output_is_used() -> None:
    assert offered("user-mode-linux", SHOWN) == PIN


@pytest.mark.parametrize("text", ["", "Version: 1\n", f"SHA256: {'ab' * 32}\n"])
def test_an_incomplete_index_entry_is_ignored(text: str) -> None:
    with pytest.raises(NoKernelError, match="user-mode-linux"):
        offered("user-mode-linux", text)


def test_the_pinned_package_is_used_without_a_message() -> None:
    assert settle(PIN, PIN) == (PIN, "")


def test_a_replacement_package_is_used_and_reported_with_its_checksum() -> None:
    offer = Package("user-mode-linux", "7.3um1", "12" * 32)

    taken, remark = settle(PIN, offer)

    assert taken == offer
    for part in ("7.2um1", "7.3um1", "12" * 32):
        assert part in remark
    assert "\n" not in remark


def test_the_pinned_version_with_another_checksum_is_refused() -> None:
    with pytest.raises(NoKernelError, match="SHA-256"):
        settle(PIN, dataclasses.replace(PIN, sha256="ac" * 32))


@pytest.mark.parametrize(
    ("addresses", "mirror"),
    [
        ("http://ftp.de.debian.org/debian/\n", "http://ftp.de.debian.org/debian/"),
        ("http://x/debian-security/\nhttps://mirror/debian\n", "https://mirror/debian"),
        ("http://archive.ubuntu.com/ubuntu/\n", DEBIAN_MIRROR),
        ("", DEBIAN_MIRROR),
    ],
)
def test_unstable_comes_from_the_mirror_that_the_machine_uses(addresses: str, mirror: str) -> None:
    assert sources_line(addresses, None) == f"deb {mirror} sid main\n"
    assert sources_line(addresses, "/k.gpg") == f"deb [signed-by=/k.gpg] {mirror} sid main\n"


@pytest.fixture
def echo(tmp_path: Path) -> Path:
    """The program `echo`, patched to start with a loader in a folder beside it."""
    original = Path(shutil.which("echo") or "echo").resolve()
    changed = tmp_path / "echo"
    changed.write_bytes(with_interpreter(original.read_bytes(), "lib/loader.so"))
    changed.chmod(0o700)
    return changed


def test_a_patched_program_runs_with_the_loader_beside_it_after_a_move(
    echo: Path, tmp_path: Path
) -> None:
    (tmp_path / "lib").mkdir()
    (tmp_path / "lib/loader.so").symlink_to(Path("/lib64/ld-linux-x86-64.so.2").resolve())

    moved = tmp_path.rename(tmp_path.with_name("elsewhere"))
    done = subprocess.run(["./echo", "on"], cwd=moved, capture_output=True, check=True)

    assert done.stdout == b"on\n"


def test_a_patched_program_uses_no_other_loader(echo: Path, tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        subprocess.run([str(echo), "on"], cwd=tmp_path, check=False)


@pytest.mark.parametrize("program", [b"", b"#!/bin/sh\n" * 9, b"\x7fELF\x01\x01" + bytes(99)])
def test_a_file_that_is_no_64_bit_program_is_refused(program: bytes) -> None:
    with pytest.raises(ValueError, match="no 64-bit ELF"):
        with_interpreter(program, "lib/loader.so")


def test_a_program_without_a_loader_is_refused() -> None:
    header = b"\x7fELF\x02\x01" + bytes(48) + b"\x38" + bytes(9)  # no segments of 56 bytes

    with pytest.raises(ValueError, match="without a dynamic loader"):
        with_interpreter(header, "lib/loader.so")


def entries_of(image: bytes) -> dict[str, tuple[int, bytes]]:
    """Mode and content of each entry of a cpio archive, read according to its published layout."""
    found: dict[str, tuple[int, bytes]] = {}
    place = 0
    while True:
        assert image[place : place + 6] == b"070701"
        fields = [int(image[place + 6 + 8 * n : place + 14 + 8 * n], 16) for n in range(13)]
        name_at = place + 110
        name = image[name_at : name_at + fields[11] - 1].decode()
        content_at = -(-(name_at + fields[11]) // 4) * 4
        if name == "TRAILER!!!":
            return found
        found[name] = (fields[1], image[content_at : content_at + fields[6]])
        place = -(-(content_at + fields[6]) // 4) * 4


@pytest.mark.parametrize("size", [0, 1, 2, 3, 4, 5])
def test_an_initial_file_system_holds_its_entries(size: int) -> None:
    files = {"init": b"x" * size, "bin/busybox": b"y" * 9}

    image = archive(("bin", "proc"), files)

    assert entries_of(image) == {
        "bin": (0o040755, b""),
        "proc": (0o040755, b""),
        "init": (0o100755, b"x" * size),
        "bin/busybox": (0o100755, b"y" * 9),
    }


def module(*depends: str) -> bytes:
    return b"\x7fELF\0license=GPL\0depends=" + ",".join(depends).encode() + b"\0name=x\0"


MODULES = {
    "virtio_pci": module("virtio", "virtio-ring"),
    "virtio": module("virtio_ring"),
    "virtio_ring": module(),
    "can_raw": module("can"),
    "can": module(),
}


def test_the_dependencies_of_a_module_are_read() -> None:
    assert dependencies(module("can", "can-dev")) == ["can", "can_dev"]
    assert dependencies(module()) == []
    assert dependencies(b"no module") == []


def test_modules_come_once_and_after_their_dependencies() -> None:
    loaded = in_load_order(["virtio-pci", "can-raw", "virtio", "built-in"], MODULES.get)

    assert list(loaded) == ["virtio_ring", "virtio", "virtio_pci", "can", "can_raw"]
    assert loaded == MODULES


@pytest.mark.parametrize("name", ["can-dev.ko", "can_dev.ko.xz", "can-dev"])
def test_a_module_name_does_not_depend_on_its_file_name(name: str) -> None:
    assert module_name(name) == "can_dev"


def test_the_first_program_of_an_emulated_pc_is_a_script_that_a_shell_can_read() -> None:
    done = subprocess.run(
        ["sh", "-n"], input=qemu.INIT, text=True, capture_output=True, check=False
    )

    assert (done.returncode, done.stderr) == (0, "")


def test_the_emulated_pc_has_its_lines_in_order_and_one_writable_export() -> None:
    machine = GuestFolders(
        engine=Engine.QEMU,
        kernel=PurePath("/cache/qemu/linux"),
        busybox=PurePath("/cache/qemu/busybox"),
        modules=PurePath("/cache/qemu/modules"),
        toolbox=PurePath("/a,b/toolbox"),
        run_dir=PurePath("/run/it"),
        emulator=PurePath("/bin/qemu"),
        firmware=(PurePath("/fw"),),
    )

    words = qemu.arguments(machine, 512, streams=[7, 8])

    assert words[0] == "/bin/qemu"
    assert words[words.index("-L") + 1] == "/fw"
    assert words[words.index("-initrd") + 1] == "/cache/qemu/initrd"
    assert [word for word in words if word.startswith("virtconsole")] == [
        f"virtconsole,chardev=line{number},nr={number}" for number in range(3)
    ]
    for path in ("pipe,id=line0,path=/run/it/control", "path=/dev/fd/7", "path=/a,,b/toolbox"):
        assert any(path in word for word in words)
    writable = [word for word in words if "readonly=off" in word]
    assert len(writable) == 1
    assert "id=writable" in writable[0]
