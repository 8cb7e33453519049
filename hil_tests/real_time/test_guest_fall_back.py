"""A kernel that does not boot is replaced by the next one, and unavailable parts are reported."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from hil_tests.guest_rig import Guest
from metro_tools.guest import packages
from metro_tools.guest.debian_offers import Package
from metro_tools.guest.kernels import AUTOMATIC, GuestKernel, choose
from metro_tools.guest.plan import NoKernelError
from metro_tools.guest.processor import this_processor

pytestmark = pytest.mark.guest

LAUNCHER = "tools/vcan-guest"
DYING_KERNEL = "#!/bin/sh\necho put_fp_registers failed\nkill -SEGV $$\n"
USER_MODE = (GuestKernel.STOCK, GuestKernel.NEWER)


@pytest.fixture
def cache(guest: Guest, tmp_path: Path) -> Path:
    """A cache in which all user-mode kernels are one that works here."""
    real = packages.default_cache()
    works = next(real / k.value for k in USER_MODE if (real / k.value).exists())
    cache = tmp_path / "cache"
    for kernel in GuestKernel:
        shutil.copytree(works, cache / kernel.value)
    (cache / "toolbox").symlink_to(real / "toolbox")
    return cache


def kill(cache: Path, *kernels: GuestKernel) -> None:
    """Make kernels of a cache fail at their start."""
    for kernel in kernels:
        (cache / kernel.value / "linux").write_text(DYING_KERNEL)


def launch(
    checkout: Path, cache: Path, *words: str | Path, **environment: str
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, LAUNCHER, "--cache", str(cache), *(str(word) for word in words)],
        cwd=checkout,
        env={**os.environ, "VCAN_GUEST_KERNEL": "", **environment},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )


def test_the_next_kernel_boots_where_the_first_does_not(checkout: Path, cache: Path) -> None:
    first, second, _ = choose(AUTOMATIC, this_processor()).kernels
    kill(cache, first)

    done = launch(checkout, cache, "sh", "-c", "ls /sys/class/net; exit 4")

    assert (done.returncode, done.stdout.split()) == (4, ["lo", "vcan0"])
    one, two = done.stderr.splitlines()
    assert one.startswith(f"vcan-guest: kernel {first.value}: ")
    assert two.startswith(f"vcan-guest: kernel {second.value}: ")
    assert f"({first.value}: the guest did not come up)" in two


def test_a_requested_kernel_is_not_replaced_by_another(checkout: Path, cache: Path) -> None:
    kill(cache, GuestKernel.NEWER)

    by_option = launch(checkout, cache, "--kernel", "newer", "true")
    by_variable = launch(checkout, cache, "true", VCAN_GUEST_KERNEL="newer")

    for done in (by_option, by_variable):
        assert done.returncode == 125
        assert "the guest did not come up" in done.stderr
        assert "put_fp_registers failed" in done.stderr
        assert "kernel stock" not in done.stderr


def test_with_quiet_there_is_no_message_about_the_kernel(checkout: Path, cache: Path) -> None:
    done = launch(checkout, cache, "--quiet", "--no-vcan", "true")

    assert (done.returncode, done.stderr) == (0, "")


def test_a_guest_that_crashes_during_its_command_is_not_tried_again(
    checkout: Path, cache: Path, tmp_path: Path
) -> None:
    script = f"echo begun >>{tmp_path}/count; echo c >/proc/sysrq-trigger; sleep 60"

    done = launch(checkout, cache, "--write", tmp_path, "sh", "-c", script)

    assert done.returncode == 125
    assert "the guest crashed" in done.stderr
    assert (tmp_path / "count").read_text() == "begun\n"


def test_a_missing_package_tool_is_reported_once(checkout: Path, tmp_path: Path) -> None:
    """The cache is empty and PATH has no apt-get."""
    programs = tmp_path / "bin"
    programs.mkdir()

    done = launch(checkout, tmp_path / "cache", "true", PATH=str(programs))

    assert done.returncode == 125
    assert len(done.stderr.splitlines()) == 1
    assert "apt-get is missing" in done.stderr


def test_an_unknown_kernel_is_a_usage_error(checkout: Path, tmp_path: Path) -> None:
    by_option = launch(checkout, tmp_path, "--kernel", "best", "true")
    by_variable = launch(checkout, tmp_path, "true", VCAN_GUEST_KERNEL="best")

    for done in (by_option, by_variable):
        assert done.returncode == 2
        assert "best" in done.stderr
        assert "stock" in done.stderr


class Mirror:
    """A package repository in a folder, and the messages of the downloads from it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "mirror"
        self.folder.mkdir()
        self.said: list[str] = []
        self.apt = packages._Apt(folder / "apt", self.said.append)

    def add(self, version: str) -> Package:
        """Add a package whose only file holds its version; the index holds its checksum."""
        tree = self.folder / version
        (tree / "DEBIAN").mkdir(parents=True)
        (tree / "content").write_text(version)
        control = f"Package: kernel\nVersion: {version}\nArchitecture: all\nMaintainer: nn\n"
        (tree / "DEBIAN/control").write_text(f"{control}Description: none\n")
        deb = self.folder / f"kernel_{version}_all.deb"
        subprocess.run(["dpkg-deb", "--build", tree, deb], check=True, capture_output=True)
        done = subprocess.run(["sha256sum", deb], check=True, capture_output=True, text=True)
        checksum = done.stdout.split()[0]
        (self.folder / "Packages").write_text(
            f"{control}Filename: ./{deb.name}\nSize: {deb.stat().st_size}\nSHA256: {checksum}\n"
        )
        return Package("kernel", version, checksum)

    def take(self, pinned: Package, to: Path) -> str:
        """Unpack a pinned package and return the version that it gave."""
        apt = self.apt.with_sources(f"deb [trusted=yes] file:{self.folder} ./\n")
        apt.unpack_pinned([pinned], to)
        return (to / "content").read_text()


@pytest.fixture
def mirror(guest: Guest, tmp_path: Path) -> Mirror:
    """A mirror without packages."""
    return Mirror(tmp_path)


def test_the_pinned_package_is_taken_from_a_mirror_that_has_it(
    mirror: Mirror, tmp_path: Path
) -> None:
    assert mirror.take(mirror.add("1.0"), tmp_path / "to") == "1.0"
    assert not any("instead" in line for line in mirror.said)


def test_a_newer_package_of_a_mirror_is_used_and_reported(mirror: Mirror, tmp_path: Path) -> None:
    newer = mirror.add("1.1")

    assert mirror.take(Package("kernel", "1.0", "00" * 32), tmp_path / "to") == "1.1"
    (remark,) = [line for line in mirror.said if "instead" in line]
    assert newer.sha256 in remark


def test_another_package_under_the_pinned_version_is_refused(
    mirror: Mirror, tmp_path: Path
) -> None:
    mirror.add("1.0")

    with pytest.raises(NoKernelError, match="SHA-256"):
        mirror.take(Package("kernel", "1.0", "00" * 32), tmp_path / "to")
    assert not (tmp_path / "to").exists()


def test_an_unreachable_mirror_is_reported(mirror: Mirror) -> None:
    with pytest.raises(NoKernelError, match="apt-get update failed; is a mirror reachable"):
        mirror.apt.with_sources(f"deb [trusted=yes] file:{mirror.folder}/nowhere sid main\n")
