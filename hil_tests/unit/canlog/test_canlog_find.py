"""`canlog find` names the bit field of an unknown bus that follows a course."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canlog import LogError
from canlog.command import main
from canlog.course import ReferenceCourse, course_of
from canlog.database import no_bus
from canlog.field_search import bits_of, search
from canlog.reader import Log
from canlog.rows import from_rows
from hil_tests.unit.canlog.canlog_rig import MS, write_candump

FRAMES = 400


def payload(raw: int, bits: list[int], noise: int) -> bytes:
    """Put the bits of a number, lowest first, at the given places among those of `noise`."""
    whole = noise
    for at, bit in enumerate(bits):
        whole = whole & ~(1 << bit) | (raw >> at & 1) << bit
    return whole.to_bytes(8, "little")


def ordered_bits(start: int, length: int, *, big_endian: bool) -> list[int]:
    """Walk through the bits of a DBC signal one by one, and return them lowest first."""
    found, at = [], start
    for _ in range(length):
        found.append(at)
        if not big_endian:
            at += 1
        else:
            at = at - 1 if at % 8 else at + 15
    return found[::-1] if big_endian else found


@st.composite
def fields(draw: st.DrawFn) -> tuple[int, int, bool]:
    """Generate start bit, length and byte order of a signal of eight bytes."""
    big_endian = draw(st.booleans())
    start, length = draw(st.integers(0, 63)), draw(st.integers(1, 20))
    while max(ordered_bits(start, length, big_endian=big_endian)) > 63:
        length -= 1
    return start, length, big_endian


@given(field=fields(), signed=st.booleans(), seed=st.integers(0, 1000), rising=st.booleans())
@settings(max_examples=60, deadline=None)
def test_a_field_that_carries_the_course_is_found_with_its_scale(
    field: tuple[int, int, bool], signed: bool, seed: int, rising: bool
) -> None:
    """All other bits are noise, which no shorter or longer field can hide."""
    start, length, big_endian = field
    signed = signed and length > 1
    bits = ordered_bits(start, length, big_endian=big_endian)
    random = np.random.default_rng(seed)
    low = -(1 << length - 1) if signed else 0
    raws = random.integers(low, low + (1 << length), FRAMES).tolist()
    noise = [int.from_bytes(random.bytes(8), "little") for _ in raws]
    frames = from_rows(
        [
            (at * MS, 0x123, 0, "can0", payload(raw, bits, extra))
            for at, (raw, extra) in enumerate(zip(raws, noise, strict=True))
        ]
    )
    scale = 0.25 if rising else -0.25
    course = ReferenceCourse("x", frames.at_ns, np.array(raws) * scale - 40.0)

    best = search(Log(Path("x.log"), frames, no_bus()), course)[0]

    assert best.bits() == set(bits)
    assert best.correlation == pytest.approx(1.0 if rising else -1.0)
    assert (best.signed, best.scale, best.offset) == (
        signed,
        pytest.approx(scale),
        pytest.approx(-40.0, abs=1e-6 * (1 << length)),
    )
    if len({bit // 8 for bit in bits}) > 1:
        assert (best.start, best.length, best.big_endian) == (start, length, big_endian)


@given(field=fields())
def test_the_bits_of_a_field_are_those_that_one_walks_through(field: tuple[int, int, bool]) -> None:
    start, length, big_endian = field

    found = bits_of(start, length, big_endian=big_endian)

    assert found == set(ordered_bits(start, length, big_endian=big_endian))


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """A drive of 60 s: 200 is speed, 201 distance, 202 a counter, 203 noise, 204 a door."""
    random, rows, distance_m = np.random.default_rng(1), [], 0.0
    for step in range(1200):
        at_s = step / 20
        speed = max(0.0, 60 * math.sin(math.pi * min(at_s, 40) / 40)) + random.normal() * 0.05
        distance_m += max(speed, 0) / 72
        raw = max(0, round(speed / 0.01)).to_bytes(2, "big")
        for identifier, data in (
            (0x200, b"\x55" + raw + bytes([step % 16])),
            (0x201, round(distance_m * 10).to_bytes(3, "little")),
            (0x202, bytes([step % 256])),
            (0x203, random.bytes(8)),
            (0x204, bytes([0xA0 | 4 * (45 <= at_s < 55)])),
        ):
            rows.append((step * 50 * MS + 1_700_000_000_000 * MS, identifier, 0, "can0", data))
    return write_candump(tmp_path / "drive.log", from_rows(rows))


def found(
    capsys: pytest.CaptureFixture[str], log: Path, like: str, *words: str
) -> list[dict[str, object]]:
    assert main(["find", str(log), "--no-dbc", "--like", like, "--as", "json", *words]) == 0
    rows: list[dict[str, object]] = json.loads(capsys.readouterr().out)
    return rows


def test_a_rough_sketch_finds_speed_and_door(
    drive: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    best = found(capsys, drive, "0:0 10:40 20:60 30:40 40:0 60:0")[0]
    assert (best["id"], best["big_endian"]) == ("200", True)
    assert float(str(best["correlation"])) > 0.99
    assert best["scale"] == pytest.approx(0.01, rel=0.1)

    best = found(capsys, drive, "0:0, 45:0, 45:1, 55:1, 55:0, 60:0")[0]
    assert (best["id"], best["start"], best["length"]) == ("204", 2, 1)
    assert best["correlation"] == 1.0


def test_a_csv_file_from_another_clock_finds_speed_and_its_delay(
    drive: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A German table: semicolons, decimal commas, and a clock that is two seconds ahead."""
    lines = [
        f"{at / 10 + 2:.1f};x;{60 * math.sin(math.pi * at / 400):.3f}".replace(".", ",")
        for at in range(400)
    ]
    table = drive.parent / "gps.csv"
    table.write_text("\n".join(["t;what;v", *lines]), encoding="utf-8")

    best = found(capsys, drive, str(table), "--column", "v", "--shift", "4")[0]

    assert (best["id"], best["length"]) == ("200", 13)
    assert best["shift_s"] == pytest.approx(-2.0, abs=0.11)


