"""The embedded bus: a hub in this process for its decisions, hub processes for starts and ends."""

import os
import select
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from firmware_py import rendezvous
from firmware_py.buses import BusError, hub_control, open_can, resolve_auto
from firmware_py.buses.embedded import EmbeddedPort, hub_status, open_embedded, start_hub, stop_hub
from firmware_py.buses.hub_server import Hub
from firmware_py.buses.records import (
    RECORD_BYTES,
    Control,
    HubRefusal,
    pack_announcement,
    pack_frame,
    pack_text,
    read_announcement,
)
from firmware_py.clock.clock import LockstepClock, WallClock
from firmware_py.ports import CanFrame

BUS = "hubtest0"
WAIT_S = 20.0
"""Timeout far above every duration here; only a hang reaches it, s."""


@pytest.fixture(autouse=True)
def bench_of_its_own(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    with tempfile.TemporaryDirectory() as folder:
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        yield


class HubHere:
    """A hub that works only on request, so that the test decides every interleaving."""

    def __init__(self, queue_records: int = 1000) -> None:
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        listener.bind(str(rendezvous.hub_socket(BUS)))
        listener.listen()
        self.clock = LockstepClock(start_ns=1_000)
        self.hub = Hub(BUS, listener, self.clock, queue_records=queue_records)

    def work(self) -> None:
        for _ in range(20):
            self.hub.serve_once(0.0)

    def connect(self) -> socket.socket:
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        connection.settimeout(WAIT_S)
        connection.connect(str(rendezvous.hub_socket(BUS)))
        return connection

    def port(self, node: str, accept_ids: list[int] | None = None) -> EmbeddedPort:
        connection = self.connect()
        connection.sendall(pack_text(Control.HELLO, node.encode()))
        self.work()
        greeting = connection.recv(RECORD_BYTES)
        said = read_announcement(greeting)
        assert said is not None
        assert said.control is Control.WELCOME
        return EmbeddedPort(connection, accept_ids, b"")


@pytest.fixture
def here() -> Iterator[HubHere]:
    hub_here = HubHere()
    yield hub_here
    hub_here.hub.close()


def test_every_other_node_receives_a_frame_and_the_sender_does_not(here: HubHere) -> None:
    vobc, brake, tap = here.port("vobc"), here.port("bcu", [0x101]), here.port("tap")
    vobc.send(0, 0x101, b"\x01\x02")
    vobc.send(0, 0x103, b"")
    here.work()

    both = [CanFrame(1_000, 0x101, b"\x01\x02"), CanFrame(1_000, 0x103, b"")]
    assert list(tap.receive(2_000)) == both
    assert list(brake.receive(2_000)) == both[:1]
    assert list(vobc.receive(2_000)) == []
    assert (vobc.counters.sent, tap.counters.received, brake.counters.received) == (2, 2, 1)
    for port in (vobc, brake, tap):
        port.close()


def test_all_nodes_receive_frames_in_one_order(here: HubHere) -> None:
    ports = {name: here.port(name) for name in ("a", "b", "c", "d")}
    for number in range(50):
        for rank, name in enumerate(ports):
            ports[name].send(0, number * 4 + rank, b"")
            if number % 3 == rank:
                here.clock.wait_until(here.clock.now_ns() + 10)
                here.work()
    here.work()

    heard = {name: list(port.receive(10**9)) for name, port in ports.items()}
    tap_view = sorted({frame for frames in heard.values() for frame in frames})
    assert len(tap_view) == 200
    order = {frame.can_id: number for number, frame in enumerate(heard["a"])}
    for name in ("b", "c", "d"):
        common = [order[frame.can_id] for frame in heard[name] if frame.can_id in order]
        assert common == sorted(common)
        assert len(heard[name]) == 150
        stamps = [frame.stamp_ns for frame in heard[name]]
        assert stamps == sorted(stamps)
    for port in ports.values():
        port.close()


@pytest.mark.parametrize("piece", [1, 5, 23, 25])
def test_records_may_arrive_in_pieces(here: HubHere, piece: int) -> None:
    tap = here.port("tap")
    connection = here.connect()
    stream = pack_text(Control.HELLO, b"a name of more than twenty-four bytes")
    stream += pack_frame(0x101, b"one") + pack_frame(0x102, b"two")
    for start in range(0, len(stream), piece):
        connection.sendall(stream[start : start + piece])
        here.work()

    assert [frame.data for frame in tap.receive(2_000)] == [b"one", b"two"]
    assert here.hub.status()["frames"] == 2
    connection.close()
    tap.close()


def test_a_full_queue_drops_frames_and_reports_the_count_and_place_to_the_client(
    here: HubHere,
) -> None:
    """The slow node misses a part; its received and its reported lost frames add up."""
    lazy, lively, sender = here.port("lazy"), here.port("lively"), here.port("sender")
    offered = 20_000
    lively_heard = 0
    for number in range(offered):
        sender.send(0, 0x101, number.to_bytes(4, "big"))
        if number % 50 == 0:
            here.work()
            lively_heard += len(lively.receive(2_000))
    here.work()
    lively_heard += len(lively.receive(2_000))
    assert lively_heard == offered
    assert lively.counters.dropped_in == 0
    assert here.hub.status()["dropped"] != 0

    heard: list[CanFrame] = []
    while frames := lazy.receive(2_000):
        heard += frames
        here.work()
    sender.send(0, 0x102, b"after")
    here.work()
    heard += lazy.receive(2_000)

    assert heard[-1].data == b"after"
    numbers = [int.from_bytes(frame.data, "big") for frame in heard[:-1]]
    assert numbers == list(range(len(numbers)))
    assert lazy.counters.dropped_in == offered - len(numbers) > 0
    assert lazy.counters.errors == 0
    status = here.hub.status()
    lazy.close()
    here.work()
    assert status["dropped"] == here.hub.status()["dropped"] == offered - len(numbers)
    for port in (lively, sender):
        port.close()


def test_the_client_is_informed_of_drops_even_without_later_frames(here: HubHere) -> None:
    lazy, sender = here.port("lazy"), here.port("sender")
    for number in range(20_000):
        sender.send(0, 0x101, b"")
        if number % 50 == 0:
            here.work()
    here.work()

    heard = 0
    while frames := lazy.receive(2_000):
        heard += len(frames)
        here.work()

    assert heard < 20_000
    assert lazy.counters.dropped_in == 20_000 - heard
    lazy.close()
    sender.close()


def test_frames_for_a_stalled_hub_are_dropped_and_counted() -> None:
    """The sender never waits, and it did not send what it could not hand over."""
    here = HubHere(queue_records=100_000)
    sender, tap = here.port("sender"), here.port("tap")
    for _ in range(20_000):
        sender.send(0, 0x101, bytes(8))
    assert sender.counters.dropped_out > 0

    heard = 0
    for _ in range(100):
        here.work()
        sender.receive(2_000)
        heard += len(tap.receive(2_000))

    assert heard == sender.counters.sent
    assert sender.counters.sent + sender.counters.dropped_out == 20_000
    sender.close()
    tap.close()
    here.hub.close()


def test_an_invalid_record_is_counted_and_not_forwarded(here: HubHere) -> None:
    tap = here.port("tap")
    connection = here.connect()
    connection.sendall(pack_text(Control.HELLO, b"noisy"))
    connection.sendall(
        b"\xff" * RECORD_BYTES + pack_frame(0x101, b"x") + b"\x01\0\0\0\x09" + bytes(19)
    )
    here.work()

    assert [frame.can_id for frame in tap.receive(2_000)] == [0x101]
    assert here.hub.status()["malformed"] == 2
    connection.close()
    tap.close()


@pytest.mark.parametrize(
    ("greeting", "reason"),
    [
        (pack_frame(0x101, b""), HubRefusal.NOT_A_HELLO),
        (b"GET / HTTP/1.1\r\nHost: x\r\n\r\n", HubRefusal.NOT_A_HELLO),
        (pack_announcement(Control.WELCOME), HubRefusal.NOT_A_HELLO),
        (pack_announcement(Control.HELLO, 4, version=99) + bytes(24), HubRefusal.WRONG_VERSION),
        (pack_text(Control.HELLO, b""), HubRefusal.BAD_NAME),
        (pack_text(Control.HELLO, b"n" * 65), HubRefusal.BAD_NAME),
        (pack_text(Control.HELLO, b"\xff\xfe"), HubRefusal.BAD_NAME),
    ],
)
def test_a_wrong_greeting_is_refused_with_the_reason(
    here: HubHere, greeting: bytes, reason: HubRefusal
) -> None:
    connection = here.connect()
    connection.sendall(greeting)
    here.work()

    said = read_announcement(connection.recv(RECORD_BYTES))
    assert said is not None
    assert (said.control, said.detail) == (Control.REFUSED, reason)
    connection.close()
    here.work()
    assert here.hub.status()["clients"] == []


def test_the_number_of_clients_is_bounded(here: HubHere) -> None:
    connections = []
    for _ in range(70):
        connections.append(here.connect())
        here.work()

    said = read_announcement(connections[-1].recv(RECORD_BYTES))
    assert said is not None
    assert said.detail == HubRefusal.TOO_MANY_CLIENTS
    for connection in connections:
        connection.close()
    here.work()
    here.port("after the rush").close()


def test_a_vanished_client_disturbs_no_other(here: HubHere) -> None:
    gone, sender, tap = here.port("gone"), here.port("sender"), here.port("tap")
    sender.send(0, 0x101, b"")
    gone.close()
    here.work()
    sender.send(0, 0x102, b"")
    here.work()

    assert [frame.can_id for frame in tap.receive(2_000)] == [0x101, 0x102]
    sender.close()
    tap.close()


def test_a_port_survives_the_silent_end_of_its_hub() -> None:
    here = HubHere()
    port, other = here.port("vobc"), here.port("bcu")
    other.send(0, 0x181, b"last")
    here.work()
    here.hub.close()

    assert [frame.data for frame in port.receive(2_000)] == [b"last"]
    assert port.receive(3_000) == []
    port.send(3_000, 0x101, b"")
    assert not port.alive
    assert (port.counters.errors, port.counters.dropped_out, port.counters.sent) == (1, 1, 0)
    port.close()
    port.send(3_000, 0x101, b"")
    assert port.receive(3_000) == []
    assert port.counters.dropped_out == 2
    other.close()


# Hub processes.


@pytest.fixture
def hub_process() -> Iterator[hub_control.HubHandle]:
    handle = start_hub(BUS, bound=True)
    yield handle
    handle.stop()


def hear(port: EmbeddedPort, count: int, clock: WallClock) -> list[CanFrame]:
    """Receive `count` frames, or fewer if no more arrive within the timeout."""
    heard: list[CanFrame] = []
    while len(heard) < count and port.alive:
        if not select.select([port], [], [], WAIT_S)[0]:
            break
        heard += port.receive(clock.now_ns())
    return heard


def join(node: str) -> EmbeddedPort:
    return open_embedded(BUS, node=node)


def wait_until_dead(port: EmbeddedPort, clock: WallClock) -> None:
    while port.alive and select.select([port], [], [], WAIT_S)[0]:
        port.receive(clock.now_ns())
    assert not port.alive


def test_frames_go_from_port_to_port_with_stamps_of_the_machines_clock(
    hub_process: hub_control.HubHandle,
) -> None:
    clock = WallClock()
    sender = open_can(f"embedded:{BUS}", clock=clock, node="vobc")
    receiver = join("bcu")
    before_ns = clock.now_ns()
    for number in range(100):
        sender.send(clock.now_ns(), number, bytes([number]))

    frames = hear(receiver, 100, clock)

    assert [(frame.can_id, frame.data) for frame in frames] == [
        (number, bytes([number])) for number in range(100)
    ]
    stamps = [frame.stamp_ns for frame in frames]
    assert stamps == sorted(stamps)
    assert before_ns < stamps[0] <= stamps[-1] <= clock.now_ns()
    sender.close()
    receiver.close()


def test_nothing_is_lost_at_two_thousand_frames_a_second(
    hub_process: hub_control.HubHandle,
) -> None:
    """Two senders with 1000 frames/s each and two receivers that read every 50 ms run for a
    second."""
    clock = WallClock()
    senders, receivers = [join("a"), join("b")], [join("c"), join("d")]
    heard: list[list[CanFrame]] = [[], []]
    start_ns = clock.now_ns()
    for millisecond in range(1_000):
        clock.wait_until(start_ns + millisecond * 1_000_000)
        for rank, sender in enumerate(senders):
            sender.send(clock.now_ns(), 0x100 + rank, millisecond.to_bytes(8, "big"))
        if millisecond % 50 == 0:
            for frames, receiver in zip(heard, receivers, strict=True):
                frames += receiver.receive(clock.now_ns())
    for frames, receiver in zip(heard, receivers, strict=True):
        frames += hear(receiver, 2_000 - len(frames), clock)

    for frames, receiver in zip(heard, receivers, strict=True):
        for rank in range(2):
            numbers = [
                int.from_bytes(frame.data, "big")
                for frame in frames
                if frame.can_id == 0x100 + rank
            ]
            assert numbers == list(range(1_000))
        assert receiver.counters.dropped_in == 0
    orders = [[(frame.can_id, frame.data) for frame in frames] for frames in heard]
    assert orders[0] == orders[1]
    status = hub_status(BUS)
    assert status is not None
    assert (status.frames, status.dropped, status.malformed) == (2_000, 0, 0)
    assert {client.node for client in status.clients} == {"a", "b", "c", "d"}
    for port in (*senders, *receivers):
        port.close()


FLAT_OUT = """
import sys
from firmware_py.buses.embedded import open_embedded
port = open_embedded(sys.argv[1], node="flood")
for number in range(int(sys.argv[2])):
    port.send(0, 0x101, number.to_bytes(8, "big"))
while port._outbox:
    port.receive(0)
print(port.counters.sent, port.counters.dropped_out, flush=True)
sys.stdin.read()
"""


def test_flat_out_every_frame_arrives_or_is_counted(hub_process: hub_control.HubHandle) -> None:
    """A process sends as fast as it can; each offered frame is received or counted."""
    clock = WallClock()
    offered = 200_000
    receiver = join("tap")
    flood = subprocess.Popen(
        [sys.executable, "-c", FLAT_OUT, BUS, str(offered)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    frames: list[CanFrame] = []
    assert flood.stdout is not None
    while not select.select([flood.stdout], [], [], 0)[0]:
        select.select([receiver.fileno(), flood.stdout.fileno()], [], [], WAIT_S)
        frames += receiver.receive(clock.now_ns())
    sent, dropped_out = (int(word) for word in flood.stdout.readline().split())
    flood.communicate("")
    while len(frames) + receiver.counters.dropped_in < sent:
        assert select.select([receiver], [], [], WAIT_S)[0], "frames are missing and not counted"
        frames += receiver.receive(clock.now_ns())

    assert sent + dropped_out == offered
    numbers = [int.from_bytes(frame.data, "big") for frame in frames]
    assert numbers == sorted(set(numbers))
    assert len(numbers) + receiver.counters.dropped_in == sent
    assert len(numbers) > 0
    receiver.close()


def test_there_is_only_one_hub_per_name(hub_process: hub_control.HubHandle) -> None:
    with pytest.raises(BusError, match=f"runs already .process {hub_process.pid}"):
        start_hub(BUS, bound=True)

    assert hub_process.running
    status = hub_status(BUS)
    assert status is not None
    assert (status.pid, status.bus, status.bound) == (hub_process.pid, BUS, True)
    assert status.uptime_s >= 0.0


def test_auto_finds_the_hub(hub_process: hub_control.HubHandle) -> None:
    choice = resolve_auto(BUS)

    assert choice.spec == f"embedded:{BUS}"
    assert str(hub_process.pid) in choice.reason


def test_a_killed_hub_is_detected_and_can_be_replaced() -> None:
    clock = WallClock()
    killed = start_hub(BUS, bound=False)
    port = join("vobc")
    os.kill(killed.pid, signal.SIGKILL)
    wait_until_dead(port, clock)
    port.send(clock.now_ns(), 0x101, b"")
    assert (port.counters.errors, port.counters.dropped_out) == (1, 1)
    killed.stop()
    assert rendezvous.hub_socket(BUS).exists()
    assert hub_status(BUS) is None
    assert resolve_auto(BUS).spec is None

    with_stale_socket = start_hub(BUS, bound=True)
    join("vobc").close()
    with_stale_socket.stop()
    port.close()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_hub_ends_cleanly_when_asked(number: signal.Signals) -> None:
    clock = WallClock()
    handle = start_hub(BUS, bound=False)
    port = join("vobc")
    os.kill(handle.pid, number)
    wait_until_dead(port, clock)

    assert handle._process.wait(WAIT_S) == 0
    assert not rendezvous.hub_socket(BUS).exists()
    assert (rendezvous.bench_dir(BUS) / "hub.log").read_text() == ""
    port.close()
    handle.stop()


def test_any_process_may_stop_a_hub_by_name() -> None:
    handle = start_hub(BUS, bound=False)

    assert stop_hub(BUS) is True
    assert handle._process.wait(WAIT_S) == 0
    assert stop_hub(BUS) is False
    handle.stop()


STARTER = """
import sys
from firmware_py.buses.embedded import start_hub
handle = start_hub(sys.argv[1], bound=sys.argv[2] == "bound")
print(handle.pid, flush=True)
sys.stdin.read()
"""


def start_elsewhere(mode: str) -> subprocess.Popen[str]:
    starter = subprocess.Popen(
        [sys.executable, "-c", STARTER, BUS, mode],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert starter.stdout is not None
    assert starter.stdout.readline().strip().isdecimal()
    return starter


def test_a_bound_hub_ends_with_its_starter_in_every_case() -> None:
    starter = start_elsewhere("bound")
    port = join("vobc")

    starter.kill()
    starter.communicate()

    wait_until_dead(port, WallClock())
    port.close()


def test_an_unbound_hub_outlives_its_starter() -> None:
    starter = start_elsewhere("free")
    starter.kill()
    starter.communicate()

    status = hub_status(BUS)
    assert status is not None
    assert not status.bound
    assert stop_hub(BUS)


def test_a_hub_that_hangs_is_an_error_and_not_a_hang(monkeypatch: pytest.MonkeyPatch) -> None:
    """The hub is stopped by a signal: it keeps its lock and its socket and does nothing."""
    monkeypatch.setattr(hub_control, "ANSWER_S", 0.1)
    monkeypatch.setattr(hub_control, "STOP_S", 0.1)
    clock = WallClock()
    handle = start_hub(BUS, bound=False)
    port = join("vobc")
    os.kill(handle.pid, signal.SIGSTOP)

    with pytest.raises(BusError, match="does not answer"):
        join("late")
    with pytest.raises(BusError, match="does not answer"):
        hub_status(BUS)
    assert resolve_auto(BUS).spec is None
    for _ in range(20_000):
        port.send(clock.now_ns(), 0x101, bytes(8))
    assert port.receive(clock.now_ns()) == []
    assert port.counters.dropped_out > 0

    assert stop_hub(BUS) is True
    wait_until_dead(port, clock)
    port.close()
    handle.stop()


def test_another_program_at_the_socket_of_a_hub_is_recognised() -> None:
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    listener.bind(str(rendezvous.hub_socket(BUS)))
    listener.listen()
    answerer = subprocess.Popen(
        [
            sys.executable,
            "-c",
            "import socket, sys\n"
            "listener = socket.socket(fileno=int(sys.argv[1]))\n"
            "connection, _ = listener.accept()\n"
            "connection.recv(100)\n"
            "connection.sendall(b'SSH-2.0-not-a-hub-of-ours')\n",
            str(listener.fileno()),
        ],
        pass_fds=[listener.fileno()],
    )

    with pytest.raises(BusError, match="is not a hub of this project"):
        join("vobc")
    answerer.wait(WAIT_S)
    listener.close()


def test_a_hub_started_by_hand_reports_its_error(capfd: pytest.CaptureFixture[str]) -> None:
    from firmware_py.buses.hub import main

    assert main(["../etc"]) == 1
    assert "hub: bus name '../etc'" in capfd.readouterr().err


def test_other_users_cannot_use_the_folder(
    hub_process: hub_control.HubHandle,
) -> None:
    folder: Path = rendezvous.bench_dir(BUS)

    assert {path.name for path in folder.iterdir()} == {"bus.sock", "hub.log", "hub.pid"}
    assert (folder / "hub.pid").read_text().strip() == str(hub_process.pid)
    assert (folder / "hub.pid").stat().st_mode & 0o077 == 0
