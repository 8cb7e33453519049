"""Text logs in the dialects of different programs, languages and options."""

import tempfile
from pathlib import Path

import can
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canlog import Frames, ReadOptions, read, stream
from canlog.command import main
from canlog.damage import Damages, LogError
from canlog.drawn import drawn_frames
from canlog.formats.dates import instant_ns
from canlog.formats.registry import named
from canlog.frames import BRS, ERROR, ESI, EXTENDED, FD, REMOTE, TX, concat

DATES = [
    # CANalyzer writes "am" after hours of the 24-hour clock.
    ("Tue Jan 07 13:14:48.626 am 2020", "2020-01-07T13:14:48.626"),
    ("Tue Jan 07 01:14:48.626 pm 2020", "2020-01-07T13:14:48.626"),
    ("Thu Apr 28 12:00:01 am 2022", "2022-04-28T00:00:01"),
    ("Thu Apr 28 12:00:01 pm 2022", "2022-04-28T12:00:01"),
    ("Thu Apr 28 00:30:01 pm 2022", "2022-04-28T00:30:01"),
    ("Mon Dec 6 11:21:13 am 2021", "2021-12-06T11:21:13"),
    ("Die Mär 3 04:09:35.000 pm 2015", "2015-03-03T16:09:35"),
    ("Sam Sep 30 15:06:13.191 2017", "2017-09-30T15:06:13.191"),
    ("Don Okt 1 15:06:13 2020", "2020-10-01T15:06:13"),
    ("mar. mars 3 04:09:35.000 pm 2015", "2015-03-03T16:09:35"),
    ("lun. févr. 11 14:25:36 2019", "2019-02-11T14:25:36"),
    ("mer. août 7 14:25:36 2019", "2019-08-07T14:25:36"),
    ("火 1月 7 01:14:48.626 午後 2020", "2020-01-07T13:14:48.626"),
    ("周二 1月 07 01:14:48.626 上午 2020", "2020-01-07T01:14:48.626"),
    ("星期四 四月 28 10:44:52.480 下午 2022", "2022-04-28T22:44:52.480"),
    ("2020-01-07 13:14:48.5", "2020-01-07T13:14:48.5"),
    ("07.01.2020 13:14:48", "2020-01-07T13:14:48"),
    ("2020年1月7日 13:14:48", "2020-01-07T13:14:48"),
]
LINES = "   0.001000 1  123             Rx   d 2 01 02\n"


def asc(folder: Path, date: str, lines: str = LINES, encoding: str = "utf-8") -> Path:
    path = folder / "x.asc"
    head = f"date {date}\nbase hex  timestamps absolute\ninternal events logged\n"
    path.write_bytes((head + lines).encode(encoding))
    return path


@pytest.mark.parametrize(("text", "instant"), DATES)
def test_dates_of_many_languages_are_read(text: str, instant: str) -> None:
    assert instant_ns(text) == int(np.datetime64(instant, "ns").astype(np.int64))


@pytest.mark.parametrize(
    ("date", "encoding"),
    [
        ("Die Mär 3 04:09:35.000 pm 2015", "utf-8"),
        ("Die Mär 3 04:09:35.000 pm 2015", "utf-8-sig"),
        ("Die Mär 3 04:09:35.000 pm 2015", "cp1252"),
        ("火 3月 3 04:09:35.000 午後 2015", "cp932"),
        ("周二 3月 3 04:09:35.000 下午 2015", "gb18030"),
        ("화 3월 3 04:09:35.000 오후 2015", "cp949"),
    ],
)
def test_a_date_is_read_in_the_encoding_of_its_program(
    tmp_path: Path, date: str, encoding: str
) -> None:
    log = read(asc(tmp_path, date, encoding=encoding))

    wanted = int(np.datetime64("2015-03-03T16:09:35.001", "ns").astype(np.int64))
    assert log.frames.at_ns.tolist() == [wanted]
    assert {each.kind for each in log.warnings} == {"local time"}


@pytest.mark.parametrize("date", ["the day before", "1/2/2020 10:00:00", "Xyz 99 10:00:00 2020"])
def test_a_date_that_cannot_be_read_is_said(tmp_path: Path, date: str) -> None:
    log = read(asc(tmp_path, date))

    assert log.frames.at_ns.tolist() == [1_000_000]
    assert [each.kind for each in log.warnings] == ["no date"]
    assert date in log.warnings[0].detail