def test_a_signal_of_the_log_is_found_on_the_unknown_channel(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "x.dbc").write_text(
        'VERSION ""\nBU_: A\nBO_ 256 Speed: 2 A\n SG_ V : 0|16@1+ (0.1,0) [0|0] "km/h" A\n'
    )
    rows = []
    for step in range(300):
        value = step * step % 5000
        rows.append((step * MS, 0x100, 0, "can0", value.to_bytes(2, "little")))
        rows.append((step * MS, 0x345, 0, "can1", b"\x01" + value.to_bytes(2, "big")))
    log = write_candump(tmp_path / "x.log", from_rows(rows))
    log.write_text(log.read_text().replace("can0 345", "can1 345"))
    words = ["find", str(log), "--dbc", f"can0={tmp_path / 'x.dbc'}", "--like", "Speed.V"]

    assert main([*words, "--least", "0.999"]) == 0

    assert capsys.readouterr().out == ("+1.000000  can1       345   12|13@0+ (0.1,0)  300 frames\n")


@pytest.mark.parametrize(
    ("like", "words", "said"),
    [
        (" ", [], "--like: give a sketch such as"),
        ("0:0 10", [], "--like 10: a point of a sketch is SECONDS:VALUE"),
        ("0:5 10:5", [], "the course never changes"),
        ("10:5 0:1", [], "its instants run backwards"),
        ("500:0 900:1", [], "begins after"),
        ("no_such.csv", [], "there is no such file"),
        ("Speed.V", [], "Speed.V: no such signal"),
        ("0:0 1:1", ["--shift", "-1"], "--shift -1"),
    ],
)
def test_a_course_that_is_none_is_refused(
    drive: Path, capsys: pytest.CaptureFixture[str], like: str, words: list[str], said: str
) -> None:
    assert main(["find", str(drive), "--no-dbc", "--like", like, *words]) == 2

    assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "column", "said"),
    [("t,v\n0,x\n", None, "no two rows"), ("t,v\n0,1\n", "w", "has no column w; it has t, v")],
)
def test_a_table_without_the_course_is_refused(
    tmp_path: Path, text: str, column: str | None, said: str
) -> None:
    (tmp_path / "x.csv").write_text(text)
    log = Log(Path("x.log"), from_rows([(0, 1, 0, "can0", b"")]), no_bus())

    with pytest.raises(LogError, match=said):
        course_of(log, str(tmp_path / "x.csv"), column)


def test_nothing_that_follows_is_exit_code_1(
    drive: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["find", str(drive), "--no-dbc", "--channel", "can0", "--like", "0:0 1:1 2:0 3:1 4:0"]

    assert main([*words, "--least", "0.9"]) == 1

    assert "no bit field follows 0:0 1:1 2:0 3:1 4:0" in capsys.readouterr().err
