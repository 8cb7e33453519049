"""Statistics, differences and the terminal know messages that consist of several frames."""

import json
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canlog.command import main
from canlog.database import load_bus, parse_bus
from canlog.frames import Frames
from canlog.rows import from_rows
from canlog.stats import Statistics, gather
from canlog.stats_rows import (
    absent,
    absent_count,
    bus_rows,
    message_rows,
    signal_rows,
    transport_rows,
    unjudged,
)
from hil_tests.unit.canlog.test_canlog_transport import (
    MS,
    Sent,
    broadcast,
    connection,
    framed,
    isotp,
    write,
)

DBC = """VERSION ""
BU_: A
BO_ 2566843390 CI: 20 A
 SG_ First : 0|8@1+ (1,0) [0|100] "" A
 SG_ Last : 152|8@1+ (0.5,0) [0|0] "kg" A
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_DEF_ "VFrameFormat" "J1939PG";
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_ "GenMsgCycleTime" BO_ 2566843390 10;
"""
"""Component identification, every 10 ms."""
CI = 0xFEEB
TROUBLE_CODES = 0xFECA


def at_times(messages: list[tuple[int, Sent]]) -> Frames:
    """Return the frames of messages, each of which ends at an instant in ms."""
    rows = []
    for end_ms, sent in messages:
        for at, (identifier, flags, data) in enumerate(sent):
            at_ns = end_ms * MS - (len(sent) - 1 - at) * MS // 10
            rows.append((at_ns, identifier, flags, "can0", data))
    return from_rows(sorted(rows, key=lambda row: row[0]))


def in_blocks(frames: Frames, size: int, dbc: str) -> Statistics:
    blocks = (frames[at : at + size] for at in range(0, len(frames), size))
    return gather(blocks, parse_bus(dbc))


@given(
    sizes=st.lists(st.integers(9, 60), min_size=1, max_size=8),
    broken=st.sets(st.integers(0, 7)),
    size=st.integers(1, 60),
)
@settings(max_examples=30, deadline=None)
def test_each_sender_has_its_whole_and_its_incomplete_messages(
    sizes: list[int], broken: set[int], size: int
) -> None:
    messages: list[tuple[int, Sent]] = []
    for at, length in enumerate(sizes):
        for sent in (broadcast(TROUBLE_CODES, 3, bytes(length)), isotp(0x7E8, bytes(length))):
            lost = sent[:1] + sent[2:] if at in broken else sent
            messages.append((10 * at + 10, lost))
    torn = len(broken & set(range(len(sizes))))
    kept = [length for at, length in enumerate(sizes) if at not in broken]

    faults, service = sorted(
        transport_rows(in_blocks(at_times(messages), size, DBC)), key=lambda row: -len(row["id"])
    )

    assert (faults["message"], faults["pgn"], faults["source"]) == ("DM1", TROUBLE_CODES, 3)
    assert (service["id"], service["protocol"], service["pgn"]) == ("7E8", "isotp", None)
    for row in (faults, service):
        assert (row["messages"], row["incomplete"]) == (len(kept), torn)
        assert sum(row["reasons"].values()) == torn
        assert row["bytes_min"] == min(kept, default=None)
        assert row["bytes_max"] == max(kept, default=None)
    whole = [sent for at, (_, sent) in enumerate(messages) if at // 2 not in broken]
    assert sum(row["parts"] for row in (faults, service)) == sum(map(len, whole))


@pytest.mark.parametrize("size", [1, 7, 1000])
def test_a_cyclic_message_of_several_frames_is_judged_like_any_other(size: int) -> None:
    """It comes every 10 ms; the third of six is lost, and the last one is out of its range."""
    firsts = [1, 2, 3, 4, 5, 101]
    frames = at_times(
        [(10 * at + 10, broadcast(CI, 5, bytes([first] + [0] * 18 + [first])))
         for at, first in enumerate(firsts) if at != 2]
    )  # fmt: skip

    found = in_blocks(frames, size, DBC)

    row = next(row for row in message_rows(found) if row["message"] == "CI")
    assert (row["id"], row["frames"], row["missing"], row["gap_ms_max"]) == ("18FEEB05", 5, 1, 20)
    assert (row["out_of_range"], row["short"], row["load_ratio"]) == (1, 0, None)
    assert {row["signal"]: (row["least"], row["most"]) for row in signal_rows(found)} == {
        "First": (1, 101),
        "Last": (0.5, 50.5),
    }
    assert (absent(found), absent_count(found)) == ([], 0)
    assert bus_rows(found)[0]["unknown_frames"] == 0
    assert all(row["message"] == "CI" for row in unjudged(found))


def test_without_a_dbc_file_parts_are_unknown_frames() -> None:
    found = gather([framed(broadcast(CI, 5, bytes(20)))], parse_bus('VERSION ""\n'))

    assert bus_rows(found)[0]["unknown_frames"] == 4
    assert [row["message"] for row in transport_rows(found)] == [""]


def test_identifiers_of_a_dbc_file_carry_no_isotp_unless_a_standard_reserves_them() -> None:
    """The heartbeats of this project have identifiers from 701 on; 7E0 is for diagnosis."""
    frames = framed([(0x701, 0, b"\1\2"), (0x7E0, 0, b"\2\x3e\0"), (0x7A0, 0, b"\2\x3e\0")])

    assert [row["id"] for row in transport_rows(gather([frames], load_bus()))] == ["7A0", "7E0"]


def test_a_rule_may_name_the_numbers_of_reassembled_messages(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lost = connection(CI, 1, 2, bytes(30))
    del lost[3]
    write(tmp_path / "x.log", [*lost, *isotp(0x7E0, b"\x22\xf1\x90")])
    (tmp_path / "x.dbc").write_text(DBC)
    words = ["stats", str(tmp_path / "x.log"), "--dbc", str(tmp_path / "x.dbc")]

    assert main([*words, "--fail-on", "incomplete > 0"]) == 1
    said = capsys.readouterr().out
    assert "CI from 01: incomplete: wrong sequence 1" in said
    assert "incomplete > 0: CI on can0: incomplete 1" in said
    assert main([*words, "--fail-on", "7E0: incomplete > 0"]) == 0
    assert main([*words, "--fail-on", "DM1: incomplete > 0"]) == 1
    assert "the log has no reassembled message DM1" in capsys.readouterr().err
    assert main([*words, "--fail-on", "incomplete > frames"]) == 2
    capsys.readouterr()
    assert main([*words, "--as", "json"]) == 0
    told = json.loads(capsys.readouterr().out)["transport"]
    assert [(row["id"], row["services"]) for row in told] == [
        ("7E0", {"ReadDataByIdentifier": 1}),
        ("18EC0201", {}),
    ]
