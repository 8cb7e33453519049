"""Read-only formats: captures, CSV, SQLite, and text logs of other programs."""

import os
import shutil
import struct
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import can
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canlog import Frames, LogError, read, stream
from canlog.command import main
from canlog.frames import BRS, ERROR, ESI, EXTENDED, FD, REMOTE, TX, concat

US = 1000
START_US = 1_700_000_000_000_000


@dataclass(frozen=True, slots=True)
class Made:
    """A frame that each of the formats can hold."""

    at_us: int
    identifier: int
    extended: bool
    data: bytes


def made(most: int, *, step_us: int = 1, first_us: int = START_US) -> st.SearchStrategy[list[Made]]:
    """Strategy for lists of frames of up to this many bytes, with rising or equal stamps."""
    one = st.tuples(st.integers(0, 10_000), st.integers(0, 0x7FF), st.booleans(),
                    st.binary(max_size=most))  # fmt: skip

    def listed(told: list[tuple[int, int, bool, bytes]]) -> list[Made]:
        at_us, found = first_us, []
        for gap, identifier, wide, data in told:
            at_us += gap * step_us
            found.append(Made(at_us, identifier + 0x800 * wide, wide, data))
        return found

    return st.lists(one, min_size=1, max_size=12).map(listed)


def told(frames: Frames) -> list[tuple[int, int, bool, bytes]]:
    return [
        (
            int(frames.at_ns[at]) // US,
            int(frames.identifier[at]),
            bool(frames.flags[at] & EXTENDED),
            frames.payload(at),
        )
        for at in range(len(frames))
    ]


def wanted(frames: Sequence[Made]) -> list[tuple[int, int, bool, bytes]]:
    return [(each.at_us, each.identifier, each.extended, each.data) for each in frames]


def socketcan(frame: Made, *, flags: int = 0, size: int = 16) -> bytes:
    """Return a `can_frame` or `canfd_frame` with its identifier in network byte order."""
    wide = frame.identifier | (frame.extended << 31)
    head = struct.pack(">IBBBB", wide, len(frame.data), flags, 0, 0)
    return (head + frame.data).ljust(size, b"\0")


def pcap(frames: Sequence[Made], order: str = "<", *, link: int = 227, fine: bool = False) -> bytes:
    """Return a capture in the format that Wireshark's pages describe."""
    magic = 0xA1B23C4D if fine else 0xA1B2C3D4
    out = struct.pack(f"{order}IHHiIII", magic, 2, 4, 0, 0, 65535, link)
    for each in frames:
        second, past_us = divmod(each.at_us, 1_000_000)
        packet = socketcan(each)
        if link == 113:
            packet = struct.pack(">HHH8sH", 4, 280, 0, b"", 0x000C) + packet
        elif link == 276:
            packet = struct.pack(">HHIHBB8s", 0x000C, 0, 3, 280, 0, 0, b"") + packet
        size = len(packet)
        out += struct.pack(f"{order}IIII", second, past_us * (1000 if fine else 1), size, size)
        out += packet
    return out


def block(order: str, kind: int, body: bytes) -> bytes:
    body += bytes(-len(body) % 4)
    size = len(body) + 12
    return struct.pack(f"{order}II", kind, size) + body + struct.pack(f"{order}I", size)


def pcapng(frames: Sequence[Made], order: str = "<", names: Sequence[str] = ("can3",)) -> bytes:
    """Return one section with alternating named interfaces and stamps in nanoseconds."""
    out = block(order, 0x0A0D0D0A, struct.pack(f"{order}IHHq", 0x1A2B3C4D, 1, 0, -1))
    for name in names:
        raw = name.encode()
        told = struct.pack(f"{order}HH", 2, len(raw)) + raw + bytes(-len(raw) % 4)
        told += struct.pack(f"{order}HHB3x", 9, 1, 9) + bytes(4)
        out += block(order, 1, struct.pack(f"{order}HHI", 227, 0, 0) + told)
    for at, each in enumerate(frames):
        packet = socketcan(each)
        ticks = each.at_us * 1000
        head = struct.pack(
            f"{order}IIIII", at % len(names), ticks >> 32, ticks & 0xFFFFFFFF, 16, 16
        )
        out += block(order, 6, head + packet + struct.pack(f"{order}HHI", 2, 4, 2) + bytes(4))
    return out


def gvret(frames: Sequence[Made]) -> bytes:
    lines = ["Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8"]
    for each in frames:
        data = [f"{byte:02X}" for byte in each.data] + ["00"] * (8 - len(each.data))
        wide = "true" if each.extended else "false"
        head = f"{each.at_us},{each.identifier:08X},{wide},Rx,0,{len(each.data)}"
        lines.append(f"{head},{','.join(data)},")
    return "".join(f"{line}\n" for line in lines).encode()


