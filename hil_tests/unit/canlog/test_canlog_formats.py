"""Logs survive a round trip through every format, and other programs read the written files."""

import re
import shutil
import struct
import subprocess
import sys
import tempfile
import zlib
from collections.abc import Sequence
from pathlib import Path

import asammdf
import can
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canlog import LogError, ReadOptions, read, stream
from canlog.convert import convert
from canlog.damage import Damages
from canlog.drawn import drawn_frames
from canlog.formats.registry import FORMATS, format_of, named
from canlog.frames import ERROR, FD, REMOTE, TX, Frames, concat
from canlog.rows import from_rows

NAMES = [each.name for each in FORMATS if each.writes]
TEXT_ERRORS = ("asc", "trc")
"""Formats that do not keep the details of error frames."""


def write(folder: Path, form: str, frames: Frames) -> tuple[Path, list[str]]:
    """Write two blocks; return the path and the kinds of loss."""
    path, losses = folder / f"x{named(form).suffixes[0]}", Damages()
    half = len(frames) // 2
    named(form).write(path, [frames[:half], frames[half:]], losses)
    return path, [each.kind for each in losses.all()]


@pytest.mark.parametrize("form", NAMES)
def test_frames_come_back_as_they_were_or_it_is_listed(tmp_path: Path, form: str) -> None:
    frames = drawn_frames(1, 500, fine=form != "trc")

    path, losses = write(tmp_path, form, frames)
    found = read(path)

    assert format_of(path).name == form
    assert [each.kind for each in found.warnings if each.kind != "local time"] == []
    assert found.frames.at_ns.tolist() == frames.at_ns.tolist()
    detail = (frames.flags & ERROR) == 0 if form in TEXT_ERRORS else np.ones(500, np.bool_)
    mask = ~np.uint8(TX) if form == "candump" else np.uint8(0xFF)
    assert (found.frames.flags & mask).tolist() == (frames.flags & mask).tolist()
    for at in np.flatnonzero(detail).tolist():
        assert found.frames.identifier[at] == frames.identifier[at]
        assert found.frames.length[at] == frames.length[at]
        assert found.frames.payload(at) == frames.payload(at)
    names = [found.frames.channels[at] for at in found.frames.channel]
    assert names == [frames.channels[at] for at in frames.channel]
    wanted = {"candump": ["direction"], "asc": ["error detail"], "trc": ["error detail"]}
    assert losses == wanted.get(form, [])


@pytest.mark.parametrize("form", NAMES)
def test_an_empty_log_is_a_log(tmp_path: Path, form: str) -> None:
    path, losses = write(tmp_path, form, drawn_frames(1, 0))

    if form == "candump":
        assert path.read_bytes() == b""
        return
    assert len(read(path)) == 0
    assert losses == []


@pytest.mark.parametrize("form", ["blf", "asc", "trc", "mf4"])
def test_names_that_become_numbers_are_listed(tmp_path: Path, form: str) -> None:
    frames = from_rows(
        [(0, 1, 0, "vcan0", b""), (1000, 2, 0, "can1", b""), (2000, 3, 0, "x y", b"")]
    )

    path, losses = write(tmp_path, form, frames)

    assert "channel name" in losses
    found = read(path).frames
    assert len({found.channels[at] for at in found.channel}) == 3


def test_nanoseconds_that_trc_cannot_hold_are_listed(tmp_path: Path) -> None:
    frames = drawn_frames(2, 50, fine=True)

    path, losses = write(tmp_path, "trc", frames)

    assert "nanoseconds" in losses
    apart = frames.at_ns - read(path).frames.at_ns
    assert apart.min() >= 0
    assert apart.max() < 1000


