"""Cases of the SocketCAN port on a real kernel interface.

pytest does not collect this file by itself. `test_buses_socketcan.py` runs it where the process may
create a vcan interface, or else in a guest that has one.
"""

import select
import subprocess
from collections.abc import Iterator

import can
import pytest

from firmware_py.buses import BusError, is_virtual, open_can, resolve_auto, socketcan
from firmware_py.buses.interfaces import Interface, look_up
from firmware_py.buses.socketcan import SocketcanPort, open_socketcan
from firmware_py.clock.clock import LockstepClock, WallClock
from firmware_py.ports import CanFrame

NAME = "vcantest0"
SPEC = f"socketcan:{NAME}"
WAIT_S = 20.0
"""Timeout far above every duration here; only a loss reaches it, s."""


def ip(words: str) -> None:
    subprocess.run(["ip", *words.split()], check=True)


@pytest.fixture(autouse=True)
def interface() -> None:
    """The interface, up. It stays for the next test, because `ip` takes most of a second in a
    guest."""
    found = look_up(NAME)
    if found is None:
        ip(f"link add dev {NAME} type vcan")
    if found is None or not found.is_up:
        ip(f"link set {NAME} up")


@pytest.fixture(autouse=True, scope="module")
def leave_nothing() -> Iterator[None]:
    yield
    if look_up(NAME) is not None:
        ip(f"link del {NAME}")


@pytest.fixture
def clock() -> WallClock:
    return WallClock()


@pytest.fixture
def ports(clock: WallClock) -> Iterator[dict[str, SocketcanPort]]:
    """A sender, a listener that receives all frames, and a brake that receives one identifier."""
    opened = {
        "vobc": open_socketcan(NAME, clock=clock),
        "tap": open_socketcan(NAME, clock=clock),
        "bcu": open_socketcan(NAME, clock=clock, accept_ids=[0x101]),
    }
    yield opened
    for port in opened.values():
        port.close()


@pytest.fixture
def stranger() -> Iterator[can.BusABC]:
    """Another program on the bus, which may send any frame."""
    bus = can.Bus(NAME, interface="socketcan", ignore_config=True)
    yield bus
    bus.shutdown()


def hear(port: SocketcanPort, count: int, clock: WallClock) -> list[CanFrame]:
    """Receive `count` frames; the kernel delivers them some time after they were sent."""
    heard: list[CanFrame] = []
    while len(heard) < count and select.select([port], [], [], WAIT_S)[0]:
        heard += port.receive(clock.now_ns())
    return heard


def without_stamps(frames: list[CanFrame]) -> list[tuple[int, bytes]]:
    return [(frame.can_id, frame.data) for frame in frames]


def test_frames_of_all_lengths_arrive_in_order_at_all_other_nodes(
    ports: dict[str, SocketcanPort], clock: WallClock
) -> None:
    sent = [(0x100 + length, bytes(range(length))) for length in range(9)]
    for can_id, data in sent:
        ports["vobc"].send(clock.now_ns(), can_id, data)

    assert without_stamps(hear(ports["tap"], 9, clock)) == sent
    assert without_stamps(hear(ports["bcu"], 1, clock)) == sent[1:2]
    assert ports["vobc"].receive(clock.now_ns()) == []
    assert ports["tap"].receive(clock.now_ns()) == []
    assert (ports["vobc"].counters.sent, ports["tap"].counters.received) == (9, 9)


def test_a_port_that_accepts_nothing_receives_nothing(
    ports: dict[str, SocketcanPort], clock: WallClock
) -> None:
    deaf = open_can(SPEC, clock=clock, node="deaf", accept_ids=[])
    ports["vobc"].send(clock.now_ns(), 0x101, b"")
    assert len(hear(ports["tap"], 1, clock)) == 1

    assert deaf.receive(clock.now_ns()) == []
    deaf.close()


def test_more_identifiers_than_the_kernel_can_filter_are_still_filtered(
    ports: dict[str, SocketcanPort], clock: WallClock
) -> None:
    many = open_socketcan(NAME, clock=clock, accept_ids=range(0x100, 0x7FF))
    for can_id in (0x0FF, 0x100, 0x7FE, 0x7FF):
        ports["vobc"].send(clock.now_ns(), can_id, b"")

    assert [frame.can_id for frame in hear(many, 2, clock)] == [0x100, 0x7FE]
    many.close()


