"""Network namespaces for processes, and TUN devices into them that end in this program (Linux).

The only way out of a namespace is the TUN device that is created in it. This program reads every
packet that its programs send from a file, and writes to that file what they receive.
"""

import ctypes
import fcntl
import os
import socket
import struct
import threading
from pathlib import Path
from typing import Final, NamedTuple

CLONE_NEWUSER: Final = 0x10000000
CLONE_NEWNET: Final = 0x40000000
TUN: Final = "/dev/net/tun"
TUNSETIFF: Final = 0x400454CA
IFF_TUN: Final = 0x0001
IFF_NO_PI: Final = 0x1000
IFF_UP: Final = 0x1
SIOCGIFFLAGS: Final = 0x8913
SIOCSIFFLAGS: Final = 0x8914
SIOCSIFADDR: Final = 0x8916
SIOCSIFNETMASK: Final = 0x891C
IFREQ: Final = struct.Struct("<16s24s")
NETMASK: Final = "255.255.255.0"
PACKET_BYTES: Final = 65536
REFUSED: Final = "BLOCKED: trains cannot get networks of their own here"
"""First words of the message in that case."""


class NamespaceError(Exception):
    """The kernel or the rights do not allow it; the text says what was refused."""


class Cable(NamedTuple):
    """The end of a namespace's only device, and the file that keeps the namespace alive."""

    file: int
    """File that is read and written packet by packet."""
    namespace: int
    """File descriptor; child processes join the namespace by /proc/PID/fd/N."""


def own_network() -> None:
    """Leave the network of the host for good; afterwards there is only a loopback device.

    Without the rights for that, a user namespace gives them for the network alone. Must be called
    before there are threads. Raises NamespaceError.
    """
    try:
        _unshare(CLONE_NEWNET)
    except PermissionError:
        user, group = os.getuid(), os.getgid()
        try:
            _unshare(CLONE_NEWUSER | CLONE_NEWNET)
            _write("/proc/self/setgroups", "deny")
            _write("/proc/self/uid_map", f"0 {user} 1")
            _write("/proc/self/gid_map", f"0 {group} 1")
        except OSError as error:
            raise NamespaceError(
                f"a network of its own is refused ({error.strerror}); it takes root, "
                f"CAP_SYS_ADMIN, or a kernel that gives user namespaces to everybody"
            ) from error
    except OSError as error:
        raise NamespaceError(f"this kernel has no network namespaces ({error.strerror})") from error
    _bring_up("lo")


def join(path: str) -> None:
    """Join the network that this file stands for. Raises NamespaceError."""
    try:
        file = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        try:
            _call("setns", file, CLONE_NEWNET)
        finally:
            os.close(file)
    except OSError as error:
        raise NamespaceError(f"{path}: not joined ({error.strerror})") from error


def cable_here(name: str, address: str) -> int:
    """Create a device in the network of the calling thread; return its other end.

    Raises NamespaceError.
    """
    try:
        file = os.open(TUN, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        raise NamespaceError(f"{TUN}: {error.strerror}") from error
    try:
        flags = struct.pack("<H", IFF_TUN | IFF_NO_PI)
        fcntl.ioctl(file, TUNSETIFF, IFREQ.pack(name.encode(), flags))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
            for request, value in ((SIOCSIFADDR, address), (SIOCSIFNETMASK, NETMASK)):
                place = struct.pack("<HH4s", socket.AF_INET, 0, socket.inet_aton(value))
                fcntl.ioctl(control, request, IFREQ.pack(name.encode(), place))
        _bring_up(name)
    except OSError as error:
        os.close(file)
        raise NamespaceError(f"device {name}: {error.strerror}") from error
    return file


def cable_away(name: str, address: str) -> Cable:
    """Create a namespace with such a device in it. Raises NamespaceError."""
    made: list[Cable] = []
    failed: list[NamespaceError] = []

    def make() -> None:
        # Only this thread changes its namespace, and it ends here; the file keeps the namespace.
        try:
            _unshare(CLONE_NEWNET)
            _bring_up("lo")
            namespace = os.open("/proc/thread-self/ns/net", os.O_RDONLY | os.O_CLOEXEC)
            made.append(Cable(cable_here(name, address), namespace))
        except NamespaceError as error:
            failed.append(error)
        except OSError as error:
            failed.append(NamespaceError(f"a network for {name}: {error.strerror}"))

    thread = threading.Thread(target=make)
    thread.start()
    thread.join()
    if failed:
        raise failed[0]
    return made[0]


def destination_of(packet: bytes) -> str | None:
    """Return the destination of an IPv4 packet; None for others, such as IPv6 requests."""
    if len(packet) < 20 or packet[0] >> 4 != 4:
        return None
    return socket.inet_ntoa(packet[16:20])


def _bring_up(name: str) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
        asked = IFREQ.pack(name.encode(), b"")
        (flags,) = struct.unpack_from("<H", fcntl.ioctl(control, SIOCGIFFLAGS, asked), 16)
        wanted = struct.pack("<H", flags | IFF_UP)
        fcntl.ioctl(control, SIOCSIFFLAGS, IFREQ.pack(name.encode(), wanted))


def _unshare(what: int) -> None:
    _call("unshare", what)


def _write(path: str, text: str) -> None:
    Path(path).write_text(text, encoding="ascii")


def _call(name: str, *arguments: int) -> None:
    """Call a function of the C library. Raises OSError, also if the function does not exist."""
    library = ctypes.CDLL(None, use_errno=True)
    function = getattr(library, name, None)
    if function is None:
        raise OSError(0, f"the C library has no {name}")
    if function(*arguments) != 0:
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code))
