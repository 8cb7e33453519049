"""Counters and CRCs that foreign DBC files declare, and the reasons why others cannot be judged."""

import random
from collections.abc import Sequence

import numpy as np
import pytest
from crccheck.crc import Crc
from hypothesis import given, settings
from hypothesis import strategies as st

from canlog.bits import frame_bits
from canlog.database import Bus, load_bus, parse_bus
from canlog.declared import declared_of, p01_crc
from canlog.frames import BRS, EXTENDED, FD, FD_LENGTHS, Frames
from canlog.latency import longest_fd_bits
from canlog.plan import Payloads
from canlog.rows import from_rows
from canlog.rules import Judged, parse_rule, untold
from canlog.stats import gather
from canlog.stats_rows import absent, bus_rows, message_rows, unjudged

MS = 1_000_000
DATA_ID = 0x123
DBC = """\
VERSION ""
BU_: A B
BO_ 256 SAFE: 8 A
 SG_ check : 0|8@1+ (1,0) [0|255] "" B
 SG_ count : 8|4@1+ (1,0) [0|14] "" B
 SG_ value : 16|32@1+ (1,0) [0|0] "" B
BO_ 257 COUNTED: 2 A
 SG_ rolling : 0|8@1+ (1,0) [0|255] "" B
BO_ 258 STRANGE: 2 A
 SG_ checksum : 0|8@1+ (1,0) [0|255] "" B
BO_ 259 PLAIN: 1 A
 SG_ x : 0|8@1+ (1,0) [0|255] "" B
BO_ 260 ABSENT: 1 A
 SG_ y : 0|8@1+ (1,0) [0|255] "" B
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_ BO_ "E2ECounterSignal" STRING;
BA_DEF_ BO_ "E2ECrcSignal" STRING;
BA_DEF_ BO_ "E2EProfile" STRING;
BA_DEF_ BO_ "E2EDataId" INT 0 65535;
BA_DEF_ BO_ "E2ETimeout" INT 0 65535;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_DEF_DEF_ "E2ECounterSignal" "";
BA_DEF_DEF_ "E2ECrcSignal" "";
BA_DEF_DEF_ "E2EProfile" "";
BA_DEF_DEF_ "E2EDataId" 0;
BA_DEF_DEF_ "E2ETimeout" 0;
BA_ "GenMsgCycleTime" BO_ 256 10;
BA_ "GenMsgCycleTime" BO_ 260 100;
BA_ "E2ECounterSignal" BO_ 256 "count";
BA_ "E2ECrcSignal" BO_ 256 "check";
BA_ "E2EProfile" BO_ 256 "P01";
BA_ "E2EDataId" BO_ 256 291;
BA_ "E2ECounterSignal" BO_ 257 "rolling";
BA_ "E2ETimeout" BO_ 257 250;
BA_ "E2ECrcSignal" BO_ 258 "checksum";
BA_ "E2EProfile" BO_ 258 "homemade";
BA_ "E2ECounterSignal" BO_ 258 "rolling";
"""


@pytest.fixture(scope="module")
def bus() -> Bus:
    return parse_bus(DBC, "theirs.dbc")


def safe(counter: int, value: bytes = bytes(6), *, spoiled: int = 0) -> bytes:
    """Return a frame of SAFE as its sender makes it, with the CRC of another library."""
    body = bytes([counter]) + value
    crc = Crc(8, 0x1D, initvalue=0)
    crc.process(DATA_ID.to_bytes(2, "little") + body)
    return bytes([crc.final() ^ spoiled]) + body


def sent(frames: Sequence[bytes], identifier: int = 256) -> Frames:
    return from_rows(
        [(at * 10 * MS, identifier, 0, "can1", data) for at, data in enumerate(frames)]
    )


def test_the_crc_is_that_of_the_published_example() -> None:
    """AUTOSAR PRS_E2EProtocol, profile 1: zeros, and both bytes of data identifier 0x123."""
    data = np.zeros((2, 8), np.uint8)
    data[1, 1] = 1
    payloads = Payloads(data, np.full(2, 8, np.uint8))

    assert p01_crc(payloads, 8, 0, 0x123).tolist() == [0xCC, 0x91]


@given(st.integers(0, 0xFFFF), st.integers(0, 7), st.binary(min_size=8, max_size=8))
@settings(max_examples=60, deadline=None)
def test_the_crc_is_that_of_a_library(data_id: int, place: int, data: bytes) -> None:
    payloads = Payloads(np.frombuffer(data, np.uint8).reshape(1, 8), np.full(1, 8, np.uint8))
    crc = Crc(8, 0x1D, initvalue=0)
    crc.process(data_id.to_bytes(2, "little") + data[:place] + data[place + 1 :])

    assert p01_crc(payloads, 8, place, data_id).tolist() == [crc.final()]


