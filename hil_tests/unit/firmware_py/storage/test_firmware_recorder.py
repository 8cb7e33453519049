"""The recorder: lines in the format of can-utils, on the disk in time, and robust against a full
disk."""

import csv
import enum
import hashlib
import math
import subprocess
import sys
from collections.abc import Callable
from decimal import Decimal
from pathlib import Path

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.candump import parse_candump_line, read_candump
from firmware_py.native.core import native_core
from firmware_py.ports import CanFrame
from firmware_py.storage import lines
from firmware_py.storage.errors import RecorderError
from firmware_py.storage.lines import LINES_MAX
from firmware_py.storage.recorder import (
    CandumpWriter,
    LineLog,
    SerialDirection,
    SerialLog,
)
from hil_tests.native_rig import in_both_languages  # noqa: F401

NS_PER_S = 1_000_000_000
STAMP_NS = 1_436_509_052_249_713_999
FULL_DISK = Path("/dev/full")


def frames_of(
    id_max: int,
    data: st.SearchStrategy[bytes],
    *,
    extended: bool = False,
    remote: bool = False,
    error: bool = False,
) -> st.SearchStrategy[CanFrame]:
    """Frames of one kind with any stamp and identifier."""
    return st.builds(
        CanFrame,
        st.integers(0, 2**62),
        st.integers(0, id_max),
        data,
        extended=st.just(extended),
        remote=st.just(remote),
        error=st.just(error),
    )


FRAMES = st.one_of(
    frames_of(0x7FF, st.binary(max_size=8)),
    frames_of(0x1FFFFFFF, st.binary(max_size=8), extended=True),
    frames_of(0x7FF, st.just(b""), remote=True),
    frames_of(0x1FFFFFFF, st.just(b""), extended=True, remote=True),
    frames_of(0x1FFFFFFF, st.binary(min_size=8, max_size=8), error=True),
)


def write_all(path: Path, frames: list[CanFrame]) -> CandumpWriter:
    writer = CandumpWriter(path, "vcan0")
    for frame in frames:
        writer.frame(
            frame.stamp_ns,
            frame.can_id,
            frame.data,
            extended=frame.extended,
            remote=frame.remote,
            error=frame.error,
        )
    writer.close()
    return writer


@pytest.mark.parametrize(
    ("frame", "line"),
    [
        (CanFrame(STAMP_NS, 0x044, bytes.fromhex("2a366c2bba")), "044#2A366C2BBA"),
        (CanFrame(STAMP_NS, 0x7FF, b""), "7FF#"),
        (CanFrame(STAMP_NS, 0x1, b"\x00", extended=True), "00000001#00"),
        (CanFrame(STAMP_NS, 0x1ABCDEFF, b"\xff" * 8, extended=True), "1ABCDEFF#FFFFFFFFFFFFFFFF"),
        (CanFrame(STAMP_NS, 0x123, b"", remote=True), "123#R"),
        (CanFrame(STAMP_NS, 0x123, b"\x00" * 3, remote=True), "123#R3"),
        (CanFrame(STAMP_NS, 0x123, b"", extended=True, remote=True), "00000123#R"),
        (CanFrame(STAMP_NS, 0x004, b"\x00" * 8, error=True), "20000004#0000000000000000"),
    ],
)
def test_a_frame_is_written_as_candump_writes_it(
    frame: CanFrame, line: str, tmp_path: Path
) -> None:
    path = tmp_path / "bus.log"

    write_all(path, [frame])

    assert path.read_text() == f"(1436509052.249713) vcan0 {line}\n"


@pytest.mark.parametrize(
    ("epoch_ns", "text"),
    [
        (0, "(0000000000.000000)"),
        (999, "(0000000000.000000)"),
        (1_000, "(0000000000.000001)"),
        (NS_PER_S - 1, "(0000000000.999999)"),
        (NS_PER_S, "(0000000001.000000)"),
        (9_999_999_999 * NS_PER_S, "(9999999999.000000)"),
    ],
)
def test_a_stamp_is_truncated_to_microseconds_and_never_rounded_up(
    epoch_ns: int, text: str, tmp_path: Path
) -> None:
    path = tmp_path / "bus.log"

    write_all(path, [CanFrame(epoch_ns, 1, b"")])

    assert path.read_text() == f"{text} vcan0 001#\n"


