"""Telegrams survive any cutting of the stream, and no damage turns one into another."""

import itertools
from dataclasses import replace

import pytest
from crccheck.crc import Crc32
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.tag_reader.telegram import (
    CLOCK_PERIOD_MS,
    KIND_CODES,
    MAX_FRAME_BYTES,
    MAX_PAYLOAD_BYTES,
    DuplicateTelegram,
    HealthTelegram,
    Heard,
    TagTelegram,
    TelegramParser,
    TornReason,
    TornTelegram,
    encode,
)
from firmware_py.trackdb import TagKind

TAG = TagTelegram(7, 0x01020304, TagKind.T2, stamp_ms=1000.5, sent_ms=1012.0, pulses=4711)
BALISE = TagTelegram(
    8, 0x7E7D7E7D, TagKind.BALISE, 2113929.5, 2113930.0, 0x7D7E, bytes.fromhex("7e7d5e5d00ff7e")
)
HEALTH = HealthTelegram(9, 5000.0, antenna_ok=True, telegrams_read=2, crc_errors=1, uptime_s=5)

# The wire holds tenths of a millisecond; only those are read back unchanged.
stamps_ms = st.integers(0, 2**32 - 1).map(lambda ticks: ticks / 10)
tags = st.builds(
    TagTelegram,
    sequence=st.integers(0, 255),
    tag_id=st.integers(1, 2**32 - 1),
    kind=st.sampled_from(TagKind),
    stamp_ms=stamps_ms,
    sent_ms=stamps_ms,
    pulses=st.integers(0, 65535),
    payload=st.binary(max_size=MAX_PAYLOAD_BYTES) | st.just(b"\x7e" * MAX_PAYLOAD_BYTES),
)
healths = st.builds(
    HealthTelegram,
    sequence=st.integers(0, 255),
    sent_ms=stamps_ms,
    antenna_ok=st.booleans(),
    telegrams_read=st.integers(0, 2**32 - 1),
    crc_errors=st.integers(0, 2**32 - 1),
    uptime_s=st.integers(0, 2**32 - 1),
)
noise = st.binary(max_size=600) | st.lists(st.sampled_from([0x7E, 0x7D, 0x5E, 1]), max_size=80).map(
    bytes
)


def heard(*pieces: bytes) -> list[Heard]:
    parser = TelegramParser()
    return [item for piece in pieces for item in parser.feed(piece)]


def on_the_wire(content: bytes) -> bytes:
    """The oracle for all tests below: it stuffs byte by byte and uses another CRC
    implementation."""
    stuffed = bytearray()
    for byte in content + int(Crc32.calc(content)).to_bytes(4, "big"):
        stuffed += bytes([0x7D, byte ^ 0x20]) if byte in (0x7E, 0x7D) else bytes([byte])
    return b"\x7e" + bytes(stuffed) + b"\x7e"


def tag_content(tag: TagTelegram) -> bytes:
    return (
        bytes([1, 1, tag.sequence, list(TagKind).index(tag.kind) + 1])
        + tag.tag_id.to_bytes(4, "big")
        + round(tag.stamp_ms * 10).to_bytes(4, "big")
        + round(tag.sent_ms * 10).to_bytes(4, "big")
        + tag.pulses.to_bytes(2, "big")
        + bytes([len(tag.payload)])
        + tag.payload
    )


def health_content(health: HealthTelegram) -> bytes:
    numbers = (
        round(health.sent_ms * 10),
        health.telegrams_read,
        health.crc_errors,
        health.uptime_s,
    )
    return bytes([1, 2, health.sequence, int(health.antenna_ok)]) + b"".join(
        number.to_bytes(4, "big") for number in numbers
    )


@given(tags)
def test_a_tag_telegram_is_encoded_as_documented(tag: TagTelegram) -> None:
    assert encode(tag) == on_the_wire(tag_content(tag))


@given(healths)
def test_a_health_telegram_is_encoded_as_documented(health: HealthTelegram) -> None:
    assert encode(health) == on_the_wire(health_content(health))


