"""Multi-frame messages are reassembled to the data that their senders split."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canlog import Frames
from canlog.command import main
from canlog.frames import EXTENDED, FD, KEY_EXTENDED
from canlog.rows import from_rows
from canlog.transport.messages import Messages, TransportKind, TransportStatus
from canlog.transport.names import fault_text, uds_text
from canlog.transport.reassembly import Reassembler, TransportOptions

MS = 1_000_000
Sent = list[tuple[int, int, bytes]]
"""Identifier, flags and data of each frame of one message."""
LENGTHS = (*range(9), 12, 16, 20, 24, 32, 48, 64)


def broadcast(group: int, source: int, data: bytes) -> Sent:
    """Return the frames of a J1939-21 broadcast: an announcement, then packets of seven bytes."""
    packets = [data[at : at + 7].ljust(7, b"\xff") for at in range(0, len(data), 7)]
    told = bytes([32, *len(data).to_bytes(2, "little"), len(packets), 255])
    told += group.to_bytes(3, "little")
    head = 0x18EC_FF00 | source
    frames = [(head, EXTENDED, told)]
    for at, packet in enumerate(packets, 1):
        frames.append((0x18EB_FF00 | source, EXTENDED, bytes([at]) + packet))
    return frames


def connection(group: int, source: int, target: int, data: bytes) -> Sent:
    """Return the frames of a J1939 connection with the receiver's answers before and after the
    data.
    """
    packets = [data[at : at + 7].ljust(7, b"\xff") for at in range(0, len(data), 7)]
    size, back = len(data).to_bytes(2, "little"), 0x18EC_0000 | source << 8 | target
    named = group.to_bytes(3, "little")
    there = 0x18EC_0000 | target << 8 | source
    frames = [(there, EXTENDED, bytes([16, *size, len(packets), 255]) + named)]
    frames.append((back, EXTENDED, bytes([17, len(packets), 1, 255, 255]) + named))
    for at, packet in enumerate(packets, 1):
        frames.append((0x18EB_0000 | target << 8 | source, EXTENDED, bytes([at]) + packet))
    frames.append((back, EXTENDED, bytes([19, *size, len(packets), 255]) + named))
    return frames


def extended(group: int, source: int, target: int, data: bytes, *, part: int = 16) -> Sent:
    """Return the frames of an extended J1939 connection, with an offset before each part."""
    packets = [data[at : at + 7].ljust(7, b"\xff") for at in range(0, len(data), 7)]
    named, size = group.to_bytes(3, "little"), len(data).to_bytes(4, "little")
    there, back = 0x18C8_0000 | target << 8 | source, 0x18C8_0000 | source << 8 | target
    frames = [(there, EXTENDED, bytes([20]) + size + named)]
    for first in range(0, len(packets), part):
        some = packets[first : first + part]
        offset = first.to_bytes(3, "little")
        after = (first + 1).to_bytes(3, "little")
        frames.append((back, EXTENDED, bytes([21, len(some)]) + after + named))
        frames.append((there, EXTENDED, bytes([22, len(some)]) + offset + named))
        for at, packet in enumerate(some, 1):
            frames.append((0x18C7_0000 | target << 8 | source, EXTENDED, bytes([at]) + packet))
    frames.append((back, EXTENDED, bytes([23]) + size + named))
    return frames


def isotp(identifier: int, data: bytes, *, width: int = 8) -> Sent:
    """Return the frames of an ISO 15765-2 message; frames longer than 8 bytes are CAN FD."""
    flags = (EXTENDED if identifier > 0x7FF else 0) | (FD if width > 8 else 0)
    if len(data) <= 7:
        return [(identifier, flags, bytes([len(data)]) + data)]
    if width > 8 and len(data) <= width - 2:
        return [(identifier, flags, padded(bytes([0, len(data)]) + data))]
    head = (0x1000 | len(data)).to_bytes(2, "big")
    if len(data) > 0xFFF:
        head = b"\x10\x00" + len(data).to_bytes(4, "big")
    cut = width - len(head)
    frames, at = [(identifier, flags, head + data[:cut])], cut
    number = 1
    while at < len(data):
        part = data[at : at + width - 1]
        frames.append((identifier, flags, padded(bytes([0x20 | number % 16]) + part)))
        at, number = at + len(part), number + 1
    return frames


def padded(data: bytes) -> bytes:
    """Pad the data to the next length that CAN FD allows."""
    return data.ljust(next(each for each in LENGTHS if each >= len(data)), b"\xcc")


def interleaved(messages: Sequence[Sent], order: Sequence[int]) -> list[tuple[int, int, bytes]]:
    """Interleave the frames of several messages."""
    left = [list(each) for each in messages]
    found = []
    for at in order:
        waiting = [each for each in left if each]
        if not waiting:
            break
        found.append(waiting[at % len(waiting)].pop(0))
    return [*found, *(frame for each in left for frame in each)]


def framed(sent: Sequence[tuple[int, int, bytes]], step_ns: int = MS) -> Frames:
    rows = [
        (at * step_ns, identifier, flags, "can0", data)
        for at, (identifier, flags, data) in enumerate(sent)
    ]
    return from_rows(rows)


def taken(frames: Frames, size: int, options: TransportOptions | None = None) -> list[Messages]:
    """Reassemble the frames in blocks of `size` frames."""
    reassembler, found = Reassembler(options), []
    for at in range(0, len(frames), size):
        found += reassembler.feed(frames[at : at + size])
    return found + reassembler.finish()


def told(parts: Sequence[Messages]) -> list[tuple[int, int, str, bytes]]:
    """Return key, group, status and data of each message, in order of first frames."""
    rows = [
        (
            part.frames(at)[0],
            (
                int(part.key[at]) & ~KEY_EXTENDED,
                int(part.group[at]),
                TransportStatus(int(part.status[at])).name,
                part.payload(at),
            ),
        )
        for part in parts
        for at in range(len(part))
    ]
    return [row for _, row in sorted(rows)]


@given(
    data=st.lists(st.binary(min_size=9, max_size=60), min_size=1, max_size=5),
    order=st.lists(st.integers(0, 5), max_size=60),
    size=st.integers(1, 40),
)
@settings(max_examples=60, deadline=None)
def test_broadcasts_of_several_sources_are_put_together(
    data: list[bytes], order: list[int], size: int
) -> None:
    messages = [broadcast(0xFECA + at, at, each) for at, each in enumerate(data)]

    parts = taken(framed(interleaved(messages, order)), size)

    wanted = [(0x18EC_FF00 | at, 0xFECA + at, "WHOLE", each) for at, each in enumerate(data)]
    assert sorted(told(parts)) == sorted(wanted)
    assert {int(kind) for part in parts for kind in part.kind} == {TransportKind.BROADCAST}


@given(
    data=st.lists(st.binary(min_size=9, max_size=60), min_size=1, max_size=4),
    order=st.lists(st.integers(0, 5), max_size=60),
    size=st.integers(1, 40),
)
@settings(max_examples=60, deadline=None)
def test_connections_are_put_together_without_the_answers(
    data: list[bytes], order: list[int], size: int
) -> None:
    messages = [connection(0xEF00, at, 0x80 + at, each) for at, each in enumerate(data)]

    parts = taken(framed(interleaved(messages, order)), size)

    wanted = [
        (0x18EC_0000 | (0x80 + at) << 8 | at, 0xEF00, "WHOLE", each) for at, each in enumerate(data)
    ]
    assert sorted(told(parts)) == sorted(wanted)


@given(
    data=st.lists(st.binary(min_size=9, max_size=700), min_size=1, max_size=3),
    order=st.lists(st.integers(0, 5), max_size=60),
    size=st.integers(1, 60),
    part=st.integers(1, 40),
)
@settings(max_examples=60, deadline=None)
def test_extended_connections_are_put_together_beside_plain_ones(
    data: list[bytes], order: list[int], size: int, part: int
) -> None:
    """The same two nodes may have one connection of each kind open."""
    messages = [extended(0xEF00, at, 0x80, each, part=part) for at, each in enumerate(data)]
    messages.append(connection(0xEF00, 0, 0x80, b"beside the long one"))

    parts = taken(framed(interleaved(messages, order)), size)

    wanted = [(0x18C8_8000 | at, 0xEF00, "WHOLE", each) for at, each in enumerate(data)]
    wanted.append((0x18EC_8000, 0xEF00, "WHOLE", b"beside the long one"))
    assert sorted(told(parts)) == sorted(wanted)


def test_extended_messages_are_longer_than_any_other() -> None:
    """10,000 bytes are 1,429 packets, so that the packet numbers begin at 1 again and again."""
    data = bytes(at * 7 % 251 for at in range(10_000))

    parts = taken(framed(extended(0xEF00, 1, 2, data, part=255)), 100)

    assert told(parts) == [(0x18C8_0201, 0xEF00, "WHOLE", data)]
    assert {int(kind) for part in parts for kind in part.kind} == {TransportKind.EXTENDED}


def test_packets_without_their_offset_make_no_message() -> None:
    sent = extended(0xEF00, 1, 2, bytes(range(60)))
    without = [each for each in sent if each[2][0] != 22]

    assert [row[2:] for row in told(taken(framed(without), 5))] == [("UNFINISHED", b"")]


@given(
    data=st.binary(min_size=20, max_size=80),
    twice=st.sets(st.integers(0, 11)),
    later=st.integers(1, 3),
    size=st.integers(1, 30),
    kind=st.sampled_from([broadcast, connection, extended]),
)
@settings(max_examples=60, deadline=None)
def test_a_packet_that_comes_twice_counts_once(
    data: bytes, twice: set[int], later: int, size: int, kind: Callable[..., Sent]
) -> None:
    sent = kind(0xEF00, 1, data) if kind is broadcast else kind(0xEF00, 1, 0x80, data)
    packets = [at for at, each in enumerate(sent) if each[0] >> 16 & 0xFF in (0xEB, 0xC7)]
    for at in sorted((packets[at] for at in twice if at < len(packets)), reverse=True):
        place = min(at + later, packets[-1] + 1)
        sent.insert(place, sent[at])

    parts = taken(framed(sent), size)

    assert [row[1:] for row in told(parts)] == [(0xEF00, "WHOLE", data)]


def test_a_packet_that_comes_twice_with_other_data_makes_no_message() -> None:
    sent = broadcast(0xFECA, 3, bytes(range(30)))
    sent.insert(3, (sent[2][0], EXTENDED, bytes([2]) + b"another"))

    assert [row[2:] for row in told(taken(framed(sent), 50))] == [("WRONG_SEQUENCE", b"")]


@given(
    data=st.lists(st.binary(min_size=1, max_size=300), min_size=1, max_size=4),
    order=st.lists(st.integers(0, 5), max_size=80),
    size=st.integers(1, 60),
    width=st.sampled_from([8, 64]),
)
@settings(max_examples=60, deadline=None)
def test_isotp_of_several_nodes_is_put_together(
    data: list[bytes], order: list[int], size: int, width: int
) -> None:
    messages = [isotp(0x7E0 + at, each, width=width) for at, each in enumerate(data)]

    parts = taken(framed(interleaved(messages, order)), size)

    wanted = [(0x7E0 + at, -1, "WHOLE", each) for at, each in enumerate(data)]
    assert sorted(told(parts)) == sorted(wanted)


def test_messages_follow_each_other_on_one_identifier() -> None:
    texts = [bytes([at]) * (5 + 20 * at) for at in range(4)]
    sent = [frame for each in texts for frame in isotp(0x18DA_F110, each)]
    flow = (0x18DA_10F1, EXTENDED, bytes([0x30, 0, 0]))

    parts = taken(framed([*sent[:2], flow, *sent[2:]]), 5)

    assert [row[3] for row in told(parts)] == texts


def test_a_message_of_more_than_4095_bytes_has_a_length_of_32_bits() -> None:
    data = bytes(range(256)) * 20

    parts = taken(framed(isotp(0x7E8, data)), 100)

    assert told(parts) == [(0x7E8, -1, "WHOLE", data)]


@pytest.mark.parametrize("size", [1, 3, 100])
def test_what_is_missing_is_said_and_gives_no_data(size: int) -> None:
    data = bytes(range(40))
    lost = isotp(0x7E8, data)
    del lost[2]
    torn = isotp(0x7E9, data)[:3]
    again = [*isotp(0x7EA, data)[:3], *isotp(0x7EA, b"\x3e\x00")]
    gap = broadcast(0xFECA, 3, data)
    del gap[2]

    parts = taken(framed([*lost, *torn, *again, *gap]), size)

    assert told(parts) == [
        (0x7E8, -1, "WRONG_SEQUENCE", b""),
        (0x7E9, -1, "UNFINISHED", b""),
        (0x7EA, -1, "UNFINISHED", b""),
        (0x7EA, -1, "WHOLE", b"\x3e\x00"),
        (0x18EC_FF03, 0xFECA, "WRONG_SEQUENCE", b""),
    ]


def test_a_frame_that_comes_too_late_ends_a_message() -> None:
    """The timeout is one second for ISO-TP, and 750 ms for a broadcast."""
    data = bytes(range(20))

    slow = taken(framed(isotp(0x7E8, data), 1001 * MS), 100)
    good = taken(framed(isotp(0x7E8, data), 999 * MS), 100)
    late = taken(framed(broadcast(0xFECA, 1, data), 751 * MS), 100)

    assert [row[2] for row in told(slow)] == ["TIMEOUT"]
    assert [row[2] for row in told(good)] == ["WHOLE"]
    assert [row[2] for row in told(late)] == ["TIMEOUT"]


def test_packets_out_of_turn_are_taken_by_their_number() -> None:
    data = bytes(range(28))
    sent = broadcast(0xFECA, 1, data)
    sent[2], sent[3] = sent[3], sent[2]

    assert told(taken(framed(sent), 100)) == [(0x18EC_FF01, 0xFECA, "WHOLE", data)]


def test_a_connection_may_be_given_up_by_either_side() -> None:
    data = bytes(range(28))
    for identifier in (0x18EC_8001, 0x18EC_0180):
        sent = connection(0xEF00, 1, 0x80, data)[:4]
        sent.append((identifier, EXTENDED, bytes([255, 3, 255, 255, 255, 0, 0xEF, 0])))

        assert [row[2] for row in told(taken(framed(sent), 100))] == ["ABORTED"]


def test_extended_addresses_and_identifiers_of_choice() -> None:
    data = bytes(range(30))
    cut = [(0x123, 0, bytes([0xF1, 0x10, 30]) + data[:5])]
    for at in range(4):
        part = data[5 + 6 * at : 11 + 6 * at]
        cut.append((0x123, 0, bytes([0xF1, 0x21 + at]) + part))
    cut.append((0x123, 0, bytes([0xF1, 0x25]) + data[29:]))

    wanted = TransportOptions(isotp_keys=(0x123,), address_bytes=1)
    assert told(taken(framed(cut), 2, wanted)) == [(0x123, -1, "WHOLE", data)]
    assert taken(framed(cut), 2) == []


@given(
    frames=st.lists(
        st.tuples(
            st.sampled_from([0x7E0, 0x7E8, 0x18ECFF01, 0x18EBFF01, 0x18EC0102, 0x18EB0102]),
            st.binary(max_size=8),
        ),
        max_size=40,
    ),
    size=st.integers(1, 50),
)
@settings(max_examples=100, deadline=None)
def test_any_frames_are_survived_and_blocks_change_nothing(
    frames: list[tuple[int, bytes]], size: int
) -> None:
    made = framed([(key, EXTENDED * (key > 0x7FF), data) for key, data in frames])

    whole = told(taken(made, 1000))

    assert all((status == "WHOLE") == bool(data) or not data for _, _, status, data in whole)
    ended = [row for row in told(taken(made, size)) if row[2] == "WHOLE" and row[0] < 0x800]
    assert ended == [row for row in whole if row[2] == "WHOLE" and row[0] < 0x800]


@pytest.mark.parametrize(
    ("data", "text"),
    [
        ("22F190", "ReadDataByIdentifier F190"),
        ("62F19041", "ReadDataByIdentifier response F190"),
        ("7F2231", "ReadDataByIdentifier refused: requestOutOfRange"),
        ("1003", "DiagnosticSessionControl 03"),
        ("3E80", "TesterPresent 00"),
        ("010C", "OBD CurrentData PID 0C"),
        ("410C1AF8", "OBD CurrentData response PID 0C"),
        ("BA01", ""),
        ("", ""),
    ],
)
def test_services_are_named(data: str, text: str) -> None:
    assert uds_text(bytes.fromhex(data)) == text


def test_fault_codes_of_j1939_are_read() -> None:
    assert fault_text(bytes.fromhex("04FF6D000501")) == "lamps AWL, SPN 109 FMI 5 x1"
    assert fault_text(bytes.fromhex("40FF00000000FFFF")) == "lamps MIL, no fault"
    assert fault_text(bytes.fromhex("54FFB004E3814304F801")) == (
        "lamps MIL RSL AWL, SPN 459952 FMI 3 x1, SPN 459843 FMI 24 x1"
    )


def write(path: Path, sent: Sequence[tuple[int, int, bytes]]) -> None:
    path.write_text(
        "".join(
            f"({at / 1000 + 1_700_000_000:.6f}) can0 "
            f"{identifier:0{8 if flags & EXTENDED else 3}X}#{data.hex()}\n"
            for at, (identifier, flags, data) in enumerate(sent)
        )
    )


def test_the_command_gives_a_row_for_each_message(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    faults = bytes.fromhex("04FF6D0005016E000301")
    write(tmp_path / "x.log", [*broadcast(65226, 0, faults), *isotp(0x7E0, b"\x22\xf1\x90")])

    assert main(["transport", str(tmp_path / "x.log")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2
    assert "PGN 65226 00->FF broadcast  [10]" in lines[0]
    assert "DM1 lamps AWL, SPN 109 FMI 5 x1, SPN 110 FMI 3 x1  (frames 1, 2, 3)" in lines[0]
    assert "7E0  single  [3] 22F190  ReadDataByIdentifier F190  (frames 4)" in lines[1]

    assert main(["transport", str(tmp_path / "x.log"), "--as", "json", "--protocol", "j1939"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [(row["pgn"], row["source"], row["frames"]) for row in rows] == [(65226, 0, [1, 2, 3])]


def test_long_messages_of_j1939_are_decoded(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "x.dbc").write_text(
        'VERSION ""\nBU_: A\nBO_ 2566843390 CI: 20 A\n'
        ' SG_ First : 0|8@1+ (1,0) [0|0] "" A\n SG_ Last : 152|8@1+ (1,0) [0|0] "" A\n'
        'BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";\n'
        'BA_DEF_DEF_ "VFrameFormat" "J1939PG";\n'
    )
    group = 2566843390 >> 8 & 0x3FFFF
    write(tmp_path / "x.log", broadcast(group, 5, bytes(range(20))))

    code = main(["transport", str(tmp_path / "x.log"), "--dbc", str(tmp_path / "x.dbc")])

    assert code == 0
    assert "CI First 0, Last 19  (frames" in capsys.readouterr().out
