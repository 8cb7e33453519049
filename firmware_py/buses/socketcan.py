"""A port on the kernel's CAN: python-can opens the socket, this module reads and writes it.

python-can creates a message object and calls `select` for every frame. A port that drains a bus
once a cycle is faster when it reads the socket directly.
"""

import contextlib
import errno
import socket
import struct
from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING, Final

from firmware_py.buses.errors import BusError
from firmware_py.buses.interfaces import look_up
from firmware_py.buses.lean_can import put_off_mf4
from firmware_py.clock.clock import Clock
from firmware_py.ports import CanFrame, LinkCounters

if TYPE_CHECKING:
    from can.interfaces.socketcan import SocketcanBus

RECEIVE_BUFFER_BYTES: Final = 4 << 20
FRAMES_PER_DRAIN: Final = 4096
"""Maximum number of frames in one drain of a flooded bus; the rest waits for the next."""
MAX_STANDARD_ID: Final = 0x7FF
MAX_DATA_BYTES: Final = 8
MOST_KERNEL_FILTERS: Final = 512

_FRAME: Final = struct.Struct("=IB3x8s")
_TIMESPEC: Final = struct.Struct("@qq")
_DROPS: Final = struct.Struct("=I")
_ANCILLARY_BYTES: Final = socket.CMSG_SPACE(_TIMESPEC.size) + socket.CMSG_SPACE(_DROPS.size)
_EXTENDED: Final = 0x8000_0000
_REMOTE: Final = 0x4000_0000
_ERROR: Final = 0x2000_0000
_ID_MASK: Final = 0x1FFF_FFFF
_SO_TIMESTAMPNS: Final = 35
_SO_RXQ_OVFL: Final = 40
_SO_RCVBUFFORCE: Final = 33
_NS_PER_S: Final = 1_000_000_000
_FULL: Final = frozenset({errno.ENOBUFS, errno.EAGAIN})

_make_frame = tuple.__new__


class SocketcanPort:
    """A node on a kernel CAN interface; a `CanPort`.

    It does not receive its own frames.

    Error frames are counted but not delivered, because a device must not take one for data.
    """

    def __init__(
        self, bus: "SocketcanBus", clock: Clock, accept_ids: Collection[int] | None
    ) -> None:
        self._bus = bus
        self._socket = bus.socket
        self._socket.setblocking(False)
        self._clock = clock
        # The kernel filters already, unless there are more identifiers than it can filter.
        self._accepted = None if accept_ids is None else frozenset(accept_ids)
        self._drained_ns = clock.now_ns()
        self.counters = LinkCounters()
        self.alive = True
        """Whether the interface existed and was up at the last call."""

    def fileno(self) -> int:
        """Descriptor for a selector that waits for frames; -1 once closed."""
        return self._socket.fileno()

    def send(self, now_ns: int, can_id: int, data: bytes) -> None:
        """Pass one frame to the kernel.

        Raises:
            ValueError: for an identifier or data that no classic 11-bit frame can carry.
        """
        length = len(data)
        if length > MAX_DATA_BYTES or not 0 <= can_id <= MAX_STANDARD_ID:
            raise ValueError(f"frame {can_id:#x} with {length} bytes: no classic 11-bit frame")
        if self._socket.fileno() < 0:
            self.counters.dropped_out += 1
            return
        try:
            self._socket.send(_FRAME.pack(can_id, length, data))
        except OSError as error:
            self.counters.dropped_out += 1
            if error.errno not in _FULL:
                self.counters.errors += 1
                self.alive = False
        else:
            self.counters.sent += 1
            self.alive = True

    def receive(self, now_ns: int) -> Sequence[CanFrame]:
        """Return all frames of other nodes that arrived since the last call."""
        if self._socket.fileno() < 0:
            return ()
        offset_ns = self._clock.epoch_offset_ns
        floor_ns = min(self._drained_ns, now_ns)
        accepted = self._accepted
        frames: list[CanFrame] = []
        for _ in range(FRAMES_PER_DRAIN):
            heard = self._read()
            if heard is None:
                break
            payload, epoch_ns = heard
            flags_and_id, length, data = _FRAME.unpack(payload)
            # The time of day may be set while the machine's clock continues. A stamp is therefore
            # limited to the time between the last drain and this one, and stamps never decrease.
            floor_ns = min(max(epoch_ns - offset_ns, floor_ns), now_ns)
            if flags_and_id <= MAX_STANDARD_ID:
                if accepted is None or flags_and_id in accepted:
                    values = (floor_ns, flags_and_id, data[:length], False, False, False)
                    frames.append(_make_frame(CanFrame, values))
            elif flags_and_id & _ERROR:
                self.counters.errors += 1
            elif accepted is None:
                frames.append(_uncommon_frame(floor_ns, flags_and_id, data[:length]))
        self._drained_ns = now_ns
        self.counters.received += len(frames)
        return frames

    def close(self) -> None:
        self.alive = False
        if self._socket.fileno() >= 0:
            self._bus.shutdown()

    def _read(self) -> tuple[bytes, int] | None:
        """Read one frame and its time of day in ns since 1970; None if there is no more."""
        try:
            payload, notes, _, _ = self._socket.recvmsg(_FRAME.size, _ANCILLARY_BYTES)
        except BlockingIOError:
            return None
        except OSError:
            # The interface went down or was removed.
            self.counters.errors += self.alive
            self.alive = False
            return None
        self.alive = True
        epoch_ns = 0
        for _, kind, value in notes:
            if kind == _SO_TIMESTAMPNS:
                seconds, nanoseconds = _TIMESPEC.unpack(value)
                epoch_ns = seconds * _NS_PER_S + nanoseconds
            elif kind == _SO_RXQ_OVFL:
                self.counters.dropped_in = _DROPS.unpack(value)[0]
        return payload, epoch_ns


