"""The pipes between the launcher and its guest."""

import os
import select
from dataclasses import dataclass, field


@dataclass(slots=True)
class GuestWires:
    """Pipes between launcher and guest.

    The guest makes its ends non-blocking, so no other process shares them.
    """

    orders_in: int
    orders_out: int
    reports_in: int
    reports_out: int
    streams: list[tuple[int, int, int]] = field(default_factory=list)
    """Read end, write end, and the launcher's own descriptor that receives the output."""

    def guest_ends(self) -> list[int]:
        return [self.orders_in, self.reports_out, *(write for _, write, _ in self.streams)]

    def launcher_ends(self) -> list[int]:
        return [self.orders_out, self.reports_in, *(read for read, _, _ in self.streams)]


def lay_wires(*, one_stream: bool) -> GuestWires:
    wires = GuestWires(*os.pipe(), *os.pipe())
    for own in (1,) if one_stream else (1, 2):
        wires.streams.append((*os.pipe(), own))
    return wires


def write_all(descriptor: int, data: bytes) -> None:
    view = memoryview(data)
    while view:
        try:
            view = view[os.write(descriptor, view) :]
        except BlockingIOError:  # another process made it non-blocking
            select.select([], [descriptor], [])