@pytest.mark.parametrize(
    ("form", "reader"),
    [("candump", can.CanutilsLogReader), ("blf", can.BLFReader), ("asc", can.ASCReader),
     ("trc", can.TRCReader), ("mf4", can.MF4Reader)],
)  # fmt: skip
def test_python_can_reads_what_is_written(tmp_path: Path, form: str, reader: type) -> None:
    frames = drawn_frames(4, 300)
    # python-can reads error frames of candump as data frames, and drops those of TRC.
    keep = (frames.flags & np.uint8(ERROR)) == 0
    # In ASC, python-can reads an empty CAN FD frame as a remote frame.
    keep &= ((frames.flags & np.uint8(FD)) == 0) | (frames.length > 0)
    frames = frames[keep]

    path, _ = write(tmp_path, form, frames)
    found = list(reader(str(path)))

    order = np.argsort(frames.at_ns, kind="stable")
    assert len(found) == len(frames)
    for message, at in zip(found, order.tolist(), strict=True):
        assert message.arbitration_id == frames.identifier[at]
        assert message.is_remote_frame == bool(frames.flags[at] & REMOTE)
        assert message.is_fd == bool(frames.flags[at] & FD)
        assert bytes(message.data) == frames.payload(at)
        # For CAN FD in TRC, python-can returns the length code instead of the length.
        assert message.dlc == frames.length[at] or (form == "trc" and message.is_fd)


@pytest.mark.parametrize(
    ("suffix", "writer"),
    [("log", can.CanutilsLogWriter), ("blf", can.BLFWriter), ("asc", can.ASCWriter),
     ("trc", can.TRCWriter), ("mf4", can.MF4Writer)],
)  # fmt: skip
def test_what_python_can_writes_is_read(tmp_path: Path, suffix: str, writer: type) -> None:
    frames = drawn_frames(5, 300)
    # python-can's TRC writer keeps neither CAN FD nor remote frames.
    left_out = ERROR | FD | REMOTE if suffix == "trc" else ERROR
    frames = frames[(frames.flags & np.uint8(left_out)) == 0]
    path = tmp_path / f"x.{suffix}"
    with writer(str(path)) as out:
        for at in range(len(frames)):
            flags = int(frames.flags[at])
            out.on_message_received(
                can.Message(
                    timestamp=int(frames.at_ns[at]) / 1e9,
                    arbitration_id=int(frames.identifier[at]),
                    is_extended_id=bool(flags & 1),
                    is_remote_frame=bool(flags & REMOTE),
                    is_fd=bool(flags & FD),
                    bitrate_switch=bool(flags & 16),
                    error_state_indicator=bool(flags & 32),
                    dlc=int(frames.length[at]),
                    data=frames.payload(at),
                    channel=0,
                )
            )

    found = read(path).frames

    assert len(found) == len(frames)
    assert found.identifier.tolist() == frames.identifier.tolist()
    assert [found.payload(at) for at in range(len(found))] == [
        frames.payload(at) for at in range(len(frames))
    ]
    ours, theirs = frames.at_ns - frames.at_ns[0], found.at_ns - found.at_ns[0]
    assert int(np.abs(ours - theirs).max()) <= 1000  # python-can keeps stamps as float seconds


def test_asammdf_reads_what_is_written(tmp_path: Path) -> None:
    frames = drawn_frames(6, 200)
    path, _ = write(tmp_path, "mf4", frames)

    with asammdf.MDF(str(path)) as file:
        found = file.get("CAN_DataFrame.ID", group=0)

    data = frames[frames.is_data]
    assert found.samples.tolist() == data.identifier.tolist()


def test_can_utils_reads_what_is_written(tmp_path: Path) -> None:
    program = shutil.which("log2asc")
    frames = drawn_frames(8, 200, classic=True)
    path, _ = write(tmp_path, "candump", frames)
    text = path.read_text()
    if program is not None:
        done = subprocess.run(
            [program, "-I", str(path), "can1", "can2"], capture_output=True, text=True, check=True
        )
        told = [line for line in done.stdout.splitlines() if " Rx " in line or "ErrorFrame" in line]
        assert len(told) == len(frames)
    # The lines have the format of candump -l, even if log2asc is not installed.
    assert len(text.splitlines()) == len(frames)
    line = re.compile(
        r"\(\d{10}\.\d{6}\) can[12] ([0-9A-F]{3}|[0-9A-F]{8})#(R[1-8]?|([0-9A-F]{2}){0,8})"
    )
    assert [each for each in text.splitlines() if not line.fullmatch(each)] == []