def test_logs_without_any_date_say_so(tmp_path: Path) -> None:
    one, other = tmp_path / "x.asc", tmp_path / "x.trc"
    one.write_text(f"base hex  timestamps absolute\n{LINES}")
    other.write_text(";$FILEVERSION=1.0\n     1)      1059.9  0123  2  0A FF\n")

    assert [each.kind for each in read(one).warnings] == ["no date"]
    assert [each.kind for each in read(other).warnings] == ["no date"]


@pytest.mark.parametrize(
    ("line", "flags", "data"),
    [
        ("CANFD 4 Rx 4EE 0 1 f 64 {64} 1331984 11 0 46500250 460a0250 1 2", FD | ESI, 64),
        ("CANFD 4 Rx 4EE 0 0 f 64 {64}", FD, 64),
        ("CANFD 4 Rx 4EE 1 0 8 8 {8} 1331984 11 0 0 0 0 0 0", FD | BRS, 8),
        ("CANFD 4 Rx 4EE 0 0 8 8 {8} 1331984 11 0 0 0 0 0 0", 0, 8),
        ("CANFD 4 Tx 4EEx Some_Name 0 0 9 12 {12} 1 1 303000 0 0 0 0 0", FD | TX | EXTENDED, 12),
        ("4 4EE Rx d D {8} Length = 232016 BitCount = 119 ID = 1023", 0, 8),
        ("4 4EEx Rx d 40 {64}", FD | EXTENDED, 64),
        ("4 4EE Tx d c {12}", FD | TX, 12),
        ("4 4EE Tx r Length = 1704000 BitCount = 145 ID = 88888888x", REMOTE | TX, 0),
    ],
)
def test_asc_frames_of_every_kind(tmp_path: Path, line: str, flags: int, data: int) -> None:
    """A CAN FD frame is identified by its flags, its length, or bits that no classic frame has."""
    for size in (8, 12, 64):
        line = line.replace(f"{{{size}}}", " ".join(f"{at:02X}" for at in range(size)))

    log = read(asc(tmp_path, DATES[0][0], f" 30.506898 {line}\n"))

    assert log.frames.flags.tolist() == [flags]
    assert log.frames.payload(0) == bytes(range(data))
    assert {each.kind for each in log.warnings} == {"local time"}


@pytest.mark.parametrize("length", [9, 12, 16, 32, 64])
def test_frames_longer_than_classic_that_python_can_writes_on_classic_lines(
    tmp_path: Path, length: int
) -> None:
    """Its writer does so for a message without the mark of CAN FD; no frame has nine bytes."""
    path = tmp_path / "x.asc"
    with can.ASCWriter(path) as writer:
        writer.on_message_received(
            can.Message(timestamp=1.0, arbitration_id=0x123, data=bytes(range(length)))
        )

    if length == 9:
        with pytest.raises(LogError, match="holds no frame"):
            read(path, options=ReadOptions(refuse_empty=True))
        return
    frames = read(path).frames
    assert (len(frames), frames.payload(0)) == (1, bytes(range(length)))
    assert frames.flags.tolist() == [FD | EXTENDED]


@pytest.mark.parametrize("line", ["4 4EE Rx d 00", "4 4EE Rx d 10 00 01 02", "4 4EE Rx d 1F {8}"])
def test_a_length_without_its_bytes_is_damage(tmp_path: Path, line: str) -> None:
    line = line.replace("{8}", " ".join(f"{at:02X}" for at in range(8)))

    log = read(asc(tmp_path, DATES[0][0], f" 30.506898 {line}\n"))

    assert len(log) == 0
    assert {each.kind for each in log.warnings} == {"local time", "junk line"}