@pytest.mark.parametrize("block", [1, 2, 5, 100])
def test_errors_of_declared_counters_and_crcs_are_counted(bus: Bus, block: int) -> None:
    draw = random.Random(2)
    counters = [13, 14, 0, 1, 1, 2, 5, 15, 6, 4, 5]
    frames = sent(
        [
            safe(each, draw.randbytes(6), spoiled=at == 3)
            for at, each in enumerate([*counters, 6, 7])
        ]
    )
    blocks = [frames[at : at + block] for at in range(0, len(frames), block)]

    (row,) = message_rows(gather(blocks, bus))

    # The first frame with counter 1 has a wrong CRC and is ignored; the second one follows 0.
    assert row["crc_errors"] == 1
    # 15 is no valid counter value, and 4 after 6 runs backwards.
    assert row["counter_errors"] == 2
    assert row["lost"] == 2
    assert row["rejected"] == 3


def test_a_counter_is_checked_without_a_crc_and_not_over_a_silence(bus: Bus) -> None:
    beats = [(0, 254), (100, 255), (200, 0), (300, 3), (400, 3), (900, 90), (1000, 91)]
    frames = from_rows([(at * MS, 257, 0, "c", bytes([value, 0])) for at, value in beats])

    (row,) = message_rows(gather([frames], bus))

    assert (row["lost"], row["counter_errors"], row["crc_errors"]) == (2, 1, None)
    assert row["stale"] == 1  # by E2ETimeout


def test_what_is_not_judged_is_said_with_why(bus: Bus) -> None:
    plain = from_rows([(0, 259, 0, "c", b"\1"), (0, 258, 0, "c", b"\1\2"), (0, 5, 0, "c", b"")])

    found = gather([plain], bus)
    told = {(row["message"], row["what"]): row["why"] for row in unjudged(found)}
    rows = {row["message"]: row for row in message_rows(found)}

    assert told["PLAIN", "counter"] == "no E2ECounterSignal"
    assert told["PLAIN", "missing and extra frames"] == "no cycle time (GenMsgCycleTime)"
    assert told["STRANGE", "CRC"] == "E2EProfile 'homemade' is not known; P01 is"
    assert "names rolling, which the message does not have" in told["STRANGE", "counter"]
    assert any(why == "no DBC file defines the identifier" for why in told.values())
    for name in ("missing", "stale", "lost", "crc_errors", "counter_errors", "twin_errors"):
        assert rows["PLAIN"][name] is None
    assert absent(found) == ["SAFE", "ABSENT"]


def test_a_rule_that_nothing_can_be_held_to_says_so(bus: Bus) -> None:
    found = gather([sent([b"\0"], 259)], bus)
    judged = Judged(message_rows(found), bus_rows(found), 0, len(absent(found)))
    texts = ("crc_errors > 0", "DOOR_*: frames < 9", "frames < 1", "absent > 5")

    told = untold([parse_rule(text) for text in texts], judged)

    assert told == {
        "crc_errors > 0": "cannot be judged of any of 1 messages",
        "DOOR_*: frames < 9": "the log has no message DOOR_*",
    }


def test_the_codec_judges_this_project_and_nothing_is_left_to_attributes() -> None:
    bus = load_bus()

    assert all(declared_of(spec).crc is None for spec in bus.messages.values())


@given(st.integers(0, 1 << 32), st.booleans(), st.booleans())
@settings(max_examples=30, deadline=None)
def test_no_fd_frame_is_longer_than_the_longest(seed: int, extended: bool, switched: bool) -> None:
    draw = random.Random(seed)
    flags = FD | (BRS if switched else 0) | (EXTENDED if extended else 0)
    for length in FD_LENGTHS:
        pattern = draw.choice([b"\0", b"\xff", b"\x78", b"\xf8", draw.randbytes(3)])
        data = (pattern * length)[:length]
        identifier = draw.choice([0, draw.randrange(1 << (29 if extended else 11))])
        frames = from_rows([(0, identifier, flags, "c", data)])

        nominal, fast = longest_fd_bits(length, extended=extended, switched=switched)
        took, took_fast = (int(each[0]) for each in frame_bits(frames))

        assert took <= nominal
        assert took + took_fast <= nominal + fast


def test_a_worst_frame_comes_within_the_bits_that_the_format_fixes() -> None:
    """Runs of four equal bits at any offset: each run of four causes a stuff bit."""
    turns = [bytes([0b0001111000011110 >> turn & 0xFF]) for turn in range(8)]
    worst = [from_rows([(0, 0x0F0, FD | BRS, "c", turn * 64)]) for turn in turns]
    longest = longest_fd_bits(64, extended=False, switched=True)

    took = max(sum(int(each[0]) for each in frame_bits(frames)) for frames in worst)

    assert sum(longest) - 5 <= took <= sum(longest)


def test_the_latency_of_fd_frames_alone_is_their_longest_time() -> None:
    text = DBC.replace("BO_ 259 PLAIN: 1 A", "BO_ 259 PLAIN: 64 A")
    frames = from_rows([(at * MS, 259, FD | BRS, "c", bytes(64)) for at in range(9)])
    nominal, fast = longest_fd_bits(64, extended=False, switched=True)

    (row,) = message_rows(
        gather([frames], parse_bus(text), baudrate=500_000, data_baudrate=2_000_000)
    )

    assert row["latency_ms"] == pytest.approx(nominal / 500 + fast / 2000)
