"""The survey reads the machine's CAN support correctly from /proc, /sys and /lib/modules."""

import gzip
from pathlib import Path

import pytest

from metro_tools.vcan_plan import CanSupport
from metro_tools.vcan_survey import SystemPaths, can_links, find_link, survey_kernel

RELEASE = "6.1.0-test"


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> SystemPaths:
    """A machine without CAN support and without programs."""
    monkeypatch.setenv("PATH", "")
    return SystemPaths(root=tmp_path, release=RELEASE)


def put(machine: SystemPaths, path: str, text: str) -> Path:
    file = machine.root / path
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text)
    return file


def put_link(
    machine: SystemPaths, name: str, device: str, *, kind: int = 280, flags: int = 0
) -> Path:
    """A network interface as in /sys: a link to its folder among the devices."""
    folder = machine.root / "sys/devices" / device / "net" / name
    (folder / "statistics").mkdir(parents=True)
    (folder / "type").write_text(f"{kind}\n")
    (folder / "flags").write_text(f"{flags:#x}\n")
    link = machine.root / "sys/class/net" / name
    link.parent.mkdir(parents=True, exist_ok=True)
    link.symlink_to(folder)
    return folder


def test_a_loaded_module_is_ready(machine: SystemPaths) -> None:
    (machine.root / "sys/module/vcan").mkdir(parents=True)

    assert survey_kernel(machine).support is CanSupport.READY


def test_a_built_in_module_is_ready(machine: SystemPaths) -> None:
    put(machine, f"lib/modules/{RELEASE}/modules.builtin", "kernel/drivers/net/can/vcan.ko\n")

    assert survey_kernel(machine).support is CanSupport.READY


@pytest.mark.parametrize("suffix", ["", ".xz", ".zst"])
def test_a_module_on_disk_is_loadable(machine: SystemPaths, suffix: str) -> None:
    line = (
        f"kernel/drivers/net/can/vcan.ko{suffix}: kernel/drivers/net/can/dev/can-dev.ko{suffix}\n"
    )
    put(machine, f"lib/modules/{RELEASE}/modules.dep", line)

    assert survey_kernel(machine).support is CanSupport.LOADABLE


def test_a_module_that_merely_depends_on_vcan_does_not_count(machine: SystemPaths) -> None:
    line = "kernel/net/can/gw.ko: kernel/drivers/net/can/vcan.ko\nkernel/net/xvcan.ko:\n"
    put(machine, f"lib/modules/{RELEASE}/modules.dep", line)

    kernel = survey_kernel(machine)

    assert kernel.support is CanSupport.ABSENT
    assert "modules.dep" in kernel.evidence


def test_absence_is_shown_by_the_configuration(machine: SystemPaths) -> None:
    path = machine.root / "proc/config.gz"
    path.parent.mkdir()
    path.write_bytes(gzip.compress(b"CONFIG_NET=y\n# CONFIG_CAN is not set\n"))

    evidence = survey_kernel(machine).evidence

    assert f"{path} says '# CONFIG_CAN is not set'" in evidence
    assert f"no {machine.root}/lib/modules/{RELEASE}" in evidence


def test_absence_is_shown_by_the_configuration_in_boot(machine: SystemPaths) -> None:
    put(machine, f"boot/config-{RELEASE}", "CONFIG_CAN=m\n# CONFIG_CAN_VCAN is not set\n")

    assert "# CONFIG_CAN_VCAN is not set" in survey_kernel(machine).evidence


def test_a_truncated_configuration_is_no_evidence_and_no_error(machine: SystemPaths) -> None:
    path = machine.root / "proc/config.gz"
    path.parent.mkdir()
    path.write_bytes(gzip.compress(b"# CONFIG_CAN is not set\n")[:-9])

    assert "config.gz" not in survey_kernel(machine).evidence


@pytest.mark.parametrize(
    ("mask", "configure", "load"),
    [(0, False, False), (1 << 12, True, False), (1 << 16, False, True), (2**41 - 1, True, True)],
)
def test_rights_are_the_effective_capabilities(
    machine: SystemPaths, mask: int, configure: bool, load: bool
) -> None:
    put(machine, "proc/self/status", f"Name:\tx\nCapPrm:\t{2**41 - 1:016x}\nCapEff:\t{mask:016x}\n")

    kernel = survey_kernel(machine)

    assert (kernel.may_configure, kernel.may_load) == (configure, load)
    assert not kernel.has_ip
    assert not kernel.has_modprobe


def test_kinds_of_links_are_recognised_without_any_program(machine: SystemPaths) -> None:
    virtual = put_link(machine, "vcan0", "virtual", flags=0x1 | 0x40)
    (virtual / "ifalias").write_text("made by vcan up\n")
    (virtual / "statistics/tx_packets").write_text("12\n")
    (virtual / "statistics/rx_packets").write_text("12\n")
    chip = put_link(machine, "can0", "pci0000:00/0000:00:02.0")
    (chip / "statistics/tx_packets").write_text("3\n")
    (chip / "statistics/rx_packets").write_text("4\n")
    (chip / "statistics/rx_dropped").write_text("1\n")
    put_link(machine, "lo", "virtual", kind=772, flags=1)

    found = {link.name: link for link in can_links(machine)}

    assert sorted(found) == ["can0", "vcan0"]
    assert (found["vcan0"].kind, found["vcan0"].is_up, found["vcan0"].is_ours) == (
        "vcan",
        True,
        True,
    )
    assert (found["vcan0"].frames, found["vcan0"].dropped) == (12, 0)
    assert (found["can0"].kind, found["can0"].is_up, found["can0"].is_ours) == ("can", False, False)
    assert (found["can0"].frames, found["can0"].dropped) == (7, 1)


def test_an_interface_that_is_no_can_bus_is_found_and_reported_as_such(
    machine: SystemPaths,
) -> None:
    put_link(machine, "eth0", "pci0000:00/0000:00:03.0", kind=1, flags=1)

    link = find_link("eth0", machine)

    assert link is not None
    assert link.kind not in ("vcan", "can")
    assert find_link("nothing", machine) is None
