"""The length of a frame, against an oracle that writes the frame bit by bit."""

import pytest
from crccheck.crc import Crc15
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.buses.timing import LONGEST_FRAME_BITS, frame_bits

STANDARD_IDS = st.integers(0, 0x7FF)
EXTENDED_IDS = st.integers(0, 0x1FFF_FFFF)
# Stuffing depends on long runs, which random bytes seldom contain.
PAYLOADS = st.lists(
    st.one_of(st.integers(0, 255), st.sampled_from([0x00, 0xFF, 0x0F, 0xF0, 0x07, 0x83, 0xE1])),
    max_size=8,
).map(bytes)


def stuffed_part(can_id: int, data: bytes, *, extended: bool, remote: bool) -> str:
    """Start of frame to CRC as a string of zeros and ones, before stuffing."""
    rtr = "1" if remote else "0"
    control = f"{len(data):04b}"
    if extended:
        identifier = f"{can_id:029b}"
        head = "0" + identifier[:11] + "11" + identifier[11:] + rtr + "00" + control
    else:
        head = "0" + f"{can_id:011b}" + rtr + "00" + control
    body = head + ("" if remote else "".join(f"{byte:08b}" for byte in data))
    return body + f"{remainder_15(body):015b}"


def remainder_15(bits: str) -> int:
    """Remainder of the bits, followed by fifteen zeros, after division by the polynomial."""
    divisor = 0b1100010110011001
    left = int(bits + "0" * 15, 2)
    while left.bit_length() > 15:
        left ^= divisor << (left.bit_length() - 16)
    return left


def stuff(bits: str) -> str:
    sent = ""
    for bit in bits:
        sent += bit
        if sent.endswith("00000"):
            sent += "1"
        elif sent.endswith("11111"):
            sent += "0"
    return sent


def bits_by_hand(can_id: int, data: bytes, *, extended: bool = False, remote: bool = False) -> int:
    delimiters_and_end = "1" + "01" + "1111111" + "111"
    part = stuffed_part(can_id, data, extended=extended, remote=remote)
    return len(stuff(part)) + len(delimiters_and_end)


@given(can_id=STANDARD_IDS, data=PAYLOADS)
def test_a_standard_frame_has_the_length_of_the_oracle(can_id: int, data: bytes) -> None:
    assert frame_bits(can_id, data) == bits_by_hand(can_id, data)


@given(can_id=STANDARD_IDS, data=st.binary(min_size=8, max_size=8))
def test_a_full_standard_frame_has_the_length_of_the_oracle(can_id: int, data: bytes) -> None:
    assert frame_bits(can_id, data) == bits_by_hand(can_id, data)


@given(can_id=EXTENDED_IDS, data=PAYLOADS)
def test_an_extended_frame_has_the_length_of_the_oracle(can_id: int, data: bytes) -> None:
    assert frame_bits(can_id, data, extended=True) == bits_by_hand(can_id, data, extended=True)


@given(can_id=EXTENDED_IDS, data=PAYLOADS, extended=st.booleans())
def test_a_remote_frame_has_the_length_of_the_oracle(
    can_id: int, data: bytes, extended: bool
) -> None:
    can_id = can_id if extended else can_id & 0x7FF

    bits = frame_bits(can_id, data, extended=extended, remote=True)

    assert bits == bits_by_hand(can_id, data, extended=extended, remote=True)


@given(data=st.binary(max_size=40))
def test_the_oracles_crc_matches_a_library(data: bytes) -> None:
    """The oracle's own CRC is checked against a library with the published check value."""
    bits = "".join(f"{byte:08b}" for byte in data)

    assert remainder_15(bits or "0") == Crc15.calc(data)


def test_the_published_check_value_of_the_crc() -> None:
    digits = "".join(f"{byte:08b}" for byte in b"123456789")

    assert remainder_15(digits) == 0x059E


@pytest.mark.parametrize("length", range(9))
@pytest.mark.parametrize(("extended", "overhead", "stuffable"), [(False, 47, 34), (True, 67, 54)])
def test_no_frame_is_outside_the_published_bounds(
    length: int, extended: bool, overhead: int, stuffable: int
) -> None:
    """A frame has 47 or 67 bits plus data without stuffing; at most every fourth bit adds a
    stuff bit."""
    shortest = overhead + 8 * length
    longest = shortest + (stuffable + 8 * length - 1) // 4
    patterns = [bytes([byte]) * length for byte in range(256)]

    lengths = [frame_bits(can_id, data, extended) for can_id in range(64) for data in patterns]

    assert shortest <= min(lengths)
    assert max(lengths) <= longest <= LONGEST_FRAME_BITS


def test_a_frame_without_any_long_run_has_no_stuff_bit() -> None:
    """The bits alternate; the longest run is RTR, IDE, r0 and the first bit of the length."""
    part = stuffed_part(0x555, b"\x55\x55\x55\x08", extended=False, remote=False)
    assert "00000" not in part
    assert "11111" not in part

    assert frame_bits(0x555, b"\x55\x55\x55\x08") == 47 + 32


@pytest.mark.parametrize(
    ("can_id", "data", "extended"),
    [
        (0x800, b"", False),
        (-1, b"", False),
        (0x2000_0000, b"", True),
        (1, bytes(9), False),
        (1, bytes(17), False),
    ],
)
def test_data_that_no_classic_frame_can_hold_is_refused(
    can_id: int, data: bytes, extended: bool
) -> None:
    with pytest.raises(ValueError, match=f"frame {can_id:#x}"):
        frame_bits(can_id, data, extended)


def test_too_much_data_is_refused_even_with_a_cached_identifier() -> None:
    for length in range(9):
        for can_id in (0x10, 0x11, 0x12):
            frame_bits(can_id, bytes(length))

    for length in range(9, 40):
        with pytest.raises(ValueError, match="at most 8"):
            frame_bits(0x10, bytes(length))