@given(st.lists(tags | healths, min_size=1, max_size=12), st.data())
def test_telegrams_are_decoded_however_the_stream_is_cut(
    telegrams: list[TagTelegram | HealthTelegram], data: st.DataObject
) -> None:
    sent = [replace(telegram, sequence=at) for at, telegram in enumerate(telegrams)]
    stream = b"".join(encode(telegram) for telegram in sent)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=30)))
    edges = [0, *cuts, len(stream)]

    pieces = [stream[start:end] for start, end in itertools.pairwise(edges)]

    assert heard(*pieces) == sent


def test_telegrams_are_decoded_byte_by_byte() -> None:
    stream = encode(TAG) + encode(BALISE) + encode(HEALTH)

    assert heard(*(bytes([byte]) for byte in stream)) == [TAG, BALISE, HEALTH]


def test_two_telegrams_may_share_a_flag() -> None:
    assert heard(encode(TAG)[:-1] + encode(BALISE)) == [TAG, BALISE]


@pytest.mark.parametrize("victim", [TAG, BALISE, HEALTH], ids=["tag", "balise", "health"])
def test_no_single_wrong_bit_gives_another_telegram_or_loses_a_neighbour(
    victim: TagTelegram | HealthTelegram,
) -> None:
    before = replace(HEALTH, sequence=victim.sequence - 1)
    after = replace(TAG, sequence=victim.sequence + 1)
    frame = encode(victim)

    for bit in range(len(frame) * 8):
        broken = bytearray(frame)
        broken[bit // 8] ^= 1 << bit % 8
        result = heard(encode(before) + bytes(broken) + encode(after))
        telegrams = [item for item in result if not isinstance(item, TornTelegram)]

        assert telegrams == [before, after], f"bit {bit}"
        assert len(result) > len(telegrams), f"bit {bit}"


@pytest.mark.parametrize("victim", [TAG, BALISE, HEALTH], ids=["tag", "balise", "health"])
def test_no_missing_or_doubled_byte_gives_another_telegram(
    victim: TagTelegram | HealthTelegram,
) -> None:
    before = replace(HEALTH, sequence=victim.sequence - 1)
    after = replace(TAG, sequence=victim.sequence + 1)
    frame = encode(victim)

    for at in range(len(frame)):
        for broken in (frame[:at] + frame[at + 1 :], frame[:at] + frame[at : at + 1] + frame[at:]):
            result = heard(encode(before) + broken + encode(after))
            telegrams = [item for item in result if not isinstance(item, TornTelegram)]

            # A missing or doubled flag does no harm; any other byte costs the telegram.
            assert telegrams in ([before, after], [before, victim, after])
            assert (victim in telegrams) == (at in (0, len(frame) - 1))


@pytest.mark.parametrize("length", range(1, len(encode(BALISE)) - 1))
def test_a_truncated_telegram_is_torn_and_the_next_is_received(length: int) -> None:
    result = heard(encode(BALISE)[:length] + encode(HEALTH))

    assert result[-1] == HEALTH
    assert all(isinstance(item, TornTelegram) for item in result[:-1])


@given(st.lists(noise, max_size=8))
def test_noise_never_raises_and_the_next_telegram_is_received(pieces: list[bytes]) -> None:
    parser = TelegramParser()
    for piece in pieces:
        for item in parser.feed(piece):
            assert isinstance(item, TornTelegram)
        assert parser.pending_bytes <= MAX_FRAME_BYTES

    assert parser.feed(encode(TAG))[-1] == TAG


@given(noise)
def test_every_torn_telegram_is_counted_by_reason(data: bytes) -> None:
    parser = TelegramParser()

    torn = [item.reason for item in parser.feed(data) if isinstance(item, TornTelegram)]

    assert sorted(parser.torn.elements(), key=str) == sorted(torn, key=str)


def test_a_line_without_flags_does_not_fill_the_memory() -> None:
    parser = TelegramParser()
    for _ in range(1000):
        assert parser.feed(b"x" * 1000) == []

    assert parser.pending_bytes == MAX_FRAME_BYTES
    (torn,) = parser.feed(b"\x7e")
    assert isinstance(torn, TornTelegram)
    assert torn.reason is TornReason.TOO_LONG
    assert len(torn.data) == MAX_FRAME_BYTES
    assert parser.feed(encode(TAG)) == [TAG]


@pytest.mark.parametrize("length", [0, 1, MAX_PAYLOAD_BYTES - 1, MAX_PAYLOAD_BYTES])
@pytest.mark.parametrize("byte", [b"\x00", b"\x7d", b"\x7e", b"\xff"])
def test_payloads_of_every_length_are_read_back(length: int, byte: bytes) -> None:
    balise = replace(BALISE, payload=byte * length)

    assert len(encode(balise)) <= MAX_FRAME_BYTES
    assert heard(encode(balise)) == [balise]


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", TornReason.TOO_SHORT),
        (b"\x01\x02", TornReason.TOO_SHORT),
        (b"\x02" + health_content(HEALTH)[1:], TornReason.UNKNOWN_VERSION),
        (b"\x01\x03" + health_content(HEALTH)[2:], TornReason.UNKNOWN_TYPE),
        (b"\x01\x02\x00", TornReason.WRONG_LENGTH),
        (b"\x01\x01\x00" + bytes(17), TornReason.WRONG_LENGTH),
        (health_content(HEALTH) + b"\x00", TornReason.WRONG_LENGTH),
        (health_content(HEALTH)[:-1], TornReason.WRONG_LENGTH),
        (tag_content(TAG) + b"\x00", TornReason.WRONG_LENGTH),
        (tag_content(BALISE)[:-1], TornReason.WRONG_LENGTH),
        (tag_content(replace(TAG, tag_id=0)), TornReason.INVALID_VALUE),
        (b"\x01\x01\x00\x00" + tag_content(TAG)[4:], TornReason.INVALID_VALUE),
        (b"\x01\x01\x00\x06" + tag_content(TAG)[4:], TornReason.INVALID_VALUE),
        (b"\x01\x02\x00\x02" + health_content(HEALTH)[4:], TornReason.INVALID_VALUE),
        (tag_content(replace(TAG, payload=bytes(105))), TornReason.TOO_LONG),
        (b"\x01\x02" + bytes(400), TornReason.TOO_LONG),
    ],
)
def test_a_correct_frame_with_invalid_content_is_torn(content: bytes, reason: TornReason) -> None:
    (torn,) = heard(on_the_wire(content))

    assert isinstance(torn, TornTelegram)
    assert torn.reason is reason