def test_cantools_decodes_what_is_written(tmp_path: Path) -> None:
    frames = from_rows([(1_700_000_000_000_000_000, 0x10, 0, "vcan0", b"\x05\x00")])
    path, _ = write(tmp_path, "candump", frames)
    dbc = tmp_path / "x.dbc"
    dbc.write_text('VERSION ""\nBU_: A\nBO_ 16 M: 2 A\n SG_ u : 0|8@1+ (2,0) [0|0] "" A\n')

    done = subprocess.run(
        [sys.executable, "-m", "cantools", "decode", "--single-line", str(dbc)],
        input=path.read_text(), capture_output=True, text=True, check=False,
    )  # fmt: skip

    assert "M(u: 10)" in done.stdout, done.stderr


def containers(path: Path) -> list[tuple[int, int]]:
    """Return offset and size of each container of a BLF file, read from its heads."""
    data, found, at = path.read_bytes(), [], 144
    while at < len(data):
        size = int.from_bytes(data[at + 8 : at + 12], "little")
        found.append((at, size))
        at += size + size % 4
    return found


@pytest.fixture
def blf(tmp_path: Path) -> tuple[Path, Frames]:
    frames = drawn_frames(9, 12_000, classic=True)
    return write(tmp_path, "blf", frames)[0], frames


def test_a_corrupt_container_costs_only_its_own_frames(blf: tuple[Path, Frames]) -> None:
    path, frames = blf
    found = containers(path)
    assert len(found) >= 4
    data = bytearray(path.read_bytes())
    at, size = found[1]
    data[at + 40 : at + size] = b"\x55" * (size - 40)
    path.write_bytes(data)

    log = read(path)

    assert 0.5 * len(frames) < len(log) < len(frames)
    assert any(each.kind == "corrupt container" and at in each.places for each in log.warnings)
    rows = dict.fromkeys(zip(frames.at_ns.tolist(), frames.identifier.tolist(), strict=True), True)
    assert all(
        row in rows
        for row in zip(log.frames.at_ns.tolist(), log.frames.identifier.tolist(), strict=True)
    )
    assert log.frames.at_ns[-1] == frames.at_ns[-1]


@pytest.mark.parametrize("share", [0.3, 0.77, 0.999])
def test_a_torn_file_is_read_up_to_its_last_whole_frame(
    blf: tuple[Path, Frames], share: float
) -> None:
    path, frames = blf
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])

    log = read(path)

    assert 0.8 * share * len(frames) < len(log) < len(frames) or share > 0.99
    assert {"torn file"} <= {each.kind for each in log.warnings}
    assert log.frames.at_ns.tolist() == frames.at_ns[: len(log)].tolist()


def test_junk_between_containers_is_stepped_over(blf: tuple[Path, Frames]) -> None:
    path, frames = blf
    data, (at, _) = path.read_bytes(), containers(path)[2]
    path.write_bytes(data[:at] + b"rubbish!" * 5 + data[at:])

    log = read(path)

    assert any(each.kind == "corrupt block" and at in each.places for each in log.warnings)
    assert len(log) >= len(frames) - 1
    assert log.frames.at_ns[-1] == frames.at_ns[-1]


@pytest.mark.parametrize("inflater", ["libdeflate", "isal", "zlib"])
@pytest.mark.parametrize("compiled", [True, False])
def test_all_ways_through_a_blf_give_the_same(
    blf: tuple[Path, Frames], inflater: str, compiled: bool
) -> None:
    path, frames = blf

    found = read(path, options=ReadOptions(inflater=inflater, compiled=compiled)).frames

    assert found.at_ns.tolist() == frames.at_ns.tolist()
    assert (found.data == frames.data).all()


