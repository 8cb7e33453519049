"""Frame bits, latencies, gaps and rules, each compared with an independent calculation."""

import random
import statistics
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from can_dbc.rejection import Reason
from canlog.bits import frame_bits
from canlog.damage import LogError
from canlog.database import load_bus, parse_bus
from canlog.drawn import drawn_frames
from canlog.frames import BRS, ERROR, ESI, EXTENDED, FD, FD_LENGTHS, REMOTE, Frames
from canlog.gaps import Gaps
from canlog.latency import Cyclic, longest_bits, response_ns
from canlog.rows import from_rows
from canlog.rules import Judged, broken, parse_rule, untold
from canlog.stats import gather
from canlog.stats_rows import (
    absent_count,
    absent_rows,
    bus_rows,
    message_rows,
    signal_rows,
)
from firmware_py.buses.timing import frame_bits as bits_of_one

MS = 1_000_000
PATTERNS = (b"\x00", b"\xff", b"\xaa", b"\x0f", b"\xf8", b"\x55")


def data_of(draw: random.Random, length: int) -> bytes:
    if draw.random() < 0.5:
        return draw.choice(PATTERNS) * length
    return draw.randbytes(length)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 1 << 32))
def test_classic_frames_are_as_long_as_the_bus_emulation_has_them(seed: int) -> None:
    draw, rows, wanted = random.Random(seed), [], []
    for _ in range(40):
        extended = draw.random() < 0.4
        identifier = draw.choice([0, 0x7FF, draw.randrange(0x800)])
        identifier = draw.choice([0, draw.randrange(1 << 29)]) if extended else identifier
        data = data_of(draw, draw.randrange(9))
        rows.append((0, identifier, EXTENDED * extended, "c", data))
        wanted.append(bits_of_one(identifier, data, extended))

    nominal, fast = frame_bits(from_rows(rows))

    assert nominal.tolist() == wanted
    assert not fast.any()


def test_a_remote_frame_has_the_length_code_and_no_data() -> None:
    frames = drawn_frames(3, 400, classic=True)
    frames = frames[(frames.flags & np.uint8(REMOTE)) != 0]
    wanted = [
        bits_of_one(int(i), b"\0" * int(n), bool(f & EXTENDED), remote=True)
        for i, n, f in zip(frames.identifier, frames.length, frames.flags, strict=True)
    ]

    assert len(wanted) > 20
    assert frame_bits(frames)[0].tolist() == wanted


def fd_bits_by_walking(identifier: int, flags: int, data: bytes) -> tuple[int, int]:
    """Count bits one by one as ISO 11898-1 draws the frame: nominal and fast, from start of frame
    on.
    """

    def places(value: int, width: int) -> list[int]:
        return [int(digit) for digit in f"{value:0{width}b}"]

    if flags & EXTENDED:
        head = [0, *places(identifier >> 18, 11), 1, 1, *places(identifier & 0x3FFFF, 18)]
        head += [0, 1, 0, int(bool(flags & BRS))]
    else:
        head = [0, *places(identifier, 11), 0, 0, 1, 0, int(bool(flags & BRS))]
    rest = [int(bool(flags & ESI)), *places(FD_LENGTHS.index(len(data)), 4)]
    rest += [bit for byte in data for bit in places(byte, 8)]
    counts, run, last = [0, 0], 0, -1
    for at, bit in enumerate([*head, *rest]):
        part = 0 if at < len(head) else 1
        counts[part] += 1
        run = run + 1 if bit == last else 1
        last = bit
        if run == 5:
            counts[part] += 1
            last, run = 1 - bit, 1
    crc = 17 if len(data) <= 16 else 21
    fixed = [0 for at in range(4 + crc) if at % 4 == 0]
    counts[1] += 4 + crc + len(fixed)
    after = 1  # the CRC delimiter, still fast
    end = 1 + 1 + 7 + 3  # acknowledge slot and delimiter, end of frame, intermission
    return (counts[0] + end, counts[1] + after) if flags & BRS else (sum(counts) + after + end, 0)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 1 << 32))
def test_fd_frames_are_as_long_as_walking_them_says(seed: int) -> None:
    draw, rows, wanted = random.Random(seed), [], []
    for _ in range(15):
        flags = FD | draw.choice([0, BRS]) | draw.choice([0, ESI]) | draw.choice([0, EXTENDED])
        identifier = draw.randrange(1 << 29) if flags & EXTENDED else draw.randrange(1 << 11)
        data = data_of(draw, draw.choice(FD_LENGTHS))
        rows.append((0, identifier, flags, "c", data))
        wanted.append(fd_bits_by_walking(identifier, flags, data))

    nominal, fast = frame_bits(from_rows(rows))

    assert list(zip(nominal.tolist(), fast.tolist(), strict=True)) == wanted


