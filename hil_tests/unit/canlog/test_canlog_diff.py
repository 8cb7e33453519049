"""`canlog diff` finds all differences between two logs or two DBC files, and no other."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canlog.command import main
from canlog.compare.dbcs import Weight, compare_buses
from canlog.compare.logs import Allowed, compare
from canlog.compare.pairing import pair
from canlog.damage import LogError
from canlog.database import parse_bus
from canlog.reader import Log
from canlog.rows import from_rows
from hil_tests.unit.canlog import canlog_rig as rig
from hil_tests.unit.canlog.canlog_rig import EVERYTHING, MS, log_of, random_frames, write_candump

instants = st.lists(st.integers(0, 500), max_size=40).map(sorted)


@given(instants, instants, st.integers(1, 60))
def test_a_pair_is_nearest_both_ways_and_no_frame_has_two(
    a: list[int], b: list[int], reach: int
) -> None:
    found = pair(np.array(a, np.int64), np.array(b, np.int64), reach)

    mine, others = found.a.tolist(), found.b.tolist()
    assert sorted([*mine, *found.only_a.tolist()]) == list(range(len(a)))
    assert sorted([*others, *found.only_b.tolist()]) == list(range(len(b)))
    assert mine == sorted(set(mine))
    assert others == sorted(set(others))
    for left, right in zip(mine, others, strict=True):
        assert abs(a[left] - b[right]) <= reach
    for alone in found.only_a.tolist():
        rivals = [abs(a[alone] - b[right]) for right in found.only_b.tolist()]
        near = min((abs(a[alone] - each) for each in b), default=reach + 1)
        # A frame without a partner has none within reach, or a nearer frame took it.
        assert near > reach or not rivals or min(rivals) >= near


def test_frames_that_one_log_lacks_do_not_shift_the_others() -> None:
    rows = [(n * 10 * MS, 256, bytes([n % 16, 0, 0, 0, 0, 0, 0, 0])) for n in range(200)]
    gone = {0, 17, 18, 19, 120, 199}
    a, b = log_of(rows), log_of([row for n, row in enumerate(rows) if n not in gone])

    found = compare(a, b, Allowed(), "absolute")

    (plain,) = found.messages
    assert (plain.pairs, plain.only_a, plain.only_b) == (194, 6, 0)
    assert plain.first_only_ns == 0
    assert plain.signals == ()
    assert found.differs


def both(logs: list[Log]) -> tuple[Log, Log]:
    first, second = logs
    return first, second


@pytest.mark.parametrize(("steps", "differing"), [(0, 0), (1, 0), (2, 1), (-1, 0), (-5, 1)])
def test_one_step_of_the_raw_value_is_allowed(steps: int, differing: int) -> None:
    """`motorola` is in bytes 2 and 3; its last bit is bit 6 of byte 3."""
    raws = [500, 500 + steps]
    logs = [
        log_of([(0, 256, bytes([0, 0, raw >> 2, raw << 6 & 0xFF, 0, 0, 0, 0]))]) for raw in raws
    ]

    found = compare(*both(logs), Allowed())

    assert [each.signal for each in found.messages[0].signals] == ["motorola"] * differing
    if differing:
        assert found.messages[0].signals[0].most == pytest.approx(0.5 * abs(steps))


def test_names_and_flags_have_to_be_equal() -> None:
    logs = [log_of([(0, 256, bytes([0, 0, 0, 0, 0, 0, byte, 0]))]) for byte in (0x11, 0x32)]

    found = compare(*both(logs), Allowed(lsb=5))

    texts = {each.signal: (each.value_a, each.value_b) for each in found.messages[0].signals}
    assert texts == {"state": ("READY", "RUNNING"), "flags": ("DOORS", "DOORS|BRAKE")}


def test_the_last_of_64_bits_counts() -> None:
    raws = (2**64 - 1, 2**64 - 3)
    logs = [log_of([(0, 257, struct.pack("<Q", raw))]) for raw in raws]

    assert not compare(*both(logs), Allowed(lsb=2)).differs
    (one,) = compare(*both(logs), Allowed(lsb=1)).messages[0].signals
    assert (one.value_a, one.value_b) == tuple(map(str, raws))


def test_floats_may_differ_in_their_last_place_and_nan_is_nan() -> None:
    near = np.nextafter(np.float32(1.5), np.float32(2))
    far = np.nextafter(np.nextafter(near, np.float32(2)), np.float32(2))
    nan = float("nan")

    def differ(a: float, b: float) -> bool:
        logs = [log_of([(0, 259, struct.pack("<f", x) + bytes(4))]) for x in (a, b)]
        return compare(*both(logs), Allowed()).differs

    assert not differ(1.5, float(near))
    assert differ(1.5, float(far))
    assert not differ(nan, nan)
    assert differ(nan, 0.0)


def test_a_signal_that_one_frame_does_not_carry_differs() -> None:
    datas = [bytes([0, 5, 0, 0, 0, 9, 0, 0]), bytes([1, 5, 0, 0, 0, 9, 0, 0])]

    logs = []
    for data in datas:
        base = log_of([])
        frames = from_rows([(0, rig.EXTENDED_ID, 1, "can0", data)])
        logs.append(Log(base.path, frames, base.bus))

    found = {each.signal: each for each in compare(*both(logs), Allowed()).messages[0].signals}

    assert set(found) == {"which", "first", "second"}
    assert (found["first"].value_a, found["first"].value_b) == ("5", "not present")


def test_tolerances_of_a_signal_go_before_steps() -> None:
    logs = [log_of([(0, 256, bytes([0, byte, 0, 0, 0, 0, 0, 0]))]) for byte in (0, 2)]
    apart_mps = 2 * 16 * 0.05

    assert compare(*both(logs), Allowed()).differs
    assert not compare(*both(logs), Allowed(physical={"PLAIN.signed_mps": apart_mps})).differs
    assert compare(*both(logs), Allowed(physical={"signed_*": apart_mps - 0.01})).differs
    assert not compare(*both(logs), Allowed(ignored=("PLAIN",))).differs
    with pytest.raises(LogError, match="--tolerance nonsense"):
        compare(*both(logs), Allowed(physical={"nonsense": 1.0}))


def test_unknown_messages_are_compared_byte_by_byte() -> None:
    logs = [log_of([(0, 0x7FF, b"\1\2"), (MS, 0x7FF, data)]) for data in (b"\3\4", b"\3\5")]

    (one,) = compare(*both(logs), Allowed()).messages[0].signals

    assert (one.frames, one.at_ns, one.value_a, one.value_b) == (1, MS, "03 04", "03 05")


def test_the_command_says_the_first_divergence_with_what_was_around_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frames = random_frames(300)
    path, dbc = write_candump(tmp_path / "a.log", frames), tmp_path / "bus.dbc"
    dbc.write_text(EVERYTHING, encoding="ascii")
    row = next(n for n in range(100, 300) if frames.identifier[n] == 256 and frames.length[n] == 8)
    frames.data[row, 2] ^= 0x80
    other = write_candump(tmp_path / "b.log", frames)
    words = ["--dbc", str(dbc), "--context", "2"]

    assert main(["diff", str(path), str(path), *words]) == 0
    assert "no difference" in capsys.readouterr().out
    assert main(["diff", str(path), str(other), *words]) == 1
    text = capsys.readouterr().out
    assert main(["diff", str(path), str(other), "--json", *words]) == 1
    told = json.loads(capsys.readouterr().out)

    at_s = frames.at_ns[row] / 1e9
    assert f"first divergence: PLAIN.motorola at {at_s - frames.at_ns[0] / 1e9:.6f} s" in text
    assert told["first"]["signal"] == "motorola"
    assert [each["is_it"] for each in told["first"]["frames_b"]] == [
        False,
        False,
        True,
        False,
        False,
    ]
    assert told["first"]["frames_b"][2]["frame"] == f"PLAIN {frames.payload(row).hex().upper()}"
    assert [each["name"] for each in told["messages"] if each["differs"]] == ["PLAIN"]


CHANGES = [
    (
        'SG_ small : 0|4@1+ (1,0) [0|15] ""',
        'SG_ small : 0|4@1+ (2,0) [0|15] ""',
        "PLAIN.small",
        "scale",
    ),
    ("SG_ motorola : 23|10@0+", "SG_ motorola : 23|10@0-", "PLAIN.motorola", "signed"),
    ("SG_ crooked : 3|53@1+", "SG_ crooked : 2|53@1+", "ODD.crooked", "start bit"),
    ("BO_ 256 10;", "BO_ 256 20;", "PLAIN", "cycle time, ms"),
    ('1 "READY"', '1 "WAITING"', "PLAIN.state", "value 1"),
    ("BO_ 262 ODD: 8", "BO_ 262 ODD: 7", "ODD", "length"),
    ("BO_ 262 ODD", "BO_ 263 ODD", "ODD", "identifier"),
    ("second m1", "second m2", "CHOSEN.second", "multiplexed by"),
    ('"kN"', '"N"', "CHOSEN.second", "unit"),
]


@pytest.mark.parametrize(("before", "after", "where", "what"), CHANGES)
def test_each_change_of_a_dbc_file_is_told_and_only_that(
    before: str, after: str, where: str, what: str
) -> None:
    assert before in EVERYTHING
    a, b = parse_bus(EVERYTHING), parse_bus(EVERYTHING.replace(before, after))

    found = compare_buses(a, b)

    assert (where, what) in {(each.where, each.what) for each in found}
    # A changed period also changes the default timeout.
    assert {each.what for each in found} <= {what, "timeout, ms"}


def test_messages_and_signals_of_one_dbc_file_only_are_told() -> None:
    less = EVERYTHING.replace(' SG_ always : 40|8@1+ (1,0) [0|255] "" TCMS\n', "").replace(
        "BO_ 262 ODD", "BO_ 262 EVEN"
    )

    found = compare_buses(parse_bus(EVERYTHING), parse_bus(less))

    told = {(each.where, each.what, each.weight) for each in found}
    assert told == {
        ("CHOSEN.always", "signal", Weight.WIRE),
        ("ODD", "name", Weight.MEANING),
    }


def test_two_dbc_files_by_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a, b = tmp_path / "a.dbc", tmp_path / "b.dbc"
    a.write_text(EVERYTHING, encoding="ascii")
    b.write_text(EVERYTHING.replace("(0.05,-3)", "(0.05,-4)"), encoding="ascii")

    assert main(["diff", str(a), str(a)]) == 0
    assert main(["diff", str(a), str(b)]) == 1
    assert "signed_mps: offset: -3 -> -4" in capsys.readouterr().out
    assert main(["diff", str(a), str(tmp_path / "x.log")]) == 2