def test_objects_of_every_kind_of_blf_are_read(tmp_path: Path) -> None:
    """The file has a CAN FD object as newer Vector programs write it, uncompressed, and one in 10
    us.
    """
    head = bytearray(144)
    head[:4], head[4:8] = b"LOGG", (144).to_bytes(4, "little")

    def thing(kind: int, body: bytes, unit: int, stamp: int) -> bytes:
        size = 32 + len(body)
        base = struct.pack("<4sHHLL", b"LOBJ", 32, 1, size, kind)
        return base + struct.pack("<LHHQ", unit, 0, 0, stamp) + body + bytes(size % 4)

    fd = struct.pack("<BBBBLLLLLLLHBBL", 2, 9, 12, 0, 0x123, 0, 0x3000, 0, 0, 0, 0, 0, 1, 0, 0)
    content = thing(101, fd + bytes(range(12)), 2, 5)
    content += thing(96, b"a marker", 2, 6)
    content += thing(1, struct.pack("<HBBL8s", 1, 0x80, 3, 0x7FF, b""), 1, 7)
    container = struct.pack("<4sHHLL", b"LOBJ", 16, 1, 32 + len(content), 10)
    container += struct.pack("<H6xL4x", 0, len(content)) + content
    path = tmp_path / "x.blf"
    path.write_bytes(bytes(head) + container)

    log = read(path)

    assert log.warnings == ()
    assert log.frames.at_ns.tolist() == [5, 70_000]
    assert log.frames.flags.tolist() == [FD | 16 | TX, REMOTE]
    assert log.frames.payload(0) == bytes(range(12))
    assert [log.frames.channels[at] for at in log.frames.channel] == ["can2", "can1"]


def contained(head: bytes, objects: bytes, sizes: Sequence[int]) -> bytes:
    """Return a BLF file with these objects in stored containers of these sizes, and one for the
    rest.
    """
    out, at = head, 0
    for size in (*sizes, len(objects)):
        content, at = objects[at : at + size], at + size
        out += struct.pack("<4sHHLL", b"LOBJ", 16, 1, 32 + len(content), 10)
        out += struct.pack("<H6xL4x", 0, len(content)) + content + bytes(len(content) % 4)
    return out


@given(
    st.lists(st.one_of(st.integers(1, 90), st.integers(1, 3_000)), max_size=40),
    st.booleans(),
    st.lists(st.tuples(st.integers(0, 5_000), st.integers(0, 255)), max_size=2),
)
@settings(max_examples=40, deadline=None)
def test_the_kernel_and_numpy_take_the_same_wherever_containers_end(
    sizes: list[int], classic: bool, damage: list[tuple[int, int]]
) -> None:
    """Both give the same frames and damage; without damage, the frames are those written."""
    frames = drawn_frames(3, 120, classic=classic)
    with tempfile.TemporaryDirectory() as scratch:
        written = write(Path(scratch), "blf", frames)[0]
        data = written.read_bytes()
        packed = (data[at + 32 : at + size] for at, size in containers(written))
        objects = bytearray(b"".join(zlib.decompress(each) for each in packed))
        for at, value in damage:
            objects[at % len(objects)] = value
        path = Path(scratch) / "cut.blf"
        path.write_bytes(contained(data[:144], bytes(objects), sizes))
        one, other = (read(path, options=ReadOptions(compiled=each)) for each in (True, False))

    for name in ("at_ns", "identifier", "flags", "length"):
        assert (getattr(one.frames, name) == getattr(other.frames, name)).all()
    width = min(one.frames.data.shape[1], other.frames.data.shape[1])
    assert (one.frames.data[:, :width] == other.frames.data[:, :width]).all()
    assert [(each.kind, each.count) for each in one.warnings] == [
        (each.kind, each.count) for each in other.warnings
    ]
    if not damage:
        assert one.warnings == ()
        assert one.frames.at_ns.tolist() == frames.at_ns.tolist()


