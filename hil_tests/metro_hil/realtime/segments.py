"""The bus segments of a case: the bench's own, or those that the user names."""

import itertools
import os
import shutil
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from firmware_py import rendezvous
from firmware_py.buses import BusError, is_virtual, open_can, parse_spec
from firmware_py.buses.hub_control import HubHandle, start_hub
from firmware_py.clock.clock import Clock
from firmware_py.storage.recorder import CandumpWriter
from metro_hil.model.case import BenchKind
from metro_hil.model.run_folder import RunFolder
from metro_hil.realtime.observer import SegmentTap
from metro_hil.realtime.wires import AUTO, Blocked, RealtimeWires

NAME_TRIES: Final = 20
_numbers = itertools.count()


@dataclass(frozen=True, slots=True)
class Segments:
    """The segments that connect the devices of a case."""

    controller: str
    train: str
    """The same as `controller` if no gateway lies between."""
    own: bool
    """Whether the segments were made for this case, so that no other device can be there."""
    virtual: bool
    """Whether the train's segment is virtual, so that no real train can be connected to it."""
    meeting: Path
    """A private folder of this case for the sockets of its processes."""
    hubs: tuple[int, ...] = ()
    """Process ids of the buses that were made for this case."""
    folders: tuple[Path, ...] = ()
    """Folders that were made for this case and are removed with it."""

    @property
    def split(self) -> bool:
        return self.controller != self.train


def make_segments(
    bench: BenchKind, wires: RealtimeWires, *, gateway: bool, stack: ExitStack
) -> Segments:
    """Make or open the segments of a case.

    Args:
        gateway: the case has bus faults, so that controller and train are kept apart.

    Raises Blocked or BusError.
    """
    name = _meeting_name(stack)
    meeting = rendezvous.bench_dir(name)
    hubs: list[HubHandle] = []
    if wires.bus_a == AUTO:
        if bench is BenchKind.HARDWARE:
            raise Blocked("no bus named: the hardware bench needs one, such as socketcan:can0")
        controller = _own_hub(f"{name}a", stack, hubs)
    else:
        controller = str(parse_spec(wires.bus_a))
    if not gateway:
        train = controller
    elif wires.bus_b != AUTO:
        train = str(parse_spec(wires.bus_b))
        if train == controller:
            raise Blocked(f"{train} is named for both segments; a gateway needs two")
    elif controller.startswith("embedded:"):
        train = _own_hub(f"{name}b", stack, hubs)
    else:
        raise Blocked(
            "faults of the bus need the train on a segment of its own; name the second bus"
        )
    folders = (meeting, *(rendezvous.bench_dir(hub.name) for hub in hubs))
    pids = tuple(hub.pid for hub in hubs)
    own = wires.bus_a == AUTO and (wires.bus_b == AUTO or not gateway)
    return Segments(controller, train, own, is_virtual(train), meeting, pids, folders)


def _meeting_name(stack: ExitStack) -> str:
    """Return a name that is unique on this machine while this process lives."""
    for _ in range(NAME_TRIES):
        name = f"h{os.getpid():x}-{next(_numbers) % 0xFFFF:x}"
        folder = rendezvous.bench_dir(name)
        if not any(folder.iterdir()):
            stack.callback(shutil.rmtree, folder, ignore_errors=True)
            return name
    raise BusError(f"{folder}: left over from an earlier run, as similar folders are; remove it")


def _own_hub(name: str, stack: ExitStack, hubs: list[HubHandle]) -> str:
    hub = start_hub(name, bound=True)
    hubs.append(hub)
    stack.callback(shutil.rmtree, rendezvous.bench_dir(name), ignore_errors=True)
    stack.callback(hub.stop)
    return f"embedded:{name}"


def open_taps(
    segments: Segments, folder: RunFolder, clock: Clock, stack: ExitStack
) -> tuple[SegmentTap, SegmentTap]:
    """Open the taps of the controller's and the train's segment; one tap if they are the same.

    Raises BusError or RecorderError.
    """
    train = _open_tap(segments.train, folder.bus_log, clock, stack)
    if not segments.split:
        return train, train
    log = folder.path / "bus_controller.log"
    return _open_tap(segments.controller, log, clock, stack), train


def _open_tap(spec: str, path: Path, clock: Clock, stack: ExitStack) -> SegmentTap:
    port = open_can(spec, clock=clock, node="TAP")
    stack.callback(port.close)
    log = CandumpWriter(path, parse_spec(spec).name)
    stack.callback(log.close)
    return SegmentTap(port, log, clock.epoch_offset_ns)