@pytest.mark.parametrize("tail", [b"\x7d", b"\x7dA", b"\x7d\x7d"])
def test_an_invalid_escape_is_torn(tail: bytes) -> None:
    (torn,) = heard(b"\x7e" + encode(TAG)[1:-1] + tail + b"\x7e")

    assert torn == TornTelegram(TornReason.BROKEN_ESCAPE, encode(TAG)[1:-1] + tail)


def test_a_wrong_crc_is_torn() -> None:
    broken = encode(TAG)[:-2] + bytes([encode(TAG)[-2] ^ 1]) + b"\x7e"

    (torn,) = heard(broken)

    assert isinstance(torn, TornTelegram)
    assert torn.reason is TornReason.WRONG_CRC


def numbered(*sequences: int) -> tuple[TelegramParser, list[Heard]]:
    """Health telegrams that differ in more than their sequence number."""
    parser = TelegramParser()
    stream = (replace(HEALTH, sequence=s, uptime_s=at) for at, s in enumerate(sequences))
    return parser, [item for telegram in stream for item in parser.feed(encode(telegram))]


def test_a_repeated_sequence_is_not_delivered_twice() -> None:
    parser, items = numbered(3, 3, 4)

    assert [type(item) for item in items] == [HealthTelegram, DuplicateTelegram, HealthTelegram]
    assert (parser.duplicates, parser.lost, parser.healths) == (1, 0, 2)