def test_a_container_that_claims_too_much_is_not_believed(tmp_path: Path) -> None:
    packed = zlib.compress(b"\0" * 1000)
    head = bytearray(144)
    head[:4], head[4:8] = b"LOGG", (144).to_bytes(4, "little")
    container = struct.pack("<4sHHLL", b"LOBJ", 16, 1, 32 + len(packed), 10)
    container += struct.pack("<H6xL4x", 2, 0xFFFF_FFFF) + packed
    path = tmp_path / "x.blf"
    path.write_bytes(bytes(head) + container)

    log = read(path)

    assert len(log) == 0
    assert "corrupt container" in {each.kind for each in log.warnings}


ASC = (
    "date Tue Nov 14 10:13:20.500 PM 2023\nbase {base}  timestamps {stamps}\n"
    "internal events logged\n// a comment\nBegin Triggerblock Tue Nov 14 10:13:20.500 PM 2023\n"
    "   0.000000 Start of measurement\n{lines}\nEnd TriggerBlock\n"
)


def test_asc_counts_from_the_date_in_its_head(tmp_path: Path) -> None:
    lines = "   0.000001 1  101             Rx   d 2 0A FF  Length = 100 BitCount = 50 ID = 257"
    (tmp_path / "x.asc").write_text(ASC.format(base="hex", stamps="absolute", lines=lines))

    log = read(tmp_path / "x.asc")
    east = read(tmp_path / "x.asc", options=ReadOptions(utc_offset_s=3600))

    assert log.frames.at_ns.tolist() == [1_700_000_000_500_001_000]
    assert {each.kind for each in log.warnings} == {"local time"}
    assert east.frames.at_ns.tolist() == [1_699_996_400_500_001_000]
    assert east.warnings == ()


def test_asc_relative_stamps_and_decimal_numbers(tmp_path: Path) -> None:
    lines = "1.000000 1 257 Rx d 2 10 255\n0.500000 2 18x Tx d 0\n0.250000 1 257 Rx r"
    (tmp_path / "x.asc").write_text(ASC.format(base="dec", stamps="relative", lines=lines))

    found = read(tmp_path / "x.asc").frames

    assert (found.at_ns - 1_700_000_000_500_000_000).tolist() == [10**9, 15 * 10**8, 175 * 10**7]
    assert found.identifier.tolist() == [257, 18, 257]
    assert found.payload(0) == b"\x0a\xff"
    assert found.flags.tolist() == [0, 1 | TX, REMOTE]


def test_asc_lines_that_are_no_frames_are_counted_and_no_damage(tmp_path: Path) -> None:
    lines = (
        "0.1 1  101 Rx d 2 0A\n0.2 1  101 Rx d 2 0A FF\n0.3 1 Statistic: D 1 R 0\n"
        "0.4 1 ErrorFrame\nwhat is this\n0.5 CANFD 1 Rx 101 name 1 0 9 12 " + "0A " * 12
    )
    (tmp_path / "x.asc").write_text(ASC.format(base="hex", stamps="absolute", lines=lines))

    source = stream(tmp_path / "x.asc")
    flags = concat(list(source)).flags

    assert flags.tolist() == [0, ERROR, FD | 16]
    kinds = {each.kind: (each.count, each.places) for each in source.warnings}
    assert kinds == {"junk line": (2, (7, 11)), "local time": (2, ())}
    assert source.skipped == {"line that is no frame": 1}


@pytest.mark.parametrize(
    ("version", "line"),
    [
        ("1.0", "     1)      1059.9  0123  2  0A FF"),
        ("1.1", "     1)      1059.9  Rx         0123  2  0A FF"),
        ("1.2", "     1)      1059.9 1  Rx         0123  2  0A FF"),
        ("1.3", "     1)      1059.900 1  Rx        0123 -  2    0A FF"),
    ],
)
def test_trc_of_version_one(tmp_path: Path, version: str, line: str) -> None:
    path = tmp_path / "x.trc"
    path.write_text(f";$FILEVERSION={version}\n;$STARTTIME=45244.5\n;\n{line}\n")

    found = read(path).frames

    assert found.at_ns.tolist() == [1_699_963_200_000_000_000 + 1_059_900_000]
    assert (found.identifier.tolist(), found.payload(0)) == ([0x123], b"\x0a\xff")


