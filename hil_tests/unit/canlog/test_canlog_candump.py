"""Every line that candump writes becomes the right frame, and no other line becomes one."""

import gzip
import random
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canlog import Log, ReadOptions, kernel, read
from canlog.damage import Damages
from canlog.drawn import drawn_frames
from canlog.formats import candump
from canlog.formats.candump_columns import parse_block
from canlog.formats.candump_line import parse
from canlog.frames import BRS, ERROR, ESI, EXTENDED, FD, REMOTE, TX, Frames

Reads = Callable[..., Log]


@pytest.fixture(params=[True, False], ids=["compiled", "numpy"])
def reads(request: pytest.FixtureRequest, tmp_path: Path) -> Reads:
    """Return a function that reads log text, with or without the kernel."""

    def reads(text: bytes | str, **options: object) -> Log:
        path = tmp_path / "x.log"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read(path, options=ReadOptions(compiled=request.param, **options))  # type: ignore[arg-type]

    return reads


def test_a_compiler_makes_the_kernel_here() -> None:
    """Without a compiler, the tests marked as compiled would test numpy twice."""
    assert kernel.library() is not None


def test_a_logged_line_is_a_frame_with_exact_time(reads: Reads) -> None:
    log = reads("(1700000000.123456) vcan0 101#E8530047C6\n")

    assert log.warnings == ()
    assert log.frames.at_ns.tolist() == [1_700_000_000_123_456_000]
    assert log.frames.identifier.tolist() == [0x101]
    assert log.frames.payload(0) == bytes.fromhex("E8530047C6")
    assert log.frames.channels == ("vcan0",)


def test_nine_digits_are_nanoseconds(reads: Reads) -> None:
    log = reads("(1700000000.123456789) c 101#\n(1700000000.000000001) c 101#\n")

    assert (log.frames.at_ns - 1_700_000_000_000_000_000).tolist() == [123_456_789, 1]


def test_every_kind_of_frame_is_told_apart(reads: Reads) -> None:
    log = reads(
        "(1.000000) c 7FF#01\n(1.000000) c 00000001#02\n(1.000000) c 101#R\n(1.000000) c 101#R4\n"
        "(1.000000) c 20000004#0001000000000000\n(1.000000) c 101##0" + "AB" * 12 + "\n"
        "(1.000000) c 1FFFFFFF##3\n(1.000000) c 101#0102 T\n(1.000000) c 101#0102 R\n"
    )  # fmt: skip

    assert log.warnings == ()
    assert log.frames.flags.tolist() == [
        *(0, EXTENDED, REMOTE, REMOTE, ERROR, FD, FD | EXTENDED | BRS | ESI, TX, 0),
    ]
    assert log.frames.length.tolist() == [1, 1, 0, 4, 8, 12, 0, 2, 2]
    assert log.frames.identifier.tolist()[4] == 4


@pytest.mark.parametrize(
    "line",
    [
        "(1700000000.000000) vcan0 101#CE1",  # a digit is missing: not CE 01
        "(1700000000.000000) vcan0 101#0102030405060708FF",
        "(1700000000.000000) vcan0 801#00",
        "(1700000000.000000) vcan0 1234#00",
        "(1700000000.000000) vcan0 40000000#00",
        "(1700000000.000000) vcan0 101##0010203040506070809",  # no CAN FD frame has nine bytes
        "(1700000000.000000) vcan0 101##",
        "(1700000000.000000) vcan0 101#0G",
        "(1700000000.00000) vcan0 101#00",
        "(17000000x0.000000) vcan0 101#00",
        "(99999999999.000000) vcan0 101#00",  # beyond 64 bits of nanoseconds
        "1700000000.000000) vcan0 101#00",
        "(1700000000.000000)  101#00",
        "# a comment",
        "\x00\x01\x02",
    ],
)
def test_what_is_no_frame_is_counted_and_located(reads: Reads, line: str) -> None:
    good = "(1700000000.000000) vcan0 101#00\n"

    log = reads(good + line + "\n" + good)

    assert len(log) == 2
    (damage,) = log.warnings
    assert (damage.kind, damage.count, damage.unit, damage.places) == ("junk line", 1, "line", (2,))