def busmaster(frames: Sequence[Made]) -> bytes:
    """Return a log with decimal numbers and stamps since the start."""
    out = (
        "***BUSMASTER Ver 3.2.2***\n***PROTOCOL CAN***\n***[START LOGGING SESSION]***\n"
        "***START DATE AND TIME 14:11:2023 22:13:20:000***\n***DEC***\n***ABSOLUTE MODE***\n"
        "***<Time><Tx/Rx><Channel><CAN ID><Type><DLC><DataBytes>***\n"
    )
    for each in frames:
        past = (each.at_us - START_US) // 100
        clock = f"{past // 36_000_000:02d}:{past // 600_000 % 60:02d}:{past // 10_000 % 60:02d}"
        kind, data = "x" if each.extended else "s", " ".join(str(byte) for byte in each.data)
        head = f"{clock}:{past % 10_000:04d} Rx 1 {each.identifier} {kind} {len(each.data)}"
        out += f"{head} {data} \n"
    return (out + "***[STOP LOGGING SESSION]***\n").encode()


def kvaser(frames: Sequence[Made]) -> bytes:
    out = "Chn Identifier Flg   DLC  D0...1...2...3...4...5...6..D7       Time     Dir\n"
    for each in frames:
        data = "".join(f"{byte:02X}  " for byte in each.data).ljust(32)
        flag = "X" if each.extended else " "
        stamp = f"{each.at_us / 1e6:.6f}"
        out += (
            f" 0    {each.identifier:08X} {flag}      {len(each.data):2d}  {data} {stamp:>14} R\n"
        )
    return out.encode()


def microchip(frames: Sequence[Made]) -> bytes:
    line = "//---------------------------------\n"
    out = f"{line}Microchip Technology Inc.\nCAN BUS Analyzer\nSavvyCAN Exporter\n"
    out += f"Logging Started: 14/11/2023 22:13:20\n{line}"
    for each in frames:
        data = "".join(f"0x{byte:02X};" for byte in each.data)
        past_ms = (each.at_us - START_US) // 1000
        out += f"{past_ms};RX;0x{each.identifier:08X};{len(each.data)};{data}\n"
    return out.encode()


WRITERS: Sequence[tuple[str, str, Callable[[Sequence[Made]], bytes], int]] = (
    ("pcap", "x.pcap", pcap, 1),
    ("pcap", "x.pcapng", pcapng, 1),
    ("gvret", "x.csv", gvret, 1),
    ("busmaster", "x.log", busmaster, 100),
    ("microchip", "x.txt", microchip, 1000),
)


@pytest.mark.parametrize(("form", "name", "writer", "step_us"), WRITERS)
@given(data=st.data())
@settings(max_examples=25, deadline=None)
def test_every_frame_comes_back(
    form: str,
    name: str,
    writer: Callable[[Sequence[Made]], bytes],
    step_us: int,
    data: st.DataObject,
) -> None:
    frames = data.draw(made(8, step_us=step_us))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_bytes(writer(frames))
        source = stream(path)
        found = concat(list(source))

    assert source.format == form
    assert told(found) == wanted(frames)
    assert {each.kind for each in source.warnings} <= {"local time"}