@given(frames=st.lists(FRAMES, max_size=30))
def test_stamps_in_any_order_are_written_exactly(
    frames: list[CanFrame], tmp_path_factory: pytest.TempPathFactory
) -> None:
    """The text of the second is cached between frames; freshly computed decimals must agree."""
    path = tmp_path_factory.mktemp("any") / "bus.log"

    write_all(path, frames)

    for frame, line in zip(frames, path.read_text().splitlines(), strict=True):
        stamp_s = Decimal(line[1 : line.index(")")])
        assert stamp_s == Decimal(frame.stamp_ns // 1000) / 1_000_000


@given(frames=st.lists(FRAMES, max_size=30))
def test_written_frames_are_read_back_to_the_microsecond(
    frames: list[CanFrame], tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("back") / "bus.log"

    write_all(path, frames)
    reader = read_candump(path)

    cut = [frame._replace(stamp_ns=frame.stamp_ns // 1000 * 1000) for frame in frames]
    assert [logged.frame for logged in reader] == cut
    assert {logged.channel for logged in reader} <= {"vcan0"}
    assert reader.bad_lines == 0


@given(frames=st.lists(FRAMES.filter(lambda frame: not frame.error), max_size=30))
def test_python_can_reads_the_same_frames(
    frames: list[CanFrame], tmp_path_factory: pytest.TempPathFactory
) -> None:
    """An independent reader is the oracle; it cannot recognise error frames."""
    path = tmp_path_factory.mktemp("oracle") / "bus.log"

    write_all(path, frames)
    with can.CanutilsLogReader(path) as reader:
        messages = list(reader)

    assert [
        (m.arbitration_id, bytes(m.data), m.is_extended_id, m.is_remote_frame) for m in messages
    ] == [(f.can_id, f.data, f.extended, f.remote) for f in frames]


def test_the_digest_is_that_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "bus.log"
    frames = [CanFrame(k * 300_000_000, 0x100 + k, bytes([k])) for k in range(50)]

    writer = write_all(path, frames)

    assert writer.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert (writer.frames, writer.lost_lines, writer.error) == (50, 0, None)


def test_at_each_full_second_everything_before_is_on_the_disk(tmp_path: Path) -> None:
    path = tmp_path / "bus.log"
    writer = CandumpWriter(path, "vcan0")

    for tenth in range(1, 25):
        writer.frame(STAMP_NS + tenth * NS_PER_S // 10, 0x100, b"")
        on_disk = path.read_text().count("\n")
        # The first stamp is at a quarter second: the 8th and the 18th frame begin a new second.
        assert on_disk == (0 if tenth < 8 else 7 if tenth < 18 else 17)
    writer.close()

    assert path.read_text().count("\n") == 24


def test_a_constant_stamp_does_not_fill_the_memory(tmp_path: Path) -> None:
    path = tmp_path / "bus.log"
    writer = CandumpWriter(path, "vcan0")

    for _ in range(LINES_MAX + 1):
        writer.frame(5, 0x100, b"")

    assert path.read_text().count("\n") == LINES_MAX
    writer.close()


def test_a_killed_process_loses_at_most_its_last_second(tmp_path: Path) -> None:
    """The process logs 10.5 s with ten frames a second and is killed without a chance to close."""
    path = tmp_path / "bus.log"
    program = f"""
import os, signal
from firmware_py.storage.recorder import CandumpWriter, LineLog
bus = CandumpWriter({str(path)!r}, "vcan0")
rows = LineLog({str(tmp_path / "cycles.csv")!r}, ("t_s", "k"))
for k in range(106):
    bus.frame(k * 100_000_000, 0x100, b"")
    rows.row(k / 10, k)
os.kill(os.getpid(), signal.SIGKILL)
"""

    killed = subprocess.run([sys.executable, "-c", program], check=False)

    assert killed.returncode == -9
    assert len(list(read_candump(path))) == 100
    assert (tmp_path / "cycles.csv").read_text().splitlines()[-1] == "9.9,99"


@pytest.mark.parametrize(
    "open_log",
    [
        lambda path: CandumpWriter(path, "vcan0"),
        lambda path: LineLog(path, ("t_s",)),
        lambda path: SerialLog(path),
    ],
)
def test_a_log_that_cannot_be_opened_is_an_error_that_names_the_path(
    open_log: Callable[[Path], object], tmp_path: Path
) -> None:
    for path in (tmp_path / "no" / "such" / "folder.log", tmp_path):
        with pytest.raises(RecorderError) as caught:
            open_log(path)
        assert str(path) in str(caught.value)


def test_a_full_disk_is_counted_and_never_raised() -> None:
    bus, rows = CandumpWriter(FULL_DISK, "vcan0"), LineLog(FULL_DISK, ("t_s", "value"))

    for second in range(5):
        bus.frame(second * NS_PER_S, 0x100, b"")
        rows.row(float(second), 1.0)
    bus.close()
    rows.close()

    # The CSV log loses its header line, too.
    assert (bus.lost_lines, rows.lost_lines) == (5, 6)
    for log in (bus, rows):
        assert log.error == "/dev/full: No space left on device"
    assert bus.sha256 == hashlib.sha256(b"").hexdigest()


class SmallDisk:
    """A file that takes a limited number of bytes at a time and fails without any room."""

    def __init__(self, room: list[int]) -> None:
        self._room = room
        self.taken = b""

    def write(self, block: bytes) -> int:
        room = self._room.pop(0) if self._room else len(block)
        if room == 0:
            raise OSError(28, "No space left on device")
        part = bytes(block[:room])
        self.taken += part
        return len(part)

    def close(self) -> None:
        """Do nothing."""


def test_after_a_torn_line_the_log_goes_on_with_a_whole_one(tmp_path: Path) -> None:
    """The disk takes 40 bytes of the second block, is full for the third, then has room again."""
    path = tmp_path / "bus.log"
    writer = CandumpWriter(path, "vcan0")
    disk = SmallDisk([1000, 40, 0, 0])
    writer._file._file = disk  # type: ignore[assignment]

    for second in range(4):
        for k in range(3):
            writer.frame(second * NS_PER_S + k, 0x100 + k, b"\xaa")
    writer.close()

    path.write_bytes(disk.taken)
    reader = read_candump(path)
    stamps_s = [logged.frame.stamp_ns // NS_PER_S for logged in reader]
    assert stamps_s == [0, 0, 0, 1, 3, 3, 3]
    assert reader.bad_lines == 1
    assert writer.lost_lines == 2 + 3
    assert writer.sha256 == hashlib.sha256(disk.taken).hexdigest()


def test_a_partial_write_is_completed(tmp_path: Path) -> None:
    writer = CandumpWriter(tmp_path / "bus.log", "vcan0")
    disk = SmallDisk([1, 2, 3, 4])
    writer._file._file = disk  # type: ignore[assignment]

    writer.frame(0, 0x123, b"\x01")
    writer.close()

    assert disk.taken == b"(0000000000.000000) vcan0 123#01\n"
    assert (writer.lost_lines, writer.error) == (0, None)


def test_frames_after_closing_are_lost_and_counted(tmp_path: Path) -> None:
    path = tmp_path / "bus.log"
    writer = CandumpWriter(path, "vcan0")
    writer.frame(0, 1, b"")
    writer.close()

    writer.frame(1, 2, b"")
    writer.close()

    assert path.read_text().count("\n") == 1
    assert writer.lost_lines == 1
    assert writer.error is not None


@pytest.mark.parametrize(
    "line",
    [
        "",
        "\n",
        "junk\n",
        "(1436509052.249713) vcan0 044#2A366C2BB\n",
        "(1436509052.249713) vcan0 044#2A366C2BBA00112233\n",
        "(1436509052.249713) vcan0 044#2A366C\x00BBA\n",
        "(1436509052.249713) vcan0 844#00\n",
        "(1436509052.249713) vcan0 FFF#00\n",
        "(1436509052.249713) vcan0 80000000#00\n",
        "(1436509052.249713) vcan0 4000001#00\n",
        "(1436509052.249713) vcan0 044##12233\n",
        "(1436509052.249713) vcan0 044#R9\n",
        "(1436509052.2497) vcan0 044#00\n",
        "(1436509052) vcan0 044#00\n",
        "(-436509052.249713) vcan0 044#00\n",
        "(1436509052.249713) vcan0\n",
        "1436509052.249713 vcan0 044#00\n",
        "(1436509052.249713) vcan0 044#00 X\n",
        "(١٤٣٦٥٠٩٠٥٢.249713) vcan0 044#00\n",
    ],
)
def test_a_line_without_a_frame_is_ignored(line: str) -> None:
    assert parse_candump_line(line) is None


def test_dialects_of_candump_are_understood() -> None:
    """The dialects are: nanoseconds (-N), direction (-x), lower case, a padded interface name,
    CR LF."""
    nanos = parse_candump_line("(0000000001.000000002)  can0 044#2a T\r\n")

    assert nanos is not None
    assert nanos.channel == "can0"
    assert nanos.frame == CanFrame(1_000_000_002, 0x044, b"\x2a")


def test_bad_lines_are_counted_and_the_rest_is_read(tmp_path: Path) -> None:
    path = tmp_path / "bus.log"
    path.write_bytes(
        b"(0000000001.000000) vcan0 001#\n\xff\xfe\x00 junk\n\n"
        b"(0000000002.000000) vcan0 002#00\n(0000000003.0000"
    )

    reader = read_candump(path)

    for _ in range(2):
        assert [logged.frame.can_id for logged in reader] == [1, 2]
        assert reader.bad_lines == 3


def test_a_missing_log_is_an_error_that_names_it(tmp_path: Path) -> None:
    with pytest.raises(RecorderError, match=r"bus\.log: cannot be read: No such file"):
        list(read_candump(tmp_path / "bus.log"))


class Colour(enum.Enum):
    BRIGHT_RED = 7


TEXTS = st.text(st.characters(codec="utf-8", exclude_characters="\x00"), max_size=20)


@given(texts=st.lists(TEXTS, max_size=10))
def test_any_text_is_read_back_by_the_csv_reader(
    texts: list[str], tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("csv") / "rows.csv"
    log = LineLog(path, ("t_s", "a, b", "text"))

    for number, text in enumerate(texts):
        log.row(number, number, text)
    log.close()

    with path.open(newline="", encoding="utf-8") as lines:
        rows = list(csv.reader(lines))
    assert rows[0] == ["t_s", "a, b", "text"]
    assert rows[1:] == [[str(k), str(k), text] for k, text in enumerate(texts)]


@given(st.floats(allow_nan=False))
def test_a_number_keeps_nine_digits(number: float) -> None:
    """The error is at most five units of the tenth digit; infinities survive."""
    blocks: list[bytes] = []
    rows = (native_core() or lines).CsvLines(lambda block, count: blocks.append(block))
    rows.row((0.0, number))
    rows.flush()
    text = blocks[0].decode().rstrip("\n").split(",")[1]

    assert float(text) == number or math.isclose(float(text), number, rel_tol=5e-9)


def test_booleans_enumerations_none_and_nan_have_their_own_form(tmp_path: Path) -> None:
    path = tmp_path / "rows.csv"
    log = LineLog(path, ("t_s", "a", "b", "c", "d", "e", "f"))

    log.row("0.250", True, False, None, Colour.BRIGHT_RED, float("nan"), -3)
    log.close()

    assert path.read_text() == "t_s,a,b,c,d,e,f\n0.250,1,0,,bright_red,nan,-3\n"


def test_rows_reach_the_disk_at_the_next_full_second(tmp_path: Path) -> None:
    path = tmp_path / "rows.csv"
    log = LineLog(path, ("t_s", "k"))
    lengths = []
    for k, t_s in enumerate((0.0, 0.5, 0.999, 1.0, 1.9, 2.0)):
        log.row(t_s, k)
        lengths.append(path.read_text().count("\n"))
    log.close()

    # The header is written at once; each full second writes all rows before it.
    assert lengths == [1, 1, 1, 4, 4, 6]
    assert path.read_text().count("\n") == 7


def test_a_row_of_the_wrong_length_is_a_program_error(tmp_path: Path) -> None:
    log = LineLog(tmp_path / "rows.csv", ("t_s", "a"))

    with pytest.raises(AssertionError, match=r"rows\.csv: 3 values"):
        log.row(0.0, 1, 2)


@pytest.mark.parametrize("columns", [(), ("t_s", ""), ("t_s", "a", "a")])
def test_columns_need_different_names(columns: tuple[str, ...], tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="distinct names"):
        LineLog(tmp_path / "rows.csv", columns)


def test_the_serial_log_has_time_direction_and_bytes(tmp_path: Path) -> None:
    path = tmp_path / "serial.log"
    log = SerialLog(path, start_ns=5 * NS_PER_S)

    log.chunk(6_250_000_000, SerialDirection.TX, b"\x7e\x01")
    log.chunk(6_250_001_000, SerialDirection.RX, b"")
    log.close()

    assert path.read_text() == "t_s,direction,data\n1.250000,tx,7E01\n1.250001,rx,\n"
    assert (log.lost_lines, log.error) == (0, None)
