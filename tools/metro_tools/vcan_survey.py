"""Surveys the CAN support of this machine's kernel from /proc, /sys and /lib/modules; changes
nothing.
"""

import gzip
import json
import os
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from metro_tools.vcan_plan import ALIAS, CanSupport, Kernel, KernelLink

CAP_NET_ADMIN: Final = 12
CAP_SYS_MODULE: Final = 16
ARPHRD_CAN: Final = 280
IFF_UP: Final = 1
IP_TIMEOUT_S: Final = 5


@dataclass(frozen=True, slots=True)
class SystemPaths:
    """Paths to read; tests use a tree of their own."""

    root: Path = Path("/")
    release: str = ""
    """Release of the kernel, as from `uname -r`."""


def survey_kernel(places: SystemPaths) -> Kernel:
    """Return the kernel's CAN support and the rights of this process."""
    support, evidence = _support(places)
    capabilities = _capabilities(places.root / "proc/self/status")
    return Kernel(
        support=support,
        evidence=evidence,
        has_ip=shutil.which("ip") is not None,
        has_modprobe=shutil.which("modprobe") is not None,
        may_configure=bool(capabilities >> CAP_NET_ADMIN & 1),
        may_load=bool(capabilities >> CAP_SYS_MODULE & 1),
    )


def _support(places: SystemPaths) -> tuple[CanSupport, str]:
    if not sys.platform.startswith("linux"):
        return CanSupport.ABSENT, f"this is {sys.platform}, and only Linux has SocketCAN"
    if (places.root / "sys/module/vcan").is_dir():
        return CanSupport.READY, "the module vcan is loaded"
    modules = places.root / "lib/modules" / places.release
    if _is_listed(modules / "modules.builtin"):
        return CanSupport.READY, "vcan is built into the kernel"
    if _is_listed(modules / "modules.dep"):
        return CanSupport.LOADABLE, "the module vcan exists, but is not loaded"
    return CanSupport.ABSENT, "; ".join(_absence(places, modules))


def _absence(places: SystemPaths, modules: Path) -> Iterator[str]:
    """Yield the evidence that there is no vcan."""
    if (fault := _can_socket_fault()) is not None:
        yield f"a CAN socket gives {fault!r}"
    for path in (places.root / "proc/config.gz", places.root / f"boot/config-{places.release}"):
        if (line := _config_line(path)) is not None:
            yield f"{path} says {line!r}"
            break
    if modules.is_dir():
        yield f"no vcan in {modules / 'modules.dep'}"
    else:
        yield f"no {modules}"


def _is_listed(path: Path) -> bool:
    """Return whether a list of modules has vcan; its files may be compressed: vcan.ko.xz."""
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return False
    return any("/vcan.ko" in line.partition(":")[0] for line in text.splitlines())


def _config_line(path: Path) -> str | None:
    """Return the line about CAN in a kernel's configuration."""
    try:
        raw = path.read_bytes()
        text = (gzip.decompress(raw) if path.suffix == ".gz" else raw).decode(errors="replace")
    except (OSError, EOFError):
        return None
    lines = {line.strip() for line in text.splitlines()}
    for option in ("CONFIG_CAN", "CONFIG_CAN_VCAN"):
        if f"# {option} is not set" in lines:
            return f"# {option} is not set"
    return next((line for line in sorted(lines) if line.startswith("CONFIG_CAN_VCAN=")), None)


def _can_socket_fault() -> str | None:
    try:
        socket.socket(socket.PF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError as error:
        return error.strerror or str(error)
    return None


def _capabilities(status: Path) -> int:
    """Effective capabilities of this process; those of root if the kernel does not report them."""
    try:
        for line in status.read_text(encoding="utf-8").splitlines():
            if line.startswith("CapEff:"):
                return int(line.split()[1], 16)
    except OSError:
        pass
    return -1 if os.geteuid() == 0 else 0


def find_link(name: str, places: SystemPaths) -> KernelLink | None:
    """Return the kernel's network interface of this name."""
    folder = places.root / "sys/class/net" / name
    if not folder.is_dir():
        return None
    kind = _link_kind(name, folder)
    heard = _statistic(folder, "rx_packets")
    sent = _statistic(folder, "tx_packets")
    return KernelLink(
        name=name,
        kind=kind,
        is_up=bool(_number(folder / "flags") & IFF_UP),
        is_ours=_text(folder / "ifalias") == ALIAS,
        # A vcan counts its own frames as received, unless no socket listens.
        frames=sent if kind == "vcan" else heard + sent,
        dropped=_statistic(folder, "rx_dropped") + _statistic(folder, "tx_dropped"),
    )


def can_links(places: SystemPaths) -> list[KernelLink]:
    """Return all CAN interfaces of the kernel, by name."""
    folder = places.root / "sys/class/net"
    names = sorted(entry.name for entry in folder.iterdir()) if folder.is_dir() else []
    found = (
        find_link(name, places) for name in names if _number(folder / name / "type") == ARPHRD_CAN
    )
    return [link for link in found if link is not None]


def _link_kind(name: str, folder: Path) -> str:
    """Return the kind from `ip`, or from /sys if `ip` is missing."""
    if (kind := _kind_from_ip(name)) is not None:
        return kind
    if _number(folder / "type") != ARPHRD_CAN:
        return "another type than CAN"
    return "vcan" if "/devices/virtual/" in str(folder.resolve()) else "can"


def _kind_from_ip(name: str) -> str | None:
    if shutil.which("ip") is None:
        return None
    try:
        done = subprocess.run(  # noqa: S603 # no shell; `name` is a folder of /sys
            ["ip", "-details", "-json", "link", "show", "dev", name],  # noqa: S607 # whichever `ip` the user has
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=IP_TIMEOUT_S,
            check=False,
        )
        rows: list[dict[str, Any]] = json.loads(done.stdout or b"[]")
    except (subprocess.TimeoutExpired, ValueError):
        return None
    for row in rows:
        kind = row.get("linkinfo", {}).get("info_kind") or row.get("link_type")
        return str(kind) if kind else None
    return None


def _statistic(folder: Path, name: str) -> int:
    return _number(folder / "statistics" / name)


def _number(path: Path) -> int:
    try:
        return int(_text(path), 0)
    except ValueError:
        return 0


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""
