"""The tag reader's line over a real pseudo-terminal: plugged, unplugged, ignored and misused."""

import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from firmware_py.ports import LinkCounters, SerialChunk, SerialPort
from firmware_py.tag_reader.serial_line import PtyLine, SerialError, open_pty, open_serial
from firmware_py.tag_reader.telegram import TagTelegram, TelegramParser, encode
from firmware_py.trackdb import TagKind

MS = 1_000_000
TAG = TagTelegram(1, 42, TagKind.T1, 10.0, 12.0, 99)
PATIENCE_S = 3.0


@pytest.fixture
def plant() -> Iterator[tuple[PtyLine, str]]:
    line, path = open_pty()
    yield line, path
    line.close()


def hear(port: SerialPort, count: int) -> bytes:
    """Receive until `count` bytes have arrived; the kernel delivers them with a delay."""
    data = b""
    deadline_s = time.monotonic() + PATIENCE_S
    while len(data) < count and time.monotonic() < deadline_s:
        for chunk in port.receive(7 * MS):
            assert chunk.stamp_ns == 7 * MS
            data += chunk.data
        time.sleep(0.001)
    return data


def test_every_byte_passes_unchanged_both_ways(plant: tuple[PtyLine, str]) -> None:
    reader, path = plant
    controller = open_serial(path)
    every_byte = bytes(range(256)) * 4

    reader.send(0, every_byte)
    controller.send(0, every_byte)

    assert hear(controller, 1024) == every_byte
    assert hear(reader, 1024) == every_byte
    assert reader.counters.sent == controller.counters.received == 1024
    controller.close()


def test_telegrams_pass_the_line(plant: tuple[PtyLine, str]) -> None:
    reader, path = plant
    controller = open_serial(Path(path))
    frame = encode(TAG)

    reader.send(0, frame)

    assert TelegramParser().feed(hear(controller, len(frame))) == [TAG]
    controller.close()


def test_no_bytes_are_kept_for_a_controller_that_is_not_there_yet(
    plant: tuple[PtyLine, str],
) -> None:
    reader, path = plant
    reader.send(0, b"lost without a reader")

    controller = open_serial(path)
    reader.send(0, b"but this")

    assert hear(controller, 8) == b"but this"
    assert reader.counters.dropped_out == len(b"lost without a reader")
    controller.close()


class PlainReader:
    """A program that opens the path like a file and knows nothing of serial lines."""

    def __init__(self, path: str) -> None:
        self.counters = LinkCounters()
        self._file = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)

    def send(self, now_ns: int, data: bytes) -> None:
        os.write(self._file, data)

    def receive(self, now_ns: int) -> list[SerialChunk]:
        try:
            return [SerialChunk(now_ns, os.read(self._file, 4096))]
        except BlockingIOError:
            return []

    def close(self) -> None:
        os.close(self._file)


@pytest.mark.parametrize("opened", [open_serial, PlainReader])
def test_a_returning_reader_receives_no_old_bytes(
    plant: tuple[PtyLine, str], opened: Callable[[str], SerialPort]
) -> None:
    reader, path = plant
    for number in range(5):
        listener = opened(path)
        reader.send(0, b"now %d" % number)
        assert hear(listener, 5) == b"now %d" % number
        reader.send(0, b"never read" * 2000)
        listener.close()
        # The plant detects this at its next transmission.
        reader.send(0, b"missed")

    assert reader.counters.dropped_out >= 5 * len(b"missed")


def test_any_program_may_read_and_causes_no_echo(plant: tuple[PtyLine, str]) -> None:
    """A terminal that is not raw would alter line ends, act on control bytes and send an echo."""
    reader, path = plant
    listener = PlainReader(path)
    every_byte = bytes(range(256))

    reader.send(0, every_byte)

    assert hear(listener, 256) == every_byte
    assert list(reader.receive(0)) == []
    listener.close()


def test_a_controller_that_does_not_read_never_blocks_the_plant(
    plant: tuple[PtyLine, str],
) -> None:
    reader, path = plant
    controller = open_serial(path)
    for _ in range(1000):
        reader.send(0, b"x" * 1000)

    assert reader.counters.dropped_out > 500_000
    assert reader.counters.sent + reader.counters.dropped_out == 1_000_000
    assert len(hear(controller, reader.counters.sent)) == reader.counters.sent
    controller.close()


