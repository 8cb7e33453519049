"""The frame hash: computed again independently, and equal only for equal traffic."""

import hashlib
import struct

from hypothesis import given
from hypothesis import strategies as st

from metro_hil.model.frame_hash import LINK_S, FrameHash

NS_PER_S = 1_000_000_000
Frame = tuple[int, int, bytes]

frames = st.lists(
    st.tuples(
        st.integers(0, 65 * NS_PER_S), st.integers(0, 0x7FF), st.binary(min_size=0, max_size=8)
    ),
    max_size=40,
).map(lambda found: sorted(found, key=lambda frame: frame[0]))


def by_hand(traffic: list[Frame]) -> list[str]:
    """Each link is the SHA-256 of the link before and of the records of its seconds."""
    last = traffic[-1][0] // (LINK_S * NS_PER_S) if traffic else 0
    links: list[str] = []
    before = b""
    for number in range(last + 1):
        records = b"".join(
            struct.pack("<qHB", stamp, can_id, len(data)) + data
            for stamp, can_id, data in traffic
            if stamp // (LINK_S * NS_PER_S) == number
        )
        before = hashlib.sha256(before + records).digest()
        links.append(before.hex())
    return links


def chained(traffic: list[Frame]) -> FrameHash:
    chain = FrameHash()
    for stamp_ns, can_id, data in traffic:
        chain.frame(stamp_ns, can_id, data)
    return chain


@given(frames)
def test_each_link_covers_its_seconds_and_the_link_before(traffic: list[Frame]) -> None:
    chain = chained(traffic)

    assert list(chain.links) == by_hand(traffic)
    assert chain.value == chain.links[-1]
    assert chain.frames == len(traffic)


@given(frames, st.data())
def test_any_changed_bit_changes_the_hash_and_no_earlier_link(
    traffic: list[Frame], data: st.DataObject
) -> None:
    carrying = [index for index, frame in enumerate(traffic) if frame[2]]
    if not carrying:
        return
    index = data.draw(st.sampled_from(carrying))
    stamp_ns, can_id, payload = traffic[index]
    bit = data.draw(st.integers(0, 8 * len(payload) - 1))
    flipped = bytearray(payload)
    flipped[bit // 8] ^= 1 << bit % 8
    other = [*traffic[:index], (stamp_ns, can_id, bytes(flipped)), *traffic[index + 1 :]]

    one, two = chained(traffic).links, chained(other).links

    place = stamp_ns // (LINK_S * NS_PER_S)
    assert one[:place] == two[:place]
    assert all(a != b for a, b in zip(one[place:], two[place:], strict=True))


def test_reading_the_hash_between_frames_does_not_change_it() -> None:
    traffic = [(second * NS_PER_S, 0x110, bytes([second])) for second in range(30)]
    asked = FrameHash()
    for stamp_ns, can_id, data in traffic:
        asked.frame(stamp_ns, can_id, data)
        assert asked.value

    assert asked.links == chained(traffic).links
