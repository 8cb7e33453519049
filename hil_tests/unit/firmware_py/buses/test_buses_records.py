"""Records of the embedded bus: packing, reassembly and stamps, however the stream is cut."""

import itertools
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.buses.records import (
    PROTOCOL_VERSION,
    RECORD_BYTES,
    Announcement,
    Control,
    RecordReader,
    pack_announcement,
    pack_frame,
    pack_lost,
    pack_text,
    read_announcement,
    stamp_frames,
)
from firmware_py.ports import CanFrame

LATE_NS = 2**62
EXTENDED, REMOTE, ERROR = 0x8000_0000, 0x4000_0000, 0x2000_0000

FRAMES = st.lists(
    st.tuples(st.integers(0, 2**62), st.integers(0, 0x7FF), st.binary(max_size=8)), max_size=20
)


def by_hand(flags_and_id: int, data: bytes, stamp_ns: int = 0, length: int | None = None) -> bytes:
    """A record built field by field from the layout in the module's docstring."""
    count = len(data) if length is None else length
    return (
        flags_and_id.to_bytes(4, "little")
        + bytes([count, 0, 0, 0])
        + data.ljust(8, b"\0")
        + stamp_ns.to_bytes(8, "little", signed=True)
    )


@given(can_id=st.integers(0, 0x7FF), data=st.binary(max_size=8))
def test_a_packed_frame_has_the_documented_layout(can_id: int, data: bytes) -> None:
    assert pack_frame(can_id, data) == by_hand(can_id, data)


def test_the_layout_is_the_kernels_own_for_the_first_sixteen_bytes() -> None:
    kernel_frame = struct.pack("<IB3x8s", 0x181, 3, b"abc")

    assert pack_frame(0x181, b"abc")[:16] == kernel_frame


@pytest.mark.parametrize(("can_id", "data"), [(0x800, b""), (-1, b""), (1, bytes(9))])
def test_only_plain_frames_are_packed(can_id: int, data: bytes) -> None:
    with pytest.raises(ValueError, match="frame"):
        pack_frame(can_id, data)


@given(frames=FRAMES, cuts=st.lists(st.integers(0, 500), max_size=12))
def test_frames_are_decoded_equally_however_the_stream_is_cut(
    frames: list[tuple[int, int, bytes]], cuts: list[int]
) -> None:
    stream = b"".join(by_hand(can_id, data, stamp_ns) for stamp_ns, can_id, data in frames)
    places = sorted({0, len(stream), *(cut for cut in cuts if cut < len(stream))})
    reader = RecordReader(None)

    heard: list[CanFrame] = []
    for start, end in itertools.pairwise(places):
        heard += reader.feed(stream[start:end], LATE_NS)

    assert heard == [CanFrame(*frame) for frame in frames]
    assert (reader.lost, reader.errors) == (0, 0)


@given(frames=FRAMES, accepted=st.sets(st.integers(0, 0x7FF)))
def test_only_accepted_identifiers_are_returned(
    frames: list[tuple[int, int, bytes]], accepted: set[int]
) -> None:
    accepted |= {can_id for _, can_id, _ in frames[::2]}
    stream = b"".join(by_hand(can_id, data, stamp_ns) for stamp_ns, can_id, data in frames)

    heard = RecordReader(accepted).feed(stream, LATE_NS)

    assert heard == [CanFrame(*frame) for frame in frames if frame[1] in accepted]


def test_no_frame_has_a_stamp_in_the_future() -> None:
    """The hub may stamp a frame after the reader took its time and before it reads."""
    stream = by_hand(0x10, b"", 900) + by_hand(0x11, b"", 1100)

    assert [frame.stamp_ns for frame in RecordReader(None).feed(stream, 1000)] == [900, 1000]


def test_special_frames_are_marked_and_hidden_from_filtered_readers() -> None:
    stream = by_hand(EXTENDED | 0x101, b"a") + by_hand(REMOTE | 0x101, b"", length=4)

    assert RecordReader([0x101]).feed(stream, LATE_NS) == []
    assert RecordReader(None).feed(stream, LATE_NS) == [
        CanFrame(0, 0x101, b"a", extended=True),
        CanFrame(0, 0x101, b"", remote=True),
    ]


@pytest.mark.parametrize(
    "record",
    [
        by_hand(ERROR | 0x4, bytes(8)),
        by_hand(0x101, bytes(8), length=9),
        by_hand(0x800, b""),
        by_hand(EXTENDED | 0x101, bytes(8), length=255),
        by_hand(EXTENDED | REMOTE | ERROR | 77, b""),
    ],
)
def test_an_invalid_record_is_only_counted(record: bytes) -> None:
    for reader in (RecordReader(None), RecordReader([0x101])):
        assert reader.feed(record + by_hand(0x101, b"z"), LATE_NS) == [CanFrame(0, 0x101, b"z")]
        assert reader.errors == 1


@pytest.mark.parametrize("accept_ids", [None, [0x101]])
def test_the_reader_learns_how_many_frames_the_hub_dropped(accept_ids: list[int] | None) -> None:
    reader = RecordReader(accept_ids)

    frames = reader.feed(pack_lost(7) + by_hand(0x101, b"") + pack_lost(123_456_789_012), LATE_NS)

    assert len(frames) == 1
    assert (reader.lost, reader.errors) == (123_456_789_012, 0)


RECORDS = st.lists(
    st.one_of(
        st.builds(by_hand, st.integers(0, 0x7FF), st.binary(max_size=8)),
        st.builds(
            lambda flags, low, data: by_hand(flags << 29 | low, data),
            st.integers(0, 7),
            st.integers(0, 2**29 - 1),
            st.binary(max_size=8),
        ),
        st.binary(min_size=RECORD_BYTES, max_size=RECORD_BYTES),
    ),
    min_size=1,
    max_size=30,
)


@given(records=RECORDS, stamp_ns=st.integers(0, 2**63 - 1))
def test_the_hub_stamps_every_frame_and_drops_all_other_records(
    records: list[bytes], stamp_ns: int
) -> None:
    """The oracle stamps record by record; the product stamps all columns at once."""
    expected = b""
    for record in records:
        is_control = record[3] >> 5 == 0b111
        if not is_control and record[4] <= 8:
            expected += record[:16] + stamp_ns.to_bytes(8, "little")

    assert stamp_frames(bytearray(b"".join(records)), stamp_ns) == expected


@given(control=st.sampled_from(Control), text=st.binary(max_size=100))
def test_a_text_fills_whole_records_and_is_announced_with_its_size(
    control: Control, text: bytes
) -> None:
    packed = pack_text(control, text)

    assert len(packed) % RECORD_BYTES == 0
    assert read_announcement(packed) == Announcement(control, PROTOCOL_VERSION, len(text))
    assert packed[RECORD_BYTES:].rstrip(b"\0") == text.rstrip(b"\0")


@pytest.mark.parametrize("record", [bytes(24), by_hand(0x101, b"hello"), b"\xff" * 24])
def test_a_frame_or_noise_is_no_announcement(record: bytes) -> None:
    assert read_announcement(record) is None


def test_an_announcement_carries_version_and_detail() -> None:
    packed = pack_announcement(Control.REFUSED, 3, version=9)

    assert read_announcement(packed) == Announcement(Control.REFUSED, 9, 3)