@given(frames=made(8, first_us=5_000_000))
@settings(max_examples=25, deadline=None)
def test_kvaser_counts_from_the_start(frames: list[Made]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.txt"
        path.write_bytes(kvaser(frames))
        log = read(path)

    assert told(log.frames) == wanted(frames)
    assert {each.kind for each in log.warnings} == {"no date"}


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(("link", "fine"), [(227, True), (113, False), (276, False)])
def test_captures_of_any_order_and_head(
    tmp_path: Path, order: str, link: int, *, fine: bool
) -> None:
    frames = [Made(START_US + at, 0x100 + at, bool(at % 2), bytes([at] * at)) for at in range(9)]
    frames = [Made(each.at_us, each.identifier + 0x800 * each.extended, *(each.extended, each.data))
              for each in frames]  # fmt: skip
    path = tmp_path / "x.pcap"
    path.write_bytes(pcap(frames, order, link=link, fine=fine))

    found = read(path).frames

    assert told(found) == wanted(frames)
    assert ((found.flags & TX) != 0).tolist() == [link == 113] * 9


@pytest.mark.parametrize("order", ["<", ">"])
def test_interfaces_of_a_capture_are_channels(tmp_path: Path, order: str) -> None:
    frames = [Made(START_US + at, at, False, b"") for at in range(4)]
    path = tmp_path / "x.pcapng"
    path.write_bytes(pcapng(frames, order, ["can0", "vcan7"]))

    found = read(path).frames

    assert [found.channels[at] for at in found.channel] == ["can0", "vcan7"] * 2
    assert found.flags.tolist() == [TX] * 4


def test_flags_of_captured_frames(tmp_path: Path) -> None:
    short, long = Made(START_US, 0x123, False, b"\1\2"), Made(START_US, 0x123, False, bytes(12))
    packets = [
        (socketcan(short), 0),
        (socketcan(short, flags=4), FD),
        (socketcan(short, size=72), FD),
        (socketcan(long, flags=5, size=72), FD | BRS),
        (socketcan(long, flags=6, size=20), FD | ESI),
        (struct.pack(">IBBBB", 0x40000123, 4, 0, 0, 0), REMOTE),
        (struct.pack(">IBBBB8s", 0x20000004, 8, 0, 0, 0, b"\0\4"), ERROR),
    ]
    out = pcap([])
    for packet, _ in packets:
        out += struct.pack("<IIII", 1, 0, len(packet), len(packet)) + packet
    path = tmp_path / "x.pcap"
    path.write_bytes(out)

    log = read(path)

    assert log.frames.flags.tolist() == [flags for _, flags in packets]
    assert log.frames.length.tolist() == [2, 2, 2, 12, 12, 4, 8]
    assert int(log.frames.identifier[-1]) == 4
    assert log.warnings == ()


@pytest.mark.parametrize("form", ["pcap", "pcapng"])
def test_what_wireshark_writes_is_read(tmp_path: Path, form: str) -> None:
    """Without Wireshark's text2pcap, the capture of this module takes its place."""
    frames = [Made(START_US + 7 * at, 0x100 + at, False, bytes(range(at))) for at in range(9)]
    frames.append(Made(START_US + 1_000_000, 0x18FEF100, True, b"\xff" * 8))
    path, program = tmp_path / f"x.{form}", shutil.which("text2pcap")
    if program is None:
        path.write_bytes(pcap(frames) if form == "pcap" else pcapng(frames))
    else:
        dump = tmp_path / "x.txt"
        with dump.open("w") as out:
            for each in frames:
                second, past_us = divmod(each.at_us, 1_000_000)
                out.write(f"{second}.{past_us:06d}\n0000 {socketcan(each).hex(' ')}\n\n")
        words = [program, "-F", form, "-l", "227", "-t", "%s.%f", str(dump), str(path)]
        subprocess.run(words, capture_output=True, check=True, env=os.environ | {"TZ": "UTC"})

    found = stream(path)

    assert told(concat(list(found))) == wanted(frames)
    assert found.warnings == ()


def test_packets_of_other_networks_are_skipped_and_a_torn_end_is_told(tmp_path: Path) -> None:
    frames = [Made(START_US, 0x123, False, b"\1")]
    path = tmp_path / "x.pcap"
    path.write_bytes(pcap(frames, link=1))
    source = stream(path)
    assert len(concat(list(source))) == 0
    assert source.skipped == {"packet of no CAN bus": 1}

    path.write_bytes(pcap(frames * 2)[:-3])
    log = read(path)
    assert len(log) == 1
    assert [each.kind for each in log.warnings] == ["torn file"]


@pytest.mark.parametrize(
    ("name", "writer", "form"),
    [("x.csv", can.CSVWriter, "python-can"), ("x.db", can.SqliteWriter, "sqlite")],
)
def test_what_python_can_writes_is_read(tmp_path: Path, name: str, writer: type, form: str) -> None:
    noise = np.random.default_rng(7)
    messages = [
        can.Message(
            timestamp=1_700_000_000 + at / 1000,
            arbitration_id=int(noise.integers(0, 0x800)),
            is_extended_id=bool(at % 2),
            is_remote_frame=at % 7 == 0,
            is_fd=at % 5 == 1,
            dlc=(at % 9) if at % 5 != 1 else 12,
            data=None if at % 7 == 0 else noise.bytes(12 if at % 5 == 1 else at % 9),
        )
        for at in range(60)
        if not (at % 7 == 0 and at % 5 == 1)
    ]
    with writer(str(tmp_path / name)) as out:
        for each in messages:
            out.on_message_received(each)

    source = stream(tmp_path / name)
    found = concat(list(source))

    assert source.format == form
    assert source.warnings == ()
    assert found.identifier.tolist() == [each.arbitration_id for each in messages]
    assert [found.payload(at) for at in range(len(found))] == [
        bytes(each.data) for each in messages
    ]
    assert found.length.tolist() == [each.dlc for each in messages]
    assert ((found.flags & REMOTE) != 0).tolist() == [each.is_remote_frame for each in messages]
    apart = found.at_ns - np.array([round(each.timestamp * 1e9) for each in messages])
    assert int(np.abs(apart).max()) <= 500


def test_busmaster_in_system_mode_counts_over_midnight(tmp_path: Path) -> None:
    path = tmp_path / "x.log"
    path.write_text(
        "***BUSMASTER Ver 3.2.2***\n***START DATE AND TIME 23:9:2015 22:17:28:928***\n***HEX***\n"
        "***SYSTEM MODE***\n23:59:59:9905 Rx 1 0x306 s 8 8E 2A C4 2A BD 2A A7 2A \n"
        "00:00:00:0000 Tx 2 0x18FEF100 x 2 AA BB\n00:00:00:5000 Rx 1 0x123 sr 4\n"
        "***END DATE AND TIME 23:9:2015 23:25:22:312***\n***[STOP LOGGING SESSION]***\n"
    )

    frames = read(path).frames

    assert [str(np.datetime64(at, "ns"))[:23] for at in frames.at_ns.tolist()] == [
        "2015-09-23T23:59:59.990", "2015-09-24T00:00:00.000", "2015-09-24T00:00:00.500",
    ]  # fmt: skip
    assert frames.flags.tolist() == [0, EXTENDED | TX, REMOTE]
    assert frames.length.tolist() == [8, 2, 4]


@pytest.mark.parametrize(
    ("name", "content", "seems"),
    [
        ("x.bin", b"\x00\x01\x02", "binary data"),
        ("x.log", b"%PDF-1.4 \xe2\xe3\n", "a PDF document"),
        ("x.asc", b"PK\x03\x04....", "a ZIP archive"),
        ("x.csv", b"time,speed,brake,door\n1,2,3,4\n", "a CSV table"),
        ("x.txt", b"166.064000 R11 0000021A FE 36\n", "a CRTD log"),
        ("x.log", b'VERSION ""\nBU_: A\n', "a DBC file"),
        ("x.dat", b"Dear Sir,\nthe train\n", "text that begins 'Dear Sir,'"),
        ("x.txt", b'{"a": 1}\n', "a JSON file"),
    ],
)
@pytest.mark.parametrize("verb", ["show", "stats", "convert"])
def test_a_foreign_file_is_refused_with_what_it_looks_like(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    name: str,
    content: bytes,
    seems: str,
    verb: str,
) -> None:
    (tmp_path / name).write_bytes(content)
    target = [str(tmp_path / "y.blf")] if verb == "convert" else []

    code = main([verb, str(tmp_path / name), *target])

    said = capsys.readouterr()
    assert code == 2
    assert f"it looks like {seems}" in said.err
    assert not (tmp_path / "y.blf").exists()


def test_a_format_that_is_only_read_is_no_target(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "x.log").write_text("(1.000000) can0 123#01\n")

    assert main(["convert", str(tmp_path / "x.log"), str(tmp_path / "y.pcap")]) == 2

    assert "pcap is only read; --to takes blf" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "writer"), [*((each[1], each[2]) for each in WRITERS), ("x.txt", kvaser)]
)
@given(seed=st.integers(0, 1 << 32), data=st.binary(max_size=20))
@settings(max_examples=25, deadline=None)
def test_damaged_files_are_read_or_refused(
    name: str, writer: Callable[[Sequence[Made]], bytes], seed: int, data: bytes
) -> None:
    frames = [Made(START_US + 1000 * at, at, False, bytes(at % 9)) for at in range(20)]
    content = bytearray(writer(frames))
    at = seed % len(content)
    content[at : at + len(data)] = data
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_bytes(content[: len(content) - seed % 40])
        try:
            found = read(path).frames
        except LogError as error:
            said = str(error)
            assert name in said
            return

    assert (found.length <= 64).all()
    assert ((found.identifier <= 0x7FF) | ((found.flags & (EXTENDED | ERROR)) != 0)).all()


def test_a_damaged_database_is_read_or_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.db"
    with can.SqliteWriter(str(path)) as out:
        for at in range(50):
            out.on_message_received(can.Message(timestamp=at, arbitration_id=at, data=b"\1"))
    content = path.read_bytes()

    path.write_bytes(content[:1500])
    with pytest.raises(LogError, match=r"x\.db"):
        read(path)
    path.write_bytes(content[:16])
    with pytest.raises(LogError, match=r"x\.db"):
        read(path)
