"""`stats`, `diff` and `browse` know messages that consist of several frames."""

import json
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canlog.browse.lanes import Lanes, lanes_of
from canlog.browse.screen import screen
from canlog.browse.state import BrowserState, press, shown
from canlog.command import main
from canlog.compare.logs import Allowed, compare
from canlog.database import load_bus, parse_bus
from canlog.frames import Frames
from canlog.reader import Log
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
    interleaved,
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
@settings(max_examples=10, deadline=None)
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


def log_of(frames: Frames) -> Log:
    return Log(Path("x.log"), frames, parse_bus(DBC))


LONG = st.lists(
    st.tuples(st.sampled_from(["CI", "DM1", "UDS"]), st.binary(min_size=21, max_size=40)),
    min_size=1,
    max_size=6,
)
"""Messages of several frames, and what they carry."""
NAMES = {"CI": "CI@05", "DM1": "DM1@00", "UDS": "7E8 ISO-TP"}


def sent_as(kind: str, data: bytes) -> Sent:
    if kind == "UDS":
        return isotp(0x7E8, data)
    return broadcast(CI, 5, data) if kind == "CI" else broadcast(TROUBLE_CODES, 0, data)


@given(
    rounds=st.lists(st.binary(min_size=21, max_size=40), min_size=1, max_size=5),
    orders=st.lists(st.lists(st.integers(0, 2), max_size=18), min_size=2, max_size=2),
)
@settings(max_examples=20, deadline=None)
def test_the_order_of_packets_of_several_senders_is_no_difference(
    rounds: list[bytes], orders: list[list[int]]
) -> None:
    logs = []
    for order in orders:
        rows = []
        for number, data in enumerate(rounds):
            mixed = interleaved([sent_as(kind, data) for kind in NAMES], order)
            rows += [
                ((1000 * number + at) * MS // 10, identifier, flags, "can0", data)
                for at, (identifier, flags, data) in enumerate(mixed)
            ]
        logs.append(log_of(from_rows(rows)))

    found = compare(logs[0], logs[1], Allowed())

    assert {(each.name, each.pairs) for each in found.messages} == {
        (name, len(rounds)) for name in NAMES.values()
    }
    assert not found.differs


@given(messages=LONG, at=st.integers(0, 5), byte=st.integers(20, 39))
@settings(max_examples=20, deadline=None)
def test_the_message_that_differs_is_named_and_no_packet(
    messages: list[tuple[str, bytes]], at: int, byte: int
) -> None:
    """Byte 19 of CI is its last signal; other bytes of it are in no signal."""
    at %= len(messages)
    kind, data = messages[at]
    place = 19 if kind == "CI" else byte % len(data)
    other = data[:place] + bytes([(data[place] + 9) % 256]) + data[place + 1 :]
    changed = [*messages[:at], (kind, other), *messages[at + 1 :]]
    logs = [
        log_of(framed([frame for kind, data in each for frame in sent_as(kind, data)]))
        for each in (messages, changed)
    ]

    found = compare(logs[0], logs[1], Allowed())

    (one,) = [each for each in found.messages if each.differs]
    assert one.name == NAMES[kind]
    assert (one.frames_a, one.frames_b, one.pairs) == (
        (sum(each == kind for each, _ in messages),) * 3
    )
    assert [(each.signal, each.frames) for each in one.signals] == [
        ("Last" if kind == "CI" else "data", 1)
    ]
    if kind != "CI":
        assert one.signals[0].value_b == other.hex(" ").upper()


def test_a_message_that_lacks_a_packet_differs_and_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = broadcast(TROUBLE_CODES, 0, bytes(range(20)))
    plain: Sent = [(0x123, 0, b"abc")]
    write(tmp_path / "a.log", [*whole, *plain])
    write(tmp_path / "b.log", [*whole[:2], plain[0], *whole[3:]])
    words = ["diff", str(tmp_path / "a.log"), str(tmp_path / "b.log"), "--no-dbc"]

    assert main(words) == 1
    said = capsys.readouterr().out
    assert "DM1@00: 1 / 1 messages" in said
    assert "/ incomplete: wrong sequence" in said
    assert main([*words, "--ignore", "DM1@00"]) == 0
    assert main([*words, "--ignore", "DM2@00"]) == 2


def test_answers_of_the_receiver_and_defined_diagnosis_are_compared_as_frames() -> None:
    """A file that defines 7E8 gives better names than its bytes have."""
    bus = parse_bus(DBC + 'BO_ 2024 OBD: 8 A\n SG_ service : 8|8@1+ (1,0) [0|0] "" A\n')
    sent = [*connection(CI, 1, 2, bytes(20)), *isotp(0x7E8, b"\x41\x0c\x1a\xf8")]
    logs = [Log(Path("x.log"), framed(sent), bus) for _ in range(2)]

    found = compare(logs[0], logs[1], Allowed())

    assert [(each.name, each.frames_a) for each in found.messages] == [
        *(("OBD", 1), ("18EC0102", 2), ("CI@01-02", 1)),
    ]


def mixed_log() -> Frames:
    """Return messages of each kind, one of them incomplete, on two channels."""
    sent = [*broadcast(CI, 5, bytes(range(20))), *isotp(0x7E0, b"\x22\xf1\x90")]
    faults = bytes.fromhex("04FF6D0005016E000301")
    sent += [*broadcast(TROUBLE_CODES, 0, faults)[:2], *broadcast(TROUBLE_CODES, 0, faults)]
    sent += broadcast(CI, 5, bytes(range(100, 80, -1)))
    return from_rows(
        [(at * MS, identifier, flags, channel, data)
         for at, (identifier, flags, data) in enumerate(sent) for channel in ("can0", "can1")]
    )  # fmt: skip


def test_the_terminal_lists_reassembled_messages_with_their_meaning() -> None:
    frames = mixed_log()
    lanes = lanes_of(frames, parse_bus(DBC))
    state = BrowserState("log", lanes, 0, lanes.end_ns)

    lines = ["".join(text for _, text in row) for row in screen(state, 120, 40)]

    def line(name: str) -> str:
        return next(each for each in lines if f" {name} " in each)

    assert f"{len(frames)} frames" in lines[0]
    assert "18FEEB05" in line("can0:CI@05")
    assert " 2  64 63 62" in line("can1:CI@05")
    assert "     7E0 can0:7E0 ISO-TP" in line("can0:7E0 ISO-TP")
    assert "ReadDataByIdentifier F190  22 F1 90" in line("can1:7E0 ISO-TP")
    assert "lamps AWL, SPN 109 FMI 5 x1, SPN 110 FMI 3 x1" in line("can0:DM1@00")
    state.selected = next(lane.key for lane in shown(state) if lane.name == "can1:CI@05")
    press(state, "left")
    drawn = "\n".join("".join(text for _, text in row) for row in screen(state, 120, 40))
    assert "Last                     9.5 kg" in drawn
    incomplete = next(lane for lane in shown(state) if lane.name == "can0:DM1@00")
    assert incomplete.told(0) == "incomplete: unfinished"


@given(sizes=st.lists(st.integers(1, 9), min_size=1, max_size=20))
@settings(max_examples=20, deadline=None)
def test_a_live_bus_gives_the_messages_of_its_log(sizes: list[int]) -> None:
    frames = mixed_log()[::2]
    live = Lanes(parse_bus(DBC), {})
    rows = [
        (int(frames.at_ns[at]), int(frames.key[at]), 0, frames.payload(at))
        for at in range(len(frames))
    ]
    for size in [*sizes, len(rows)]:
        live.feed(rows[:size])
        del rows[:size]

    wanted = lanes_of(frames, parse_bus(DBC))

    assert set(live.lanes) == set(wanted.lanes)
    for key, lane in wanted.lanes.items():
        mine = live.lanes[key]
        assert (mine.name, mine.at_ns.tolist()) == (lane.name, lane.at_ns.tolist())
        assert [(mine.payload(row), mine.told(row)) for row in range(len(mine))] == [
            (lane.payload(row), lane.told(row)) for row in range(len(lane))
        ]
