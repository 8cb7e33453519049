"""The binary form of the lockstep messages has the document's bytes and the content of JSON."""

import contextlib
import re
import struct
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_py.binary_grants import RECORD_BYTES_MAX, BinaryForm
from firmware_py.grants import Answer, GrantProtocolError, JsonForm, encode, yielded
from firmware_py.handed_ports import SentOutputs
from firmware_py.ports import CanFrame, RadioMessage, SerialChunk

DOCUMENT = Path(__file__).parents[3] / "docs/reference/lockstep_interface.md"
BINARY, JSON = BinaryForm(), JsonForm()
INSTANTS = st.integers(0, 2**62)
FRAMES = st.tuples(st.integers(0, 0x7FF), st.binary(max_size=8))
MESSAGES = st.tuples(st.sampled_from(["m/florence/w/1/st/1", "m/ü"]), st.binary(max_size=40))
OUTPUTS = st.builds(
    SentOutputs,
    st.lists(FRAMES, max_size=4).map(tuple),
    st.lists(st.binary(max_size=30), max_size=3).map(tuple),
    st.lists(MESSAGES, max_size=3).map(tuple),
)


def record_of(now_ns: int, next_ns: int, said: SentOutputs) -> bytes:
    """Write a yield by the tables of the document."""
    body = b"".join(struct.pack("<HB8s", each, len(data), data) for each, data in said.frames)
    body += b"".join(struct.pack("<I", len(data)) + data for data in said.serial)
    for key, data in said.radio:
        body += struct.pack("<HI", len(key.encode()), len(data)) + key.encode() + data
    counts = (len(said.frames), len(said.serial), len(said.radio))
    body = struct.pack("<BqqHHH", 3, now_ns, next_ns, *counts) + body
    return struct.pack("<I", len(body)) + body


def test_the_record_of_the_document_is_its_yield() -> None:
    (lines,) = re.findall(r"```text\n(2D [0-9A-F \n]+)```", DOCUMENT.read_text(encoding="utf-8"))

    answer = BINARY.answer(bytes.fromhex(lines))

    frames = ((257, bytes.fromhex("D057008766")), (258, bytes.fromhex("2FA800C944")))
    assert answer == Answer(50_000_000, 100_000_000, SentOutputs(frames))


@settings(max_examples=50)
@given(INSTANTS, INSTANTS, OUTPUTS)
def test_a_yield_means_the_same_in_both_forms(now_ns: int, next_ns: int, said: SentOutputs) -> None:
    binary, text = record_of(now_ns, next_ns, said), encode(yielded(now_ns, next_ns, said))

    assert BINARY.answer(binary) == JSON.answer(text) == Answer(now_ns, next_ns, said)
    assert BINARY.end(bytearray(binary)) == len(binary)
    assert BINARY.end(bytearray(binary[:-1])) == 0


@settings(max_examples=50)
@given(OUTPUTS, st.data())
def test_a_damaged_yield_is_refused_or_read_and_never_raises_otherwise(
    said: SentOutputs, data: st.DataObject
) -> None:
    record = bytearray(record_of(1, 2, said))
    at = data.draw(st.integers(4, len(record) - 1))
    if data.draw(st.booleans()):
        record[at] ^= data.draw(st.integers(1, 255))
        with contextlib.suppress(GrantProtocolError):
            assert isinstance(BINARY.answer(bytes(record)), Answer)
    else:
        with pytest.raises(GrantProtocolError):
            BINARY.answer(bytes(record[:at]))


@pytest.mark.parametrize(
    ("said", "text"),
    [
        (SentOutputs(frames=((0x800, b""),)), "identifier 2048"),
        (SentOutputs(radio=(("m/*", b""),)), "'m/\\*' is not a key"),
    ],
)
def test_an_output_that_no_link_can_carry_is_named(said: SentOutputs, text: str) -> None:
    with pytest.raises(GrantProtocolError, match=text):
        BINARY.answer(record_of(1, 2, said))


def test_a_frame_of_nine_bytes_and_a_record_that_is_too_long_are_named() -> None:
    record = bytearray(record_of(1, 2, SentOutputs(frames=((0x101, b""),))))
    record[-9] = 9

    with pytest.raises(GrantProtocolError, match="101 has 9 bytes"):
        BINARY.answer(bytes(record))
    with pytest.raises(GrantProtocolError, match="record of 1048581 bytes"):
        BINARY.end(bytearray(struct.pack("<I", RECORD_BYTES_MAX + 1)))


def test_a_grant_has_the_bytes_of_the_document_and_no_extended_frame() -> None:
    frames = [CanFrame(7, 0x185, b"\x01\x02"), CanFrame(8, 0x185, b"", extended=True)]

    record = BINARY.grant(9, frames, [SerialChunk(5, b"\x7e")], [RadioMessage(6, "k", b"ab")])

    body = struct.pack("<qHB8s", 7, 0x185, 2, b"\x01\x02")
    body += struct.pack("<qI", 5, 1) + b"\x7e" + struct.pack("<qHI", 6, 1, 2) + b"kab"
    head = struct.pack("<BqHHH", 1, 9, 1, 1, 1)
    assert record == struct.pack("<I", len(head + body)) + head + body
    assert BINARY.stop(9) == struct.pack("<IBq", 9, 2, 9)