def test_lines_of_other_buses_and_of_the_program_are_no_damage(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = (
        "// version 9.0.0\n"
        "   0.015991 CAN 1 Status:chip status error passive - TxErr: 132 RxErr: 0\n"
        "   1.015991 1  Statistic: D 0 R 0 XD 0 XR 0 E 0 O 0 B 0.00%\n"
        "   1.100000 L1 2d              Rx     8 01 02 03 04 05 06 07 08  checksum = 46\n"
        "   1.200000 Li 3e TransmErr\n"
        "   1.300000 1  J1939TP FEE3p        6    0  0   -   Rx   d 2 A0 0F\n"
        "   1.400000 SV: 3 0 1 ::Env::Speed = 5\n"
        "   1.500000 Fr RMSG  0 0 1 1 1a 0 Rx 0 f 0 18 2 aa bb\n"
        "   1.600000 // a comment\n"
        "  -0.500000 1  124             Rx   d 1 07\n"
    )
    source = stream(asc(tmp_path, DATES[0][0], lines))
    frames = concat(list(source))

    assert frames.identifier.tolist() == [0x124]
    start_ns = instant_ns(DATES[0][0])
    assert start_ns is not None
    assert frames.at_ns.tolist() == [start_ns - 500_000_000]
    assert {each.kind for each in source.warnings} == {"local time"}
    assert source.skipped == {"line that is no frame": 8}
    assert main(["stats", str(source.path), "--no-dbc"]) == 0
    assert "skipped: 8 x line that is no frame" in capsys.readouterr().out


@pytest.mark.parametrize(
    "line",
    [
        "1.0 1 123 Rx d 8 01 02",
        "1.0 1 9123 Rx d 1 01",
        "1.0 CANFD 1 Rx 123 0 0 9 12 00",
        "1.0 1 123",
    ],
)
def test_a_broken_frame_is_damage_and_no_foreign_line(tmp_path: Path, line: str) -> None:
    source = stream(asc(tmp_path, DATES[0][0], f"{line}\n"))

    assert len(concat(list(source))) == 0
    assert "junk line" in {each.kind for each in source.warnings}
    assert source.skipped == {}


def test_busmaster_writes_asc_with_single_blanks(tmp_path: Path) -> None:
    path = tmp_path / "x.asc"
    path.write_text(
        "date Mon Dec 6 11:21:13 am 2021\nbase hex  no internal events logged\n// version 7.1.0\n"
        "40874.808200 1 122 Rx d 8 E3 0C 00 FE 07 00 00 28\n"
        "40874.810800 1 16A954A6x Rx d 8 00 00 20 79 78 5A 5A A5\n"
    )

    frames = read(path).frames

    assert frames.identifier.tolist() == [0x122, 0x16A954A6]
    start = np.datetime64("2021-12-06T11:21:13", "ns").astype(np.int64)
    assert int(frames.at_ns[0] - start) == 40_874_808_200_000


TRC_HEAD = ";$FILEVERSION={version}\n;$STARTTIME=46062.4524670150\n;$COLUMNS={columns}\n"


def test_trc_without_its_reserved_column_and_with_errors(tmp_path: Path) -> None:
    path = tmp_path / "x.trc"
    path.write_text(
        TRC_HEAD.format(version="2.1", columns="N,O,T,B,I,d,L,D")
        + "      1         0.000 DT 1     0102 Rx 8    00 00 00 00 06 00 00 00\n"
        "      2         1.200 DT 1     0106 Rx 4    00 0F 00 04\n"
        "      3         1.400 ER 1     -    Rx 5    04 00 02 00 00\n"
        "      4         1.500 ST 1     -    Rx 4    00 00 00 04\n"
        "      5         2.900 DT 2 18FEF100 Tx 5    20 00 00 00 00\n"
    )

    source = stream(path)
    frames = concat(list(source))

    assert frames.length.tolist() == [8, 4, 0, 5]
    assert frames.flags.tolist() == [0, 0, ERROR, EXTENDED | TX]
    assert frames.channels[frames.channel[-1]] == "can2"
    assert source.skipped == {"line that is no frame": 1}
    assert {each.kind for each in source.warnings} == {"local time"}


@pytest.mark.parametrize(
    ("line", "whole"),
    [
        ("     12     48937.600 RR 1      0704 Rx -  1", True),
        ("     12     48937.600 DT 1      0704 Rx -  2    01 02", True),
        ("     12     48937.600 DT 1      0704 Rx -  2    01 0", False),
        ("     12     48937.600 DT 1      0704 Rx -  2    01", False),
    ],
)
def test_a_last_line_without_its_end_counts_when_its_bytes_are_all_there(
    tmp_path: Path, line: str, *, whole: bool
) -> None:
    path = tmp_path / "x.trc"
    path.write_text(TRC_HEAD.format(version="2.1", columns="N,O,T,B,I,d,R,L,D") + line)

    log = read(path)

    assert len(log) == whole
    assert ("torn line" in {each.kind for each in log.warnings}) != whole


@given(
    data=st.lists(st.binary(min_size=1, max_size=8), min_size=1, max_size=5), cut=st.integers(0, 60)
)
@settings(max_examples=40, deadline=None)
def test_an_asc_log_cut_anywhere_gives_a_beginning_of_its_frames(
    data: list[bytes], cut: int
) -> None:
    lines = "".join(
        f"   {at}.000000 1  123             Rx   d {len(each)} {each.hex(' ').upper()}\n"
        for at, each in enumerate(data)
    )
    with tempfile.TemporaryDirectory() as folder:
        frames = read(asc(Path(folder), DATES[0][0], lines[: max(len(lines) - cut, 0)])).frames

    assert [frames.payload(at) for at in range(len(frames))] == data[: len(frames)]


def candump(folder: Path, *lines: str) -> tuple[Frames, dict[str, int], list[str]]:
    """Return the frames, the skipped counts, and the kinds of damage."""
    path = folder / "x.log"
    path.write_text("".join(f"{line}\n" for line in lines))
    source = stream(path)
    frames = concat(list(source))
    kinds = [each.kind for each in source.warnings if each.kind != "no time stamps"]
    return frames, source.skipped, kinds


@pytest.mark.parametrize(
    ("line", "data"),
    [
        ("  can0  123   [2]  01 F2", "01F2"),
        ("  can0  123   [2]  00000001 11110010", "01F2"),
        ("  can0  123   [2]  F2`01", "01F2"),
        ("  can0  123   [2]  11110010`00000001", "01F2"),
        ("  can0  123   [2]  01 F2               '..'", "01F2"),
        ("  can0  123   {F}  01 02 03 04 05 06 07 08", "0102030405060708"),
        ("\x1b[1;31m  can0  123   [2]  01 F2\x1b[0m", "01F2"),
        (" (1700000000.000001)  can0  TX - -  123   [2]  01 F2", "01F2"),
    ],
)
def test_candump_prints_data_in_many_ways(tmp_path: Path, line: str, data: str) -> None:
    """candump options: `-i` binary, `-S` last byte first, `-a` characters, `-8` codes, `-c`
    colours.
    """
    frames, skipped, kinds = candump(tmp_path, line)

    assert (frames.payload(0).hex().upper(), skipped, kinds) == (data, {}, [])


def test_what_candump_says_of_errors_and_of_itself_is_no_frame(tmp_path: Path) -> None:
    frames, skipped, kinds = candump(
        tmp_path,
        "  can0  20000004   [8]  00 04 00 00 00 00 00 00   ERRORFRAME",
        "\tcontroller-problem{rx-error-warning}",
        "  can0  123   [2]  01 02",
        "DROPCOUNT: dropped 5 CAN frames on 'can0' socket (total drops 5)",
    )

    assert frames.flags.tolist() == [ERROR, 0]
    assert skipped == {"line that is no frame": 1}
    assert kinds == ["dropped frame"]


def test_frames_of_can_xl_are_skipped(tmp_path: Path) -> None:
    frames, skipped, kinds = candump(
        tmp_path, "(1700000000.000000) can0 045#81:00:12345678#11223344 R",
        "(1700000000.000001) can0 123#0102",
    )  # fmt: skip

    assert (frames.identifier.tolist(), skipped, kinds) == ([0x123], {"CAN XL frame": 1}, [])


def test_a_byte_order_mark_costs_no_frame(tmp_path: Path) -> None:
    path = tmp_path / "x.log"
    path.write_bytes(b"\xef\xbb\xbf(1700000000.000000) can0 123#0102\n")

    assert len(read(path)) == 1


LONE = [
    "1.0 1 123 Rx d 2 01 02 03",
    "1.0 1 123 Rx d 2 01 2",
    "1.0 1 123 Rx d 9 01 02 03 04 05 06 07 08",
    "1.0 1 123 Rx d 2 01 02 Length = 1",
    "1.0 1 123 Rx d 2 01 02 Lengthy",
    "1.0 1 800 Rx d 0",
    "1.0 1 1FFFFFFFx Tx d 0",
    "1.0 1 20000000x Tx d 0",
    "1.0 1 123 TxRq d 0",
    "1.0 1 123 Rx r 4",
    "1. 1 123 Rx d 0",
    ".5 1 123 Rx d 0",
    "1.0000000000 1 123 Rx d 0",
    "999999999999.0 1 123 Rx d 0",
    "1.0 1234 123 Rx d 0",
    "1.0 1 123 rx d 0",
    "1.0\t1\t123\tRx\td\t1\tff",
    "1.0 CANFD 1 Rx 123 Rx 0 0 0 0 0",
    "1.0 CANFD 1 Rx 123 0 0 a 16 00",
    "1.0 CANFD 1 Rx 123 0 0 0 0 1 2 1040 0",
    "1.0 CANFD 1 Rx 123 0 0 0 0 1 2 zz 0",
    "1.0 CANFD 1 Rx 123 name 1 1 0 0 1 2 0",
    "begin triggerblock Tue Jan 07 13:14:49.000 2020",
    "base dec  timestamps absolute",
]


@given(
    seed=st.integers(0, 1 << 20),
    places=st.lists(
        st.tuples(st.integers(0, 1 << 20), st.sampled_from("0 9xFdR.\t=-;gé")), max_size=4
    ),
    extra=st.lists(st.sampled_from(LONE), max_size=3),
    form=st.sampled_from(["asc", "trc"]),
)
@settings(max_examples=50, deadline=None)
def test_the_kernel_and_the_strict_parser_read_the_same_text(
    seed: int, places: list[tuple[int, str]], extra: list[str], form: str
) -> None:
    """Both give the same frames and damage, whichever characters of a log are corrupted."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"x.{form}"
        named(form).write(path, [drawn_frames(seed, 12, classic=seed % 2 == 0)], Damages())
        lines = path.read_text().split("\n")
        for number, line in enumerate(extra):
            lines.insert(4 + (seed + 7 * number) % (len(lines) - 4), line)
        text = list("\n".join(lines))
        for at, sign in places:
            text[at % len(text)] = sign
        path.write_text("".join(text), encoding="utf-8")
        found = []
        for compiled in (True, False):
            source = stream(path, ReadOptions(format=form, compiled=compiled))
            found.append((concat(list(source)), source))

    (one, told_one), (other, told_other) = found
    assert told_one.warnings == told_other.warnings
    assert told_one.skipped == told_other.skipped
    for name in ("at_ns", "identifier", "flags", "length"):
        assert getattr(one, name).tolist() == getattr(other, name).tolist()
    channels = [[frames.channels[at] for at in frames.channel] for frames in (one, other)]
    assert channels[0] == channels[1]
    assert [one.payload(at) for at in range(len(one))] == [
        other.payload(at) for at in range(len(other))
    ]


@given(
    seed=st.integers(0, 10_000),
    form=st.sampled_from(["candump", "asc", "trc"]),
    order=st.sampled_from(["utf-16-le", "utf-16-be"]),
    cut=st.integers(0, 40),
)
@settings(max_examples=25, deadline=None)
def test_text_in_utf16_is_read_like_the_same_text_in_utf8(
    seed: int, form: str, order: str, cut: int
) -> None:
    """PowerShell writes what it redirects in UTF-16. A file may end within a character."""
    frames = drawn_frames(seed, 30, classic=True)
    with tempfile.TemporaryDirectory() as folder:
        plain, wide = Path(folder) / f"plain.{form}", Path(folder) / f"wide.{form}"
        named(form).write(plain, [frames], Damages())
        text = plain.read_bytes().decode()
        text = text[: len(text) - cut]
        plain.write_bytes(text.encode())
        raw = ("\ufeff" + text.replace("\n", "\r\n")).encode(order)
        wide.write_bytes(raw)
        options = ReadOptions(format=form)

        found, wanted = stream(wide, options), stream(plain, options)

        both = concat(list(found)), concat(list(wanted))
        assert both[0].at_ns.tolist() == both[1].at_ns.tolist()
        assert both[0].data.tolist() == both[1].data.tolist()
        assert len(found.warnings) == len(wanted.warnings)
        wide.write_bytes(raw[:-1])
        assert len(concat(list(stream(wide, options)))) >= len(both[1]) - 1


def test_a_dbc_file_in_utf16_is_read(tmp_path: Path) -> None:
    text = 'VERSION ""\nBU_: A\nBO_ 256 M: 1 A\n SG_ T : 0|8@1+ (1,0) [0|0] "°C" A\n'
    (tmp_path / "x.dbc").write_bytes(text.encode("utf-16"))
    (tmp_path / "x.log").write_text("(1.000000) can0 100#05\n")

    table = read(tmp_path / "x.log", tmp_path / "x.dbc").table("M")

    assert (table["T"].tolist(), table.units["T"]) == ([5], "°C")
