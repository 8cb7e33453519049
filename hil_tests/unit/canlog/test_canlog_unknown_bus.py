"""A log of an unknown bus: filters, bit activity, and no values from another bus's DBC file."""

import json
import math
from collections import Counter
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canlog import LogError
from canlog.bit_activity import ActivityView
from canlog.command import VERBS, main, options_first, parser
from canlog.frames import KEY_EXTENDED
from canlog.rows import from_rows
from canlog.select import parse_data, parse_keys
from hil_tests.unit.canlog.canlog_rig import MS

DBC = 'VERSION ""\nBU_: A\nBO_ 256 Speed: 2 A\n SG_ V : 0|16@1+ (1,0) [0|0] "km/h" A\n'


@pytest.fixture
def log(tmp_path: Path) -> Path:
    (tmp_path / "x.dbc").write_text(DBC)
    path = tmp_path / "x.log"
    path.write_text(
        "(1.000000) can0 100#0102 R\n(1.100000) can0 101#0A0BFF T\n"
        "(1.200000) can0 1F0#0A0CFF R\n(1.300000) can0 200#0A R\n"
        "(1.400000) can0 18FEF100#0AFFFF T\n"
    )
    return path


def shown(capsys: pytest.CaptureFixture[str], log: Path, *words: str) -> list[str]:
    """Return the identifiers in the printed lines."""
    assert main(["show", str(log), "--no-pager", *words]) == 0
    return [line.split()[2] for line in capsys.readouterr().out.splitlines()]


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (["--id", "100-1FF"], ["100", "101", "1F0"]),
        (["--id", "100/7F0"], ["100", "101"]),
        (["--id", "101", "--id", "200-7FF"], ["101", "200"]),
        (["--id", "18FEF100"], ["18FEF100"]),
        (["--id", "00000000-1FFFFFFF"], ["18FEF100"]),
        (["--id", "18FE0000/1FFF0000"], ["18FEF100"]),
        (["--direction", "tx"], ["101", "18FEF100"]),
        (["--direction", "rx", "--id", "100-1FF"], ["100", "1F0"]),
        (["--data", "0A"], ["101", "1F0", "200", "18FEF100"]),
        (["--data", "0A..FF"], ["101", "1F0", "18FEF100"]),
        (["--data", "0A 0.F."], ["101", "1F0"]),
    ],
)
def test_frames_are_chosen_by_range_mask_direction_and_data(
    log: Path, capsys: pytest.CaptureFixture[str], words: list[str], found: list[str]
) -> None:
    assert shown(capsys, log, *words) == found


@pytest.mark.parametrize("text", ["200-100", "1FF-", "100-xyz", "100/", "100/zz", "zz"])
def test_what_is_no_range_is_refused(text: str) -> None:
    with pytest.raises(LogError):
        parse_keys(text)


@pytest.mark.parametrize("text", ["", "0", "0A0", "xx", "0A..F"])
def test_what_is_no_data_is_refused(text: str) -> None:
    with pytest.raises(LogError, match="--data"):
        parse_data(text)