def test_a_full_line_never_blocks_the_controller(
    plant: tuple[PtyLine, str],
) -> None:
    _, path = plant
    controller = open_serial(path)
    for _ in range(1000):
        controller.send(0, b"x" * 1000)

    assert controller.counters.dropped_out > 500_000
    assert controller.counters.sent + controller.counters.dropped_out == 1_000_000
    assert controller.connected
    controller.close()


def test_an_unplugged_line_is_retried_and_found(tmp_path: Path) -> None:
    link = tmp_path / "tags"
    first, first_path = open_pty()
    link.symlink_to(first_path)
    controller = open_serial(link)
    first.close()

    assert list(controller.receive(1000 * MS)) == []
    assert (controller.connected, controller.disconnects) == (False, 1)

    second, second_path = open_pty()
    link.unlink()
    link.symlink_to(second_path)
    assert list(controller.receive(1099 * MS)) == []
    assert not controller.connected
    controller.receive(1100 * MS)
    assert (controller.connected, controller.reconnects) == (True, 1)
    second.send(0, b"back")
    assert hear(controller, 4) == b"back"
    controller.close()
    second.close()


def test_a_missing_line_is_retried_ever_more_rarely_but_always(
    tmp_path: Path,
) -> None:
    link = tmp_path / "tags"
    plant, path = open_pty()
    link.symlink_to(path)
    controller = open_serial(link)
    plant.close()
    link.unlink()

    tried_ms = []
    for now_ms in range(0, 60_000, 50):
        before = controller.counters.errors
        controller.receive(now_ms * MS)
        controller.send(now_ms * MS, b"x")
        if controller.counters.errors > before:
            tried_ms.append(now_ms)

    # The line is lost at 0; retries come 0.1, 0.2, 0.4, 0.8 and 1.6 s apart, then every two
    # seconds.
    assert tried_ms[:6] == [0, 100, 300, 700, 1500, 3100]
    assert tried_ms[6:] == list(range(5100, 60_000, 2000))
    assert controller.counters.dropped_out == 1200


def test_sending_into_an_unplugged_line_does_not_crash(tmp_path: Path) -> None:
    plant, path = open_pty()
    controller = open_serial(path)
    plant.close()

    controller.send(0, b"abc")

    assert not controller.connected
    assert controller.counters.dropped_out == 3
    controller.close()
    assert list(controller.receive(10**12)) == []


def test_a_closed_pseudo_terminal_neither_sends_nor_receives(plant: tuple[PtyLine, str]) -> None:
    reader, _ = plant
    reader.close()
    reader.send(0, b"abc")

    assert list(reader.receive(0)) == []
    assert reader.counters.dropped_out == 3


def test_a_line_belongs_to_one_program(plant: tuple[PtyLine, str]) -> None:
    _, path = plant
    controller = open_serial(path)

    with pytest.raises(SerialError, match=f"{path}: in use by another program"):
        open_serial(path)

    controller.close()
    open_serial(path).close()


def test_a_missing_line_is_named(tmp_path: Path) -> None:
    dangling = tmp_path / "dangling"
    dangling.symlink_to(tmp_path / "nothing")

    for path in (tmp_path / "ttyUSB0", dangling):
        with pytest.raises(SerialError, match=f"{path}: no such device"):
            open_serial(path)


def test_a_path_that_is_no_serial_line_is_named(tmp_path: Path) -> None:
    plain = tmp_path / "plain"
    plain.write_bytes(b"")
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)

    for path in (plain, fifo, Path("/dev/null")):
        with pytest.raises(SerialError, match=f"{path}: not a serial line"):
            open_serial(path)
    with pytest.raises(SerialError, match=f"{tmp_path}: a directory"):
        open_serial(tmp_path)


def test_missing_rights_are_named(plant: tuple[PtyLine, str]) -> None:
    _, path = plant
    Path(path).chmod(0)
    me = os.geteuid()
    if me == 0:
        os.seteuid(65534)
    try:
        with pytest.raises(SerialError, match=f"{path}: permission denied"):
            open_serial(path)
    finally:
        os.seteuid(me)
