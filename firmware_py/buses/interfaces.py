"""Properties of a network interface from the kernel: whether it is CAN, up, and virtual.

The query uses netlink, because only netlink gives the kind of a virtual interface, and because it
needs neither privileges nor the program `ip`.
"""

import re
import socket
import struct
from dataclasses import dataclass
from typing import Final

BUS_NAME: Final = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,14}")
"""Interface names that the kernel accepts, without those that are problematic in a path."""
VIRTUAL_KINDS: Final = frozenset({"vcan", "vxcan"})

_REQUEST: Final = struct.Struct("=IHHII")
_LINK: Final = struct.Struct("=BxHiII")
_ATTRIBUTE: Final = struct.Struct("=HH")

_NEW_LINK: Final = 16
_GET_LINK: Final = 18
_IS_REQUEST: Final = 1
_NAME: Final = 3
_LINK_INFO: Final = 18
_INFO_KIND: Final = 1
_ATTRIBUTE_MASK: Final = 0x3FFF
"""Removes the flags for nested attributes and for network byte order."""
_CAN_HARDWARE: Final = 280
_UP: Final = 1
_ANSWER_S: Final = 2.0
_ANSWER_BYTES: Final = 1 << 16


@dataclass(frozen=True, slots=True)
class Interface:
    """One network interface of this machine."""

    is_can: bool
    is_up: bool
    kind: str
    """Kind such as vcan or can; empty if the kernel reports none, as for most hardware drivers."""


def look_up(name: str) -> Interface | None:
    """Return the interface of that name; None if it does not exist or the query fails."""
    if not hasattr(socket, "AF_NETLINK"):
        return None
    try:
        with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, socket.NETLINK_ROUTE) as netlink:
            netlink.settimeout(_ANSWER_S)
            netlink.sendto(link_request(name), (0, 0))
            return parse_link(netlink.recv(_ANSWER_BYTES))
    except OSError:
        return None


def link_request(name: str) -> bytes:
    """Build the request for one interface by name."""
    wanted = _pack_attribute(_NAME, name.encode() + b"\0")
    body = _LINK.pack(socket.AF_UNSPEC, 0, 0, 0, 0) + wanted
    return _REQUEST.pack(_REQUEST.size + len(body), _GET_LINK, _IS_REQUEST, 1, 0) + body


def parse_link(answer: bytes) -> Interface | None:
    """Parse the kernel's answer; None if the interface does not exist."""
    if len(answer) < _REQUEST.size + _LINK.size:
        return None
    size, kind, _, _, _ = _REQUEST.unpack_from(answer)
    if kind != _NEW_LINK:
        return None
    _, hardware, _, flags, _ = _LINK.unpack_from(answer, _REQUEST.size)
    attributes = _attributes(answer[_REQUEST.size + _LINK.size : size])
    info = _attributes(attributes.get(_LINK_INFO, b""))
    return Interface(
        is_can=hardware == _CAN_HARDWARE,
        is_up=bool(flags & _UP),
        kind=info.get(_INFO_KIND, b"").rstrip(b"\0").decode("ascii", "replace"),
    )


def _pack_attribute(kind: int, value: bytes) -> bytes:
    size = _ATTRIBUTE.size + len(value)
    return _ATTRIBUTE.pack(size, kind) + value + bytes(-size % 4)


def _attributes(data: bytes) -> dict[int, bytes]:
    found = {}
    while len(data) >= _ATTRIBUTE.size:
        size, kind = _ATTRIBUTE.unpack_from(data)
        if size < _ATTRIBUTE.size:
            break
        found[kind & _ATTRIBUTE_MASK] = data[_ATTRIBUTE.size : size]
        data = data[size + -size % 4 :]
    return found