def test_a_foreign_log_is_not_decoded_with_the_trains_own_files(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """On this project's bus, 256 is TIME_OF_DAY, which is longer."""
    assert main(["show", str(log), "--no-pager"]) == 0
    said = capsys.readouterr()
    assert "TIME_OF_DAY" not in said.out
    assert "x.log is of another bus, so nothing is decoded; --dbc FILE decodes it" in said.err

    assert main(["show", str(log), "--no-pager", "--dbc", "own"]) == 0
    assert "TIME_OF_DAY" in capsys.readouterr().out


def test_nothing_is_decoded_on_demand(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["show", str(log), "--no-pager", "--no-dbc"]) == 0

    said = capsys.readouterr()
    assert (said.err, "?" in said.out) == ("", True)


def test_the_files_of_a_folder_are_remembered(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    dbc = str(log.parent / "x.dbc")

    assert main(["show", str(log), "--no-pager", "--dbc", dbc, "--remember"]) == 0
    capsys.readouterr()
    assert main(["show", str(log), "--no-pager"]) == 0

    said = capsys.readouterr()
    assert "Speed" in said.out
    assert f"decoded with {dbc}" in said.err
    (log.parent / ".canlog.json").write_text("no JSON")
    assert main(["show", str(log), "--no-pager"]) == 2
    assert ".canlog.json: cannot be used" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words",
    [
        ["LOG", "Speed.V", "--dbc", "DBC", "-o", "OUT"],
        ["LOG", "--dbc", "DBC", "Speed.V", "-o", "OUT"],
        ["--dbc", "DBC", "LOG", "-o", "OUT", "Speed.V"],
        ["--dbc=DBC", "LOG", "--out", "OUT", "--no-events", "Speed.V"],
        ["-o", "OUT", "--dbc", "DBC", "--", "LOG", "Speed.V"],
    ],
)
def test_plot_takes_its_words_in_any_order(
    log: Path, capsys: pytest.CaptureFixture[str], words: list[str]
) -> None:
    places = {"LOG": str(log), "DBC": str(log.parent / "x.dbc"), "OUT": str(log.parent / "x.png")}
    given_words = []
    for word in words:
        for name, path in places.items():
            word = word.replace(name, path)
        given_words.append(word)

    assert main(["plot", *given_words]) == 0

    assert "1 panels, 1 samples" in capsys.readouterr().out


@pytest.mark.parametrize("verb", sorted(VERBS))
def test_words_that_are_in_order_stay_as_they_are(verb: str) -> None:
    words = [verb, "--utc-offset-s", "-3600", "--no-dbc", "a", "b"]

    assert options_first(parser(words[0]), words) == words


@given(
    data=st.lists(st.binary(min_size=0, max_size=4), min_size=1, max_size=30),
    size=st.integers(1, 10),
)
@settings(max_examples=60, deadline=None)
def test_bit_activity_is_that_of_the_frames_counted_one_by_one(
    data: list[bytes], size: int
) -> None:
    frames = from_rows([(at * MS, 0x100, 0, "can0", each) for at, each in enumerate(data)])
    view = ActivityView()
    for at in range(0, len(frames), size):
        view.feed(frames[at : at + size])

    one = view.found[0x100, "can0"]
    width = max(map(len, data))
    assert one.flips.shape == (width, 8)
    for byte in range(width):
        column = [each.ljust(4, b"\0")[byte] for each in data]
        for bit in range(8):
            flips = sum((a ^ b) >> (7 - bit) & 1 for a, b in pairwise(column))
            assert one.flips[byte, bit] == flips
        counts = Counter(each[byte] for each in data if len(each) > byte)
        total = sum(counts.values())
        entropy = -sum(n / total * math.log2(n / total) for n in counts.values())
        assert math.isclose(one.entropy_bits[byte], entropy, abs_tol=1e-9)


def test_bits_shows_what_moves(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = [f"({1 + at / 10:.6f}) can0 300#{at % 2:02X}00{at:02X}" for at in range(16)]
    log.write_text("".join(f"{line}\n" for line in [*lines, "(9.000000) can0 18FEF100#FF"]))

    assert main(["bits", str(log), "--no-dbc"]) == 0
    text = capsys.readouterr().out
    assert "can0       300  16 frames, 5 of 24 bits change" in text
    assert "bits     .......@ ........ ....:-+@" in text
    assert "entropy      1.00     0.00     4.00" in text

    assert main(["bits", str(log), "--no-dbc", "--as", "json", "--id", "300"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [row["id"] for row in rows] == ["300"]
    assert rows[0]["flips"][0] == [0] * 7 + [15]
    assert rows[0]["flip_ratio"][0][7] == 1.0


@given(key=st.integers(0, 0x7FF), mask=st.integers(0, 0x7FF), value=st.integers(0, 0x7FF))
@settings(max_examples=60, deadline=None)
def test_a_mask_holds_for_the_identifiers_that_agree(key: int, mask: int, value: int) -> None:
    frames = from_rows([(0, key, 0, "can0", b""), (0, key, 1, "can0", b"")])

    found = parse_keys(f"{value:X}/{mask:X}").holds(frames.key).tolist()

    assert found == [key & mask == value & mask, False]


def test_extended_ends_make_an_extended_range() -> None:
    found = parse_keys("100-18FEF100")

    assert (found.first, found.last) == (0x100 | KEY_EXTENDED, 0x18FEF100 | KEY_EXTENDED)