def test_a_replayed_old_telegram_is_not_delivered() -> None:
    parser = TelegramParser()
    frames = [encode(replace(TAG, sequence=s, pulses=s)) for s in range(5)]

    items = parser.feed(b"".join(frames) + frames[2])

    assert isinstance(items[-1], DuplicateTelegram)
    assert (parser.duplicates, parser.lost, parser.jumps, parser.tags) == (1, 0, 0, 5)


@pytest.mark.parametrize(
    ("sequences", "gaps"),
    [
        ((), 0),
        ((7,), 1),  # Telegrams before the first one may be missing.
        ((7, 8, 9), 1),
        ((254, 255, 0, 1), 1),
        ((7, 9), 2),
        ((7, 9, 10, 13), 3),
        ((0, 128), 2),
        ((100, 0, 1), 2),
        ((3, 3, 4), 2),  # Two telegrams differ; one of them is not delivered.
    ],
)
def test_each_place_where_a_telegram_may_be_missing_is_counted(
    sequences: tuple[int, ...], gaps: int
) -> None:
    assert numbered(*sequences)[0].gaps == gaps


def test_a_repeated_telegram_leaves_no_gap_and_a_torn_one_does() -> None:
    parser, frames = TelegramParser(), [encode(replace(TAG, sequence=s)) for s in range(9)]
    parser.feed(b"".join([*frames[:5], frames[2], frames[4]]))
    assert (parser.gaps, parser.duplicates) == (1, 2)
    parser.feed(frames[5])
    assert parser.gaps == 1

    parser.feed(frames[6][:7] + frames[6][8:])
    assert parser.gaps == 1, "until the next one shows what it was"
    parser.feed(frames[7])
    assert parser.gaps == 2


@pytest.mark.parametrize(
    ("sequences", "lost", "jumps"),
    [
        ((254, 255, 0, 1), 0, 0),
        ((0, 2), 1, 0),
        ((250, 3), 8, 0),
        ((0, 127), 126, 0),
        ((0, 128), 0, 1),
        ((200, 0), 55, 0),
        ((100, 0), 0, 1),
    ],
)
def test_gaps_in_the_sequence_are_counted(
    sequences: tuple[int, ...], lost: int, jumps: int
) -> None:
    parser, items = numbered(*sequences)

    assert all(isinstance(item, HealthTelegram) for item in items)
    assert (parser.lost, parser.jumps) == (lost, jumps)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"sequence": 256}, "sequence: 256 is not in 0..255"),
        ({"sequence": -1}, "sequence: -1"),
        ({"tag_id": 0}, "tag_id: 0"),
        ({"tag_id": 2**32}, "tag_id: 4294967296"),
        ({"pulses": 65536}, "pulses: 65536 is not in 0..65535"),
        ({"stamp_ms": float("nan")}, "stamp_ms: nan"),
        ({"sent_ms": float("inf")}, "sent_ms: inf"),
        ({"payload": bytes(105)}, "payload: 105 bytes, 104 at most"),
    ],
)
def test_values_that_no_frame_can_hold_are_refused_by_name(
    change: dict[str, object], words: str
) -> None:
    with pytest.raises(ValueError, match=words):
        encode(replace(TAG, **change))  # type: ignore[arg-type]


def test_a_wrap_of_the_reader_clock_causes_no_step_in_the_age() -> None:
    (tag,) = heard(
        encode(replace(TAG, stamp_ms=CLOCK_PERIOD_MS - 2.0, sent_ms=CLOCK_PERIOD_MS + 5))
    )

    assert isinstance(tag, TagTelegram)
    assert tag.sent_ms == 5.0
    assert tag.age_at_sending_s == pytest.approx(0.007)


def test_every_kind_of_tag_has_a_code() -> None:
    assert sorted(KIND_CODES.values()) == [1, 2, 3, 4, 5]
    assert set(KIND_CODES) == set(TagKind)