def test_a_last_line_without_an_end_is_torn_and_left_out(reads: Reads) -> None:
    log = reads("(1700000000.000000) c 101#0102\n(1700000000.000000) c 101#01")

    assert len(log) == 1
    assert [(each.kind, each.places) for each in log.warnings] == [("torn line", (2,))]


def test_empty_lines_and_ends_of_windows_are_nothing(reads: Reads) -> None:
    log = reads("\r\n(1700000000.000000) c 101#0102\r\n\n")

    assert len(log) == 1
    assert log.warnings == ()


def test_what_candump_prints_is_read_too(reads: Reads) -> None:
    log = reads(
        " (1700000000.000001)  vcan0  101   [5]  E8 53 00 47 C6\n"
        " (1700000000.000002)  vcan0  18FF1000   [0] \n"
        " (1700000000.000003)  vcan0  101   [4]  remote request\n"
        " (1700000000.000004)  vcan0  20000004   [8]  00 01 00 00 00 00 00 00   ERRORFRAME\n"
        " (1700000000.000005)  vcan0  101  [12]  " + "0A " * 12 + "\n"
        " (1700000000.000006)  vcan0  TX B E  101  [01]  0A\n"
        " (1700000000.000007)  vcan0  101   [2]  41 42   'AB'\n"
    )

    assert log.warnings == ()
    assert log.frames.length.tolist() == [5, 0, 4, 8, 12, 1, 2]
    assert log.frames.flags.tolist() == [0, EXTENDED, REMOTE, ERROR, FD, FD | BRS | ESI | TX, 0]
    assert (log.frames.at_ns % 1_000_000_000).tolist() == [1000 * n for n in range(1, 8)]


def test_stamps_since_the_frame_before_are_summed_up(reads: Reads) -> None:
    text = "".join(f" (000.{us:06d})  c  101   [0] \n" for us in (0, 500, 20, 300))

    log = reads(text)

    assert log.frames.at_ns.tolist() == [0, 500_000, 520_000, 820_000]
    assert [each.kind for each in log.warnings] == ["relative stamps"]


def test_stamps_since_the_start_are_kept(reads: Reads) -> None:
    text = "".join(f" (000.{us:06d})  c  101   [0] \n" for us in (0, 20, 300, 500))

    assert reads(text).frames.at_ns.tolist() == [0, 20_000, 300_000, 500_000]
    assert reads(text, stamps="delta").frames.at_ns.tolist() == [0, 20_000, 320_000, 820_000]


def test_local_time_is_taken_for_utc_and_that_is_said(reads: Reads) -> None:
    log = reads(" (2023-11-14 22:13:20.000001)  vcan0  101   [1]  00\n")

    assert log.frames.at_ns.tolist() == [1_700_000_000_000_001_000]
    assert [each.kind for each in log.warnings] == ["local time"]


def test_frames_without_stamps_are_read_and_that_is_said(reads: Reads) -> None:
    log = reads("  vcan0  101   [1]  00\n  vcan0  102   [1]  00\n")

    assert log.frames.identifier.tolist() == [0x101, 0x102]
    assert [(each.kind, each.count) for each in log.warnings] == [("no time stamps", 2)]


def test_channels_keep_their_names(reads: Reads) -> None:
    text = "".join(f"(1700000000.000000) {name} 101#\n" for name in ("can1", "vcan0", "can1", "é"))

    log = reads(text)

    assert [log.frames.channels[at] for at in log.frames.channel] == [
        *("can1", "vcan0", "can1", r"\xc3\xa9"),
    ]


def test_a_line_without_end_takes_no_memory_and_no_time(reads: Reads) -> None:
    log = reads(b"(1700000000.000000) c 101#00\n" + b"A" * 9_000_000)

    assert len(log) == 1
    assert {each.kind for each in log.warnings} == {"endless line", "torn line"}