def test_the_published_example_has_its_published_latencies() -> None:
    """Davis et al. 2007, section 4.1: the second instance of C misses its deadline."""
    messages = [
        Cyclic("A", 2_500_000, 1_000_000),
        Cyclic("B", 3_500_000, 1_000_000),
        Cyclic("C", 3_500_000, 1_000_000),
    ]

    assert response_ns(messages, 1) == {"A": 2_000_000, "B": 3_000_000, "C": 3_500_000}


def test_an_overloaded_bus_has_no_worst_latency_below_its_limit() -> None:
    messages = [Cyclic("A", 1_000, 700), Cyclic("B", 1_000, 400)]

    assert response_ns(messages, 1) == {"A": 1_100, "B": None}


def test_no_frame_is_longer_than_the_longest() -> None:
    rows = [
        (0, identifier, EXTENDED * extended, "c", pattern * 8)
        for extended in (0, 1)
        for identifier in (0, 0x7FF, 0x555, 0x1FFF_FFFF * extended)
        for pattern in PATTERNS
    ]
    frames = from_rows(rows)
    for extended in (False, True):
        mine = frames[(frames.flags != 0) == extended]
        assert int(frame_bits(mine)[0].max()) <= longest_bits(8, extended=extended)


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.integers(0, 3_000_000_000), min_size=2, max_size=60),
    st.lists(st.integers(0, 60), max_size=4),
    st.sampled_from([0, 1, 20, 1000]),
)
def test_gaps_are_those_of_the_stamps_however_they_are_fed(
    gaps_ns: list[int], cuts: Sequence[int], period_ms: int
) -> None:
    at_ns = np.cumsum(np.array(gaps_ns, np.int64))
    edges = sorted({0, len(at_ns), *(min(cut, len(at_ns)) for cut in cuts)})
    one = Gaps(period_ms * MS, 0)
    for first, last in pairwise(edges):
        one.feed(at_ns[first:last])
    wanted = gaps_ns[1:]

    assert one.count == len(wanted)
    assert (one.least_ns, one.most_ns) == (min(wanted), max(wanted))
    assert one.mean_ns == pytest.approx(statistics.fmean(wanted))
    for percent in (16, 50, 84, 99):
        rank = -(-len(wanted) * percent // 100)
        exact_us = sorted(wanted)[rank - 1] // 1000
        slack_us = abs(exact_us - period_ms * 1000) / 2048 + 1
        assert exact_us <= one.percentile_us(percent) <= exact_us + slack_us


def test_jitter_is_the_standard_deviation_and_no_start_or_stop_spoils_it() -> None:
    draw = np.random.default_rng(3)
    usual_ns = np.cumsum(1000 * MS + (20 * MS * draw.standard_normal(4000)).astype(np.int64))
    odd_ns = np.concatenate([[usual_ns[0] - 300 * MS], usual_ns, [usual_ns[-1] + 60_000 * MS]])
    one = Gaps(1000 * MS, 0)

    one.feed(odd_ns)

    assert one.jitter_ns == pytest.approx(20 * MS, rel=0.05)
    assert np.diff(odd_ns).std() > 10 * one.jitter_ns
    assert (one.least_ns, one.most_ns) == (300 * MS, 60_000 * MS)


def cyclic(periods_ms: Sequence[float], identifier: int = 0x123) -> Frames:
    at_ms = np.cumsum([0.0, *periods_ms])
    return from_rows([(round(at * MS), identifier, 0, "c", b"\0") for at in at_ms])


DBC = (
    'VERSION ""\nBU_: A B\nBO_ 291 M: 1 A\n SG_ u : 0|8@1+ (1,0) [0|100] "m" B\n'
    'BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;\nBA_DEF_DEF_ "GenMsgCycleTime" 0;\n'
    'BA_ "GenMsgCycleTime" BO_ 291 10;\n'
)


def test_missing_extra_and_stale_frames_are_told_by_the_period_of_the_dbc() -> None:
    frames = cyclic([10, 10, 40, 10, 1, 9, 10, 21, 10])

    (row,) = message_rows(gather([frames], parse_bus(DBC)))

    assert row["gaps"] == 2
    assert row["missing"] == 3 + 1
    assert row["extra"] == 1
    assert row["stale"] == 1  # more than three periods
    assert row["stale_ms"] == 10.0
    assert (row["gap_ms_min"], row["gap_ms_max"]) == (1.0, 40.0)


TWO = (
    'VERSION ""\nBU_: A B\nBO_ 291 M: 1 A\n SG_ u : 0|8@1+ (1,0) [0|100] "m" B\n'
    'BO_ 292 N: 1 A\n SG_ v : 0|8@1+ (1,0) [0|100] "m" B\n'
    'BO_ 293 LOOP: 1 A\n SG_ w : 0|8@1+ (1,0) [0|100] "m" B\n'
    'BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;\nBA_DEF_DEF_ "GenMsgCycleTime" 10;\n'
    'BA_DEF_ BO_ "GenMsgSendType" ENUM "Cyclic","CyclicIfActive";\n'
    'BA_DEF_DEF_ "GenMsgSendType" "Cyclic";\nBA_ "GenMsgSendType" BO_ 293 1;\n'
    'BA_ "GenMsgCycleTime" BO_ 291 10;\nBA_ "GenMsgCycleTime" BO_ 292 20;\n'
    'BA_ "GenMsgCycleTime" BO_ 293 10;\n'
)


def test_a_message_that_falls_silent_before_the_log_ends_is_missing_from_then_on() -> None:
    beats = [(at * MS, 291, 0, "c", b"\1") for at in range(0, 1010, 10)]
    dies = [(at * MS, 292, 0, "c", b"\1") for at in range(0, 410, 20)]

    rows = {row["message"]: row for row in message_rows(gather([from_rows(beats + dies)],
                                                               parse_bus(TWO)))}  # fmt: skip

    assert rows["M"]["missing"] == 0
    assert rows["N"]["missing"] == 600 // 20
    assert (rows["N"]["stale"], rows["N"]["stale_ms"]) == (1, 600.0 - 60.0)
    assert (rows["N"]["gap_ms_max"], rows["N"]["gap_ms_p99"]) == (600.0, 20.0)


@pytest.mark.parametrize("silent_ms", [0, 20, 60])
def test_a_message_that_is_not_stale_when_the_log_ends_misses_nothing(silent_ms: int) -> None:
    beats = [(at * MS, 291, 0, "c", b"\1") for at in range(0, 401 + silent_ms, 10)]
    ends = [(at * MS, 292, 0, "c", b"\1") for at in range(0, 401, 20)]

    rows = message_rows(gather([from_rows(beats + ends)], parse_bus(TWO)))

    assert [row["missing"] for row in rows] == [0, 0]


def test_a_cyclic_message_that_never_came_is_missing_and_an_optional_one_is_not() -> None:
    found = gather(
        [from_rows([(at * MS, 291, 0, "c", b"\1") for at in range(0, 1010, 10)])], parse_bus(TWO)
    )

    (row,) = absent_rows(found)

    assert (row["message"], row["frames"], row["missing"]) == ("N", 0, 50)
    assert (row["stale"], row["gap_ms_max"], row["crc_errors"]) == (1, 1000.0, None)
    assert set(row) == set(message_rows(found)[0])
    judged = Judged(message_rows(found), bus_rows(found), 0, 1, [row])
    told = [str(each) for each in broken([parse_rule("missing > 0")], judged)]
    assert told == ["missing > 0: N on log: missing 50"]


def test_of_this_project_only_currents_and_doors_by_car_may_stay_away() -> None:
    specs = load_bus().messages.values()

    assert [spec.name for spec in specs if spec.optional] == [
        *("ANALOGUE_CMD", "DOOR_CARS", "DOOR_CARS_INV"),
    ]


def test_of_a_dbc_file_without_cycle_times_nothing_can_be_absent_and_that_is_no_pass() -> None:
    bus = parse_bus(DBC.replace('BA_ "GenMsgCycleTime" BO_ 291 10;', ""))
    found = gather([cyclic([10, 10])], bus)
    rule = parse_rule("absent > 0")

    judged = Judged(message_rows(found), bus_rows(found), 0, absent_count(found))

    assert untold([rule], judged) == {rule.text: "cannot be judged of any of 1 logs"}
    assert absent_count(gather([cyclic([10])], parse_bus(DBC))) == 0


def test_a_division_by_zero_is_no_judgement() -> None:
    found = gather([cyclic([10, 10])], parse_bus(DBC))
    rule = parse_rule("missing / extra > 0.1")

    assert untold([rule], Judged(message_rows(found), bus_rows(found))) == {
        rule.text: "cannot be judged of any of 1 messages"
    }


def test_stamps_that_run_backwards_are_counted_and_no_gaps() -> None:
    frames = cyclic([10, 10, -5, 10, 10])

    found = gather([frames], parse_bus(DBC))

    assert message_rows(found)[0]["backwards"] == 1
    assert bus_rows(found)[0]["bus_backwards"] == 1
    assert message_rows(found)[0]["gap_ms_max"] == 10.0


def test_the_load_is_that_of_the_bits_on_the_bus() -> None:
    frames = cyclic([10] * 100)
    bits = bits_of_one(0x123, b"\0")

    (row,) = bus_rows(gather([frames], parse_bus(DBC), baudrate=125_000))

    assert row["bus_load_ratio"] == pytest.approx(101 * bits / 125_000 / 1.0, rel=1e-4)
    assert row["bus_load_ratio_max"] == pytest.approx(10 * bits / 125_000 / 0.1, rel=1e-4)


def test_ranges_are_those_of_the_values_and_the_dbc() -> None:
    frames = from_rows(
        [(at, 0x123, 0, "c", bytes([value])) for at, value in enumerate((7, 3, 101))]
    )

    (row,) = signal_rows(gather([frames[:1], frames[1:]], parse_bus(DBC)))

    assert (row["least"], row["most"], row["out_of_range"], row["frames"]) == (3, 101, 1, 3)


def test_error_remote_and_unknown_frames_are_counted_for_the_bus() -> None:
    rows = [(0, 0x123, 0, "c", b"\0"), (1, 0x1, 0, "c", b""), (2, 0x4, ERROR, "c", b"\0" * 8)]
    frames = from_rows([*rows, (3, 0x123, REMOTE, "c", b""), (4, 0x123, FD, "c", b"\0" * 12)])

    (row,) = bus_rows(gather([frames], parse_bus(DBC)))

    assert row["error_frames"] == row["remote_frames"] == row["fd_frames"] == 1
    assert row["unknown_frames"] == 1


def vital_log() -> Frames:
    """Return pairs of TRACTION_CMD with one wrong CRC, one stuck counter and one missing twin."""
    from can_dbc.codec import Encoder
    from can_dbc.nodes import Direction
    from can_dbc.traction import TractionCommand

    encoder, rows = Encoder(), []
    command = TractionCommand(1000.0, Direction.FORWARD, True)
    for cycle in range(20):
        pair = encoder.encode(command)
        if cycle == 5:
            pair = ((pair[0][0], pair[0][1][:-1] + b"\x00"), pair[1])
        if cycle == 9:
            pair = pair[:1]
        for place, (can_id, data) in enumerate(pair):
            rows.append((cycle * 50 * MS + place * 400_000, can_id, 0, "c", data))
        if cycle == 12:
            rows.append((cycle * 50 * MS + 800_000, *rows[-2][1:]))
    return from_rows(rows)


def test_counter_and_crc_errors_are_those_of_the_codec() -> None:
    found = gather([vital_log()], load_bus())
    rows = {row["message"]: row for row in message_rows(found)}

    assert rows["TRACTION_CMD"]["crc_errors"] == 1
    assert rows["TRACTION_CMD"]["counter_errors"] == 1
    assert rows["TRACTION_CMD"]["lost"] == 1
    assert rows["TRACTION_CMD"]["twin_errors"] == 1
    assert rows["TRACTION_CMD_INV"]["twin_errors"] == 1


@pytest.mark.parametrize("block", [1, 2, 3, 7])
def test_statistics_of_blocks_are_those_of_the_whole(block: int) -> None:
    frames = vital_log()
    parts = [frames[at : at + block] for at in range(0, len(frames), block)]

    whole, pieces = gather([frames], load_bus()), gather(parts, load_bus())

    assert message_rows(pieces) == message_rows(whole)
    assert bus_rows(pieces) == bus_rows(whole)
    assert signal_rows(pieces) == signal_rows(whole)


def test_a_rule_breaks_for_every_message_that_it_is_true_of() -> None:
    found = gather([cyclic([10, 40, 10])], parse_bus(DBC))
    rows, buses = message_rows(found), bus_rows(found)

    def told(*texts: str) -> list[str]:
        rules, judged = [parse_rule(text) for text in texts], Judged(rows, buses, damaged=2)
        return [str(each) for each in broken(rules, judged)]

    assert told("missing > 2") == ["missing > 2: M on c: missing 3"]
    assert told("X*: missing > 2") == []
    assert told("M: gap_ms_max > 3 * period_ms") != []
    assert told("bus_load_ratio > 2") == []
    assert told("damaged > 0") == ["damaged > 0: log on log: damaged 2"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("mising > 0", "unknown signal mising; nearest: missing"),
        ("missing", None),
        (
            "missing > bus_frames",
            "name numbers of messages, of buses, of reassembled messages or of the log",
        ),
        ("1 > 0", "name numbers"),
        ("__import__('os')", "only abs, min, max"),
    ],
)
def test_a_rule_that_is_none_says_what_is_wrong(text: str, words: str | None) -> None:
    if words is None:
        parse_rule(text)
        return
    with pytest.raises(LogError, match=words):
        parse_rule(text)


def test_every_reason_of_the_codec_has_a_number_in_a_row() -> None:
    (row,) = message_rows(gather([cyclic([10])], parse_bus(DBC)))
    numbers = {"crc_errors", "counter_errors", "twin_errors", "invalid_values", "wrong_length"}

    assert numbers | {"rejected"} <= set(row)
    assert len(Reason) == 8  # one is for unknown identifiers, two are for counters, two for twins
