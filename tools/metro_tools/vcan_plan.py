"""Plans the commands for a virtual CAN bus on this machine. Pure: it runs nothing."""

from dataclasses import dataclass
from enum import Enum
from typing import Final

ALIAS: Final = "made by vcan up"
"""Alias of interfaces made by `vcan up`, so that `vcan down` removes no others."""
NAME_MAX_BYTES: Final = 15
"""IFNAMSIZ minus the terminating zero."""


class CanSupport(Enum):
    """A kernel's support of vcan interfaces."""

    READY = "the module vcan is loaded or built in"
    LOADABLE = "the module vcan exists, but is not loaded"
    ABSENT = "there is no vcan"


@dataclass(frozen=True, slots=True)
class Kernel:
    """Capabilities of this machine, as far as they are known without trying."""

    support: CanSupport
    evidence: str
    """Evidence of the support, as text for the user."""
    has_ip: bool
    has_modprobe: bool
    may_configure: bool
    """CAP_NET_ADMIN: create interfaces and change them."""
    may_load: bool
    """CAP_SYS_MODULE: load the module."""


@dataclass(frozen=True, slots=True)
class KernelLink:
    """A network interface of the kernel."""

    name: str
    kind: str
    """vcan, can (a controller chip), vxcan, slcan, or any other kind of interface with this
    name."""
    is_up: bool
    is_ours: bool
    """Made by `vcan up`."""
    frames: int = 0
    """All frames since it was created."""
    dropped: int = 0


@dataclass(frozen=True, slots=True)
class Commands:
    """Commands to run in this order."""

    words: tuple[tuple[str, ...], ...]


@dataclass(frozen=True, slots=True)
class Nothing:
    """Nothing to do: the state is already reached."""

    text: str


@dataclass(frozen=True, slots=True)
class NotAvailable:
    """The kernel or the privileges do not allow it; an alternative may work."""

    reason: str
    remedy: tuple[str, ...]
    """Commands for the user that change this; empty if none would."""


@dataclass(frozen=True, slots=True)
class NameTaken:
    """The name belongs to an interface that this program must not change."""

    text: str


Step = Commands | Nothing | NotAvailable | NameTaken


def name_fault(name: str) -> str | None:
    """Return why a bus cannot have this name; None if it can."""
    size_bytes = len(name.encode())
    if not name:
        return "a bus needs a name"
    if size_bytes > NAME_MAX_BYTES:
        return f"{name!r} is too long: {size_bytes} bytes, and the kernel takes {NAME_MAX_BYTES}"
    if name.startswith(("-", ".")) or not all(
        c.isascii() and (c.isalnum() or c in "_.-") for c in name
    ):
        return f"{name!r} is not a bus name: letters, digits, '_', '-' and '.', such as vcan0"
    return None


def plan_up(name: str, kernel: Kernel, link: KernelLink | None) -> Step:
    """Plan how to bring up a kernel vcan of this name."""
    if link is not None and link.kind != "vcan":
        return _taken(link)
    if link is not None and link.is_up:
        return Nothing(f"{name}: kernel vcan, already up; use --bus socketcan:{name}")
    recipe = _up_recipe(name, kernel, link)
    if link is None and kernel.support is CanSupport.ABSENT:
        return NotAvailable(f"this kernel has no vcan: {kernel.evidence}", ())
    return _if_allowed(recipe, kernel)


def plan_down(name: str, kernel: Kernel, link: KernelLink | None) -> Step:
    """Plan how to remove a kernel vcan that `vcan up` made."""
    if link is None:
        return Nothing(f"{name}: no such kernel interface")
    remove = ("ip", "link", "delete", "dev", name)
    if link.kind != "vcan":
        return _taken(link)
    if not link.is_ours:
        return NameTaken(
            f"{name} was not made by `vcan up`, so it stays; to remove it anyway: "
            f"sudo {' '.join(remove)}"
        )
    return _if_allowed((remove,), kernel)


def _up_recipe(name: str, kernel: Kernel, link: KernelLink | None) -> tuple[tuple[str, ...], ...]:
    raise_it = ("ip", "link", "set", "dev", name, "up")
    if link is not None:
        return (raise_it,)
    load = (("modprobe", "vcan"),) if kernel.support is not CanSupport.READY else ()
    return (
        *load,
        ("ip", "link", "add", "dev", name, "type", "vcan"),
        ("ip", "link", "set", "dev", name, "alias", ALIAS),
        raise_it,
    )


def _if_allowed(recipe: tuple[tuple[str, ...], ...], kernel: Kernel) -> Step:
    """Return the recipe, or the first obstacle."""
    loads = any(words[0] == "modprobe" for words in recipe)
    typed = tuple(f"sudo {_quoted(words)}" for words in recipe)
    if not kernel.has_ip:
        return NotAvailable(
            "the program `ip` is missing", ("sudo apt install iproute2   # or your system's like",)
        )
    if loads and not kernel.has_modprobe:
        return NotAvailable(
            f"{kernel.evidence}, and the program `modprobe` is missing",
            ("sudo apt install kmod   # or your system's like",),
        )
    if not kernel.may_configure:
        return NotAvailable("no permission to create interfaces (CAP_NET_ADMIN)", typed)
    if loads and not kernel.may_load:
        return NotAvailable(
            f"{kernel.evidence}, and no permission to load it (CAP_SYS_MODULE)", typed[:1]
        )
    return Commands(recipe)


def _quoted(words: tuple[str, ...]) -> str:
    return " ".join(f"'{word}'" if " " in word else word for word in words)


def _taken(link: KernelLink) -> NameTaken:
    if link.kind == "can":
        return NameTaken(
            f"{link.name} is a physical CAN interface, not a virtual one; to use it: "
            f"sudo ip link set dev {link.name} up type can bitrate 250000, "
            f"then --bus socketcan:{link.name}"
        )
    return NameTaken(
        f"{link.name} exists, but it is of type {link.kind}, not vcan; choose another name"
    )