def test_stamps_lie_between_sending_and_reception_and_never_run_back(
    ports: dict[str, SocketcanPort], clock: WallClock
) -> None:
    before_ns = clock.now_ns()
    for _ in range(100):
        ports["vobc"].send(clock.now_ns(), 0x101, b"")

    stamps = [frame.stamp_ns for frame in hear(ports["tap"], 100, clock)]

    assert stamps == sorted(stamps)
    assert before_ns <= stamps[0]
    assert stamps[-1] <= clock.now_ns()
    assert len(set(stamps)) > 1


@pytest.mark.parametrize("error_s", [-3600, 3600])
def test_a_changed_time_of_day_puts_no_stamp_outside_the_reception(
    clock: WallClock, ports: dict[str, SocketcanPort], error_s: int
) -> None:
    """The clock's offset to the time of day is an hour off, as after a person set it."""
    offset_ns = clock.epoch_offset_ns + error_s * 1_000_000_000
    opened_ns, first_ns, second_ns = (clock.now_ns() + step for step in (0, 10**9, 2 * 10**9))
    port = open_socketcan(NAME, clock=LockstepClock(opened_ns, offset_ns))

    stamps = []
    for now_ns in (first_ns, second_ns):
        ports["vobc"].send(0, 0x101, b"")
        assert select.select([port], [], [], WAIT_S)[0]
        stamps += [frame.stamp_ns for frame in port.receive(now_ns)]

    assert opened_ns <= stamps[0] <= first_ns <= stamps[1] <= second_ns
    port.close()


def test_special_frames_are_marked_and_hidden_from_filtered_readers(
    ports: dict[str, SocketcanPort], stranger: can.BusABC, clock: WallClock
) -> None:
    stranger.send(can.Message(arbitration_id=0x101, is_extended_id=True, data=b"x"))
    stranger.send(
        can.Message(arbitration_id=0x101, is_extended_id=False, is_remote_frame=True, dlc=4)
    )
    stranger.send(can.Message(arbitration_id=0x101, is_extended_id=False, data=b"plain"))

    heard = hear(ports["tap"], 3, clock)
    assert without_stamps(hear(ports["bcu"], 1, clock)) == [(0x101, b"plain")]
    assert [(frame.data, frame.extended, frame.remote) for frame in heard] == [
        (b"x", True, False),
        (b"", False, True),
        (b"plain", False, False),
    ]


def test_an_error_frame_is_counted_and_not_delivered(
    ports: dict[str, SocketcanPort], stranger: can.BusABC, clock: WallClock
) -> None:
    stranger.send(
        can.Message(arbitration_id=0x4, is_error_frame=True, is_extended_id=False, data=bytes(8))
    )

    ports["vobc"].send(clock.now_ns(), 0x101, b"")

    assert without_stamps(hear(ports["tap"], 1, clock)) == [(0x101, b"")]
    assert ports["tap"].counters.errors == 1


def test_python_can_receives_the_frames_of_the_port(
    ports: dict[str, SocketcanPort], stranger: can.BusABC, clock: WallClock
) -> None:
    ports["vobc"].send(clock.now_ns(), 0x181, b"\x01\x02\x03")

    message = stranger.recv(5.0)

    assert message is not None
    assert (message.arbitration_id, bytes(message.data)) == (0x181, b"\x01\x02\x03")
    assert not message.is_extended_id


def test_a_second_of_a_busy_train_waits_without_loss(
    ports: dict[str, SocketcanPort], clock: WallClock
) -> None:
    """The sender sends 2000 frames while the receiver waits; python-can's own socket would hold
    278."""
    for number in range(2_000):
        ports["vobc"].send(clock.now_ns(), 0x101, number.to_bytes(8, "big"))

    frames = hear(ports["tap"], 2_000, clock)

    assert [int.from_bytes(frame.data, "big") for frame in frames] == list(range(2_000))
    assert ports["tap"].counters.dropped_in == 0