@pytest.mark.parametrize("form", ["gzip", "zstd"])
def test_a_torn_compressed_log_gives_what_was_whole(tmp_path: Path, form: str) -> None:
    draw = random.Random(1)
    lines = b"".join(
        b"(1700000000.000000) c 101#%s\n" % draw.randbytes(8).hex().encode() for _ in range(50_000)
    )
    whole = gzip.compress(lines) if form == "gzip" else pa.compress(lines, "zstd", asbytes=True)
    path = tmp_path / "x.log"
    path.write_bytes(whole[: len(whole) // 2])

    log = read(path)

    assert 20_000 < len(log) < 30_000
    assert f"{form} stream" in " ".join(each.kind for each in log.warnings)


@pytest.mark.parametrize("suffix", [".log", ".log.gz", ".log.zst"])
def test_what_is_written_is_read_back(tmp_path: Path, suffix: str) -> None:
    frames = drawn_frames(7, 400, fine=True)
    path, losses = tmp_path / f"x{suffix}", Damages()

    candump.write(path, [frames[:150], frames[150:]], losses)
    log = read(path)

    assert log.warnings == ()
    assert same(log.frames, frames, flags=~np.uint8(TX))
    assert [each.kind for each in losses.all()] == ["direction"]


def same(found: Frames, wanted: Frames, flags: np.uint8) -> bool:
    return (
        found.at_ns.tolist() == wanted.at_ns.tolist()
        and found.identifier.tolist() == wanted.identifier.tolist()
        and (found.flags & flags).tolist() == (wanted.flags & flags).tolist()
        and found.length.tolist() == wanted.length.tolist()
        and all(found.payload(at) == wanted.payload(at) for at in range(len(wanted)))
        and [found.channels[at] for at in found.channel]
        == [wanted.channels[at] for at in wanted.channel]
    )


PIECES = st.sampled_from(
    [
        *(
            b"(1700000000.123456) vcan0 101#",
            b"(1700000000.123456789) can1 18FF1000#",
            b"##1",
            b"#",
        ),
        *(b"0011223344556677", b"AB", b"a", b"R8", b" T", b" R", b" ", b"(", b"20000004#", b"\r"),
        *(b"  [8]  00 11", b"\t", b"7FF#", b"FFF#", b"\xff"),
    ]
)


@settings(max_examples=150, deadline=None)
@given(st.lists(st.lists(PIECES, max_size=4).map(b"".join), min_size=1, max_size=12))
def test_the_kernel_and_numpy_and_the_strict_parser_agree_on_any_lines(lines: list[bytes]) -> None:
    block = b"\n".join(lines) + b"\n"
    for width in (8, 64):
        names: list[list[str]] = [[], []]
        compiled = kernel.parse_candump(block, names[0], width)
        plain = parse_block(block, names[1], width)
        assert compiled is not None
        # Each may leave other lines to the strict parser, but none may accept a line that it
        # rejects.
        left = set(compiled.odd.tolist()) | set(plain.odd.tolist())
        rows = [line.removesuffix(b"\r") for line in lines if line.removesuffix(b"\r")]
        assert len(compiled.frames) == len(plain.frames) == len(rows)
        for at, line in enumerate(rows):
            for found, odd in (
                (compiled, set(compiled.odd.tolist())),
                (plain, set(plain.odd.tolist())),
            ):
                told = parse(line)
                if at in odd:
                    assert not found.frames.data[at].any()
                    continue
                assert told is not None
                assert found.frames.at_ns[at] == told.at_ns
                assert found.frames.identifier[at] == told.identifier
                assert found.frames.flags[at] == told.flags
                assert found.frames.payload(at) == told.data
                assert found.frames.channels[found.frames.channel[at]] == told.channel
        assert compiled.lines == plain.lines == len(lines)
        assert left <= set(range(len(rows)))


def test_plain_lines_are_not_left_to_the_strict_parser() -> None:
    frames = drawn_frames(3, 200, classic=True)
    keep = (frames.flags & np.uint8(REMOTE)) == 0
    lines = b"".join(
        b"(1700000000.%06d) can1 %s#%s\n"
        % (at, b"%08X" % identifier if flags else b"%03X" % identifier, data.hex().encode())
        for at, (identifier, flags, data) in enumerate(
            (int(frames.identifier[row]) | (0x20000000 if frames.flags[row] & ERROR else 0),
             int(frames.flags[row]), frames.payload(row))
            for row in np.flatnonzero(keep).tolist()
        )
    )  # fmt: skip

    compiled, plain = kernel.parse_candump(lines, [], 8), parse_block(lines, [], 8)

    assert compiled is not None
    assert len(compiled.odd) == len(plain.odd) == 0