def open_socketcan(
    interface: str, *, clock: Clock, accept_ids: Collection[int] | None = None
) -> SocketcanPort:
    """Open a port on a kernel interface.

    Raises:
        BusError: if the kernel has no CAN, or the interface does not exist, is down, is not CAN or
            may not be used.
    """
    _check(interface)
    put_off_mf4()
    from can.interfaces.socketcan import SocketcanBus

    try:
        bus = SocketcanBus(channel=interface)
        try:
            _configure(bus, accept_ids)
        except OSError:
            bus.shutdown()
            raise
    except OSError as error:
        raise BusError(f"socketcan:{interface}: cannot be opened: {error.strerror}") from error
    return SocketcanPort(bus, clock, accept_ids)


def _check(interface: str) -> None:
    spec = f"socketcan:{interface}"
    _check_kernel(spec, interface)
    found = look_up(interface)
    if found is None:
        raise BusError(
            f"{spec}: there is no interface {interface}; `vcan up {interface}` makes a virtual one"
        )
    if not found.is_can:
        raise BusError(f"{spec}: {interface} is no CAN interface")
    if not found.is_up:
        raise BusError(
            f"{spec}: the interface is down; `ip link set {interface} up` as root brings it up "
            "(hardware needs its bit rate set before)"
        )


def _check_kernel(spec: str, interface: str) -> None:
    hint = f"use embedded:{interface}, or run under vcan-guest"
    if not hasattr(socket, "AF_CAN"):
        raise BusError(f"{spec}: this system has no SocketCAN: {hint}")
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except PermissionError as error:
        raise BusError(f"{spec}: permission denied for a CAN socket: {error.strerror}") from error
    except OSError as error:
        raise BusError(f"{spec}: this kernel has no SocketCAN: {hint}") from error


def _configure(bus: "SocketcanBus", accept_ids: Collection[int] | None) -> None:
    can_socket = bus.socket
    if accept_ids is not None and len(accept_ids) <= MOST_KERNEL_FILTERS:
        _filter(bus, accept_ids)
    for option in (_SO_RCVBUFFORCE, socket.SO_RCVBUF):
        with contextlib.suppress(OSError):
            can_socket.setsockopt(socket.SOL_SOCKET, option, RECEIVE_BUFFER_BYTES)
            break
    # Make the kernel report with each frame how many it has dropped so far.
    can_socket.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)


def _filter(bus: "SocketcanBus", accept_ids: Collection[int]) -> None:
    if not accept_ids:
        # python-can takes an empty list as "everything"; the kernel takes it as "nothing".
        bus.socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, b"")
        return
    mask = MAX_STANDARD_ID | _REMOTE
    bus.set_filters(
        [{"can_id": can_id, "can_mask": mask, "extended": False} for can_id in sorted(accept_ids)]
    )


def _uncommon_frame(stamp_ns: int, flags_and_id: int, data: bytes) -> CanFrame:
    extended, remote = bool(flags_and_id & _EXTENDED), bool(flags_and_id & _REMOTE)
    return CanFrame(stamp_ns, flags_and_id & _ID_MASK, b"" if remote else data, extended, remote)