def test_frames_dropped_by_the_kernel_are_counted(
    ports: dict[str, SocketcanPort], clock: WallClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The port has a small buffer that is soon full."""
    monkeypatch.setattr(socketcan, "RECEIVE_BUFFER_BYTES", 65_536)
    monkeypatch.setattr(socketcan, "FRAMES_PER_DRAIN", 50)
    small = open_socketcan(NAME, clock=clock)
    offered = 2_000
    for _ in range(offered):
        ports["vobc"].send(clock.now_ns(), 0x101, bytes(8))
    heard = 0
    while frames := small.receive(clock.now_ns()):
        assert len(frames) <= 50
        heard += len(frames)
    # The kernel reports with the next frame how many it dropped.
    ports["vobc"].send(clock.now_ns(), 0x102, b"after")
    while not frames or frames[-1].can_id != 0x102:
        frames = hear(small, 1, clock)
        assert frames, "the last frame did not come"
        heard += len(frames)

    # One of all received frames came after the drop.
    assert small.counters.dropped_in == offered - (heard - 1) > 0
    small.close()


def test_an_interface_that_goes_down_is_detected_and_comes_back(
    ports: dict[str, SocketcanPort], clock: WallClock
) -> None:
    sender, tap = ports["vobc"], ports["tap"]
    ip(f"link set {NAME} down")
    for _ in range(3):
        assert tap.receive(clock.now_ns()) == []
    sender.send(clock.now_ns(), 0x101, b"")
    assert [tap.alive, sender.alive] == [False, False]
    assert (tap.counters.errors, sender.counters.errors) == (1, 1)
    assert (sender.counters.sent, sender.counters.dropped_out) == (0, 1)

    ip(f"link set {NAME} up")
    sender.send(clock.now_ns(), 0x101, b"again")

    assert [frame.data for frame in hear(tap, 1, clock)] == [b"again"]
    assert [tap.alive, sender.alive] == [True, True]


def test_a_removed_interface_is_detected(ports: dict[str, SocketcanPort], clock: WallClock) -> None:
    ip(f"link del {NAME}")

    assert ports["tap"].receive(clock.now_ns()) == []
    ports["vobc"].send(clock.now_ns(), 0x101, b"")
    assert not ports["tap"].alive
    assert not ports["vobc"].alive
    assert ports["vobc"].counters.dropped_out == 1


def test_a_closed_port_is_quiet(ports: dict[str, SocketcanPort], clock: WallClock) -> None:
    port = ports["vobc"]
    port.close()
    port.close()
    port.send(clock.now_ns(), 0x101, b"")

    assert list(port.receive(clock.now_ns())) == []
    assert (port.counters.dropped_out, port.counters.errors) == (1, 0)


@pytest.mark.parametrize(("can_id", "data"), [(0x800, b""), (-1, b""), (1, bytes(9))])
def test_an_impossible_frame_is_an_error_of_the_caller(
    ports: dict[str, SocketcanPort], can_id: int, data: bytes
) -> None:
    with pytest.raises(ValueError, match="frame"):
        ports["vobc"].send(0, can_id, data)


def test_an_interface_that_is_down_is_refused_with_the_remedy(clock: WallClock) -> None:
    ip(f"link set {NAME} down")

    with pytest.raises(BusError, match=f"the interface is down; `ip link set {NAME} up`"):
        open_can(SPEC, clock=clock, node="vobc")
    assert resolve_auto(NAME).spec is None


@pytest.mark.parametrize(
    ("name", "words"),
    [("missing0", "there is no interface missing0"), ("lo", "is no CAN interface")],
)
def test_an_interface_that_is_no_can_bus_is_refused(
    clock: WallClock, name: str, words: str
) -> None:
    with pytest.raises(BusError, match=words):
        open_can(f"socketcan:{name}", clock=clock, node="vobc")


def test_the_interface_counts_as_virtual_and_auto_finds_it() -> None:
    assert look_up(NAME) == Interface(is_can=True, is_up=True, kind="vcan")
    assert is_virtual(SPEC)
    assert not is_virtual("socketcan:lo")
    assert resolve_auto(NAME).spec == SPEC


def test_a_received_frame_equals_the_sent_one(
    ports: dict[str, SocketcanPort], clock: WallClock
) -> None:
    ports["vobc"].send(clock.now_ns(), 0x101, b"ab")
    (frame,) = hear(ports["bcu"], 1, clock)

    assert frame == CanFrame(frame.stamp_ns, 0x101, b"ab")
    assert type(frame) is CanFrame
