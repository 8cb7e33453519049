"""What to do about a virtual CAN bus, given what the machine has. Pure: it runs nothing."""

from dataclasses import dataclass
from enum import Enum
from typing import Final

ALIAS: Final = "made by vcan up"
"""Put on interfaces that `vcan up` makes, so that `vcan down` removes no others."""
NAME_MAX_BYTES: Final = 15
"""IFNAMSIZ less the closing zero."""


class CanSupport(Enum):
    """How a kernel stands to vcan interfaces."""

    READY = "the module vcan is loaded or built in"
    LOADABLE = "the module vcan is there, but not loaded"
    ABSENT = "there is no vcan"


@dataclass(frozen=True, slots=True)
class Kernel:
    """What this machine allows, as far as it can be told without trying."""

    support: CanSupport
    evidence: str
    """How the support is known, in words for the user."""
    has_ip: bool
    has_modprobe: bool
    may_configure: bool
    """CAP_NET_ADMIN: make interfaces and change them."""
    may_load: bool
    """CAP_SYS_MODULE: load the module."""


@dataclass(frozen=True, slots=True)
class KernelLink:
    """A network interface of the kernel."""

    name: str
    kind: str
    """vcan, can (a controller chip), vxcan, slcan, or whatever else bears the name."""
    is_up: bool
    is_ours: bool
    """Made by `vcan up`."""
    frames: int = 0
    """All that passed since it was made."""
    dropped: int = 0


@dataclass(frozen=True, slots=True)
class Commands:
    """Do this, in this order."""

    words: tuple[tuple[str, ...], ...]


@dataclass(frozen=True, slots=True)
class Nothing:
    """It is so already."""

    text: str


@dataclass(frozen=True, slots=True)
class NotAvailable:
    """The kernel cannot, or these rights do not reach; something else may do instead."""

    reason: str
    remedy: tuple[str, ...]
    """What to type to change that; empty when nothing would."""


@dataclass(frozen=True, slots=True)
class NameTaken:
    """The name belongs to something that is not ours to touch."""

    text: str


Step = Commands | Nothing | NotAvailable | NameTaken


def name_fault(name: str) -> str | None:
    """Why no bus may have this name; None when one may."""
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
    """How a kernel vcan of this name comes up."""
    if link is not None and link.kind != "vcan":
        return _taken(link)
    if link is not None and link.is_up:
        return Nothing(f"{name}: kernel vcan, already up; use --bus socketcan:{name}")
    recipe = _up_recipe(name, kernel, link)
    if link is None and kernel.support is CanSupport.ABSENT:
        return NotAvailable(f"this kernel has no vcan: {kernel.evidence}", ())
    return _if_allowed(recipe, kernel)


def plan_down(name: str, kernel: Kernel, link: KernelLink | None) -> Step:
    """How the kernel vcan that `vcan up` made goes away again."""
    if link is None:
        return Nothing(f"{name}: no such kernel interface")
    remove = ("ip", "link", "delete", "dev", name)
    if link.kind != "vcan":
        return _taken(link)
    if not link.is_ours:
        return NameTaken(
            f"{name} was not made by `vcan up`, so it stays; to remove it all the same: "
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
    """The recipe, or the first thing that stands in its way."""
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
        return NotAvailable("no right to make interfaces (CAP_NET_ADMIN)", typed)
    if loads and not kernel.may_load:
        return NotAvailable(
            f"{kernel.evidence}, and no right to load it (CAP_SYS_MODULE)", typed[:1]
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
        f"{link.name} exists, but it is of type {link.kind}, not vcan; take another name"
    )