def test_trc_of_version_two_in_any_order_of_columns(tmp_path: Path) -> None:
    path = tmp_path / "x.trc"
    path.write_text(
        ";$FILEVERSION=2.0\n;$STARTTIME=45244.5\n;$COLUMNS=N,O,T,I,d,l,D\n"
        "      1      1059.900 DT     0123 Rx 2  0A FF\n"
        "      2      1060.000 RR 18FF1000 Tx 4\n"
        "      3      1061.000 FB     0123 Rx 12 " + "0A " * 12 + "\n"
        "      4      1062.000 ST          Rx    00 00 00 08\n"
        "      5      1063.000 DT     0123 Rx 2  0A\n"
    )

    source = stream(path)
    frames = concat(list(source))

    assert frames.flags.tolist() == [0, REMOTE | 1 | TX, FD | 16]
    assert frames.length.tolist() == [2, 4, 12]
    kinds = {each.kind: each.count for each in source.warnings}
    assert kinds == {"local time": 1, "junk line": 1}
    assert source.skipped == {"line that is no frame": 1}


def test_mcap_has_the_signals_of_known_messages_for_foxglove(tmp_path: Path) -> None:
    import json

    from mcap.reader import make_reader

    log = from_rows([(1_000, 0x103, 0, "vcan0", bytes.fromhex("10270000FFFF"))])
    path, _ = write(tmp_path, "mcap", log)

    with path.open("rb") as raw:
        told = {
            channel.topic: json.loads(message.data)
            for _, channel, message in make_reader(raw).iter_messages()
        }

    assert told["/vcan0/TRACTION_CMD"]["force_n"] == 10_000
    assert told["/can/vcan0"]["data"] == "10270000ffff"


def test_converting_keeps_everything_and_says_what_not(tmp_path: Path) -> None:
    frames = drawn_frames(11, 300, fine=True)
    source, _ = write(tmp_path, "blf", frames)

    damaged, lost = convert(source, tmp_path / "y.trc")

    assert damaged == ()
    assert {each.kind for each in lost} == {"nanoseconds", "error detail"}
    with pytest.raises(LogError, match="already exists"):
        convert(source, tmp_path / "y.trc")
    with pytest.raises(LogError, match="its suffix names no known format"):
        convert(source, tmp_path / "y.xyz")


def test_a_log_is_told_by_its_content_before_its_name(tmp_path: Path) -> None:
    frames = drawn_frames(12, 20)
    path, _ = write(tmp_path, "blf", frames)
    path = path.rename(tmp_path / "x.log")

    assert stream(path).format == "blf"
    assert len(read(path)) == 20


def test_files_that_are_no_logs_are_errors_that_name_them(tmp_path: Path) -> None:
    path = tmp_path / "x.bin"
    path.write_bytes(b"\x00\x01")

    with pytest.raises(LogError, match=r"x\.bin: of no known format"):
        read(path)
    with pytest.raises(LogError, match="No such file"):
        read(tmp_path / "absent.log")
    with pytest.raises(LogError, match=r"no bus\.log in this folder"):
        read(tmp_path)


def test_a_stream_gives_the_same_frames_in_bounded_blocks(tmp_path: Path) -> None:
    frames = drawn_frames(13, 3000, classic=True)
    path, _ = write(tmp_path, "asc", frames)

    blocks = list(stream(path, ReadOptions(block_frames=500)))

    assert [len(block) for block in blocks] == [500] * 6
    assert concat(blocks).at_ns.tolist() == frames.at_ns.tolist()
