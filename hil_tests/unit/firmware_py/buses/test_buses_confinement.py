"""Error counters and the bus time of destroyed frames, against frames worked out by hand."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.buses import confinement
from firmware_py.buses.confinement import ErrorCounters, ErrorState, Receiver, wire_frame
from firmware_py.buses.timing import frame_bits

FLAG = 6
DELIMITER_AND_GAP = 11
FOUR = b"\xaa" * 4


def test_thirty_two_failures_take_a_sender_off_the_bus_and_sixteen_make_it_passive() -> None:
    counters = ErrorCounters()
    states = []
    for _ in range(32):
        counters.sending_failed()
        states.append(counters.state)

    assert states == [ErrorState.ACTIVE] * 15 + [ErrorState.PASSIVE] * 16 + [ErrorState.OFF]
    assert counters.tec == 256


def test_a_sender_without_receivers_becomes_passive_but_stays_on_the_bus() -> None:
    counters = ErrorCounters()
    for _ in range(1000):
        counters.nobody_acknowledged()

    assert (counters.tec, counters.state) == (128, ErrorState.PASSIVE)


def test_eight_good_frames_compensate_for_one_destroyed_frame() -> None:
    counters = ErrorCounters()
    counters.sending_failed()
    for _ in range(7):
        counters.sent()
    assert counters.tec == 1
    counters.sent()
    counters.sent()

    assert counters.tec == 0


def test_a_passive_receiver_is_active_again_after_one_good_frame() -> None:
    counters = ErrorCounters()
    for _ in range(127):
        counters.hearing_failed()
    assert counters.state is ErrorState.ACTIVE
    counters.hearing_failed()
    assert counters.state is ErrorState.PASSIVE
    counters.hearing_failed()

    counters.heard()

    assert 119 <= counters.rec <= 127
    assert counters.state is ErrorState.ACTIVE


@given(can_id=st.integers(0, 0x7FF), data=st.binary(max_size=8))
def test_the_frame_bit_by_bit_has_the_length_from_the_tables(can_id: int, data: bytes) -> None:
    frame = wire_frame(can_id, data)
    receiver = Receiver(len(data))

    assert len(frame.bits) + 3 == frame_bits(can_id, data)
    assert not any(receiver.sees_error(bit) for bit in frame.bits)
    runs = [len(list(run)) for _, run in itertools.groupby(frame.bits[: frame.last + 1])]
    assert max(runs) <= 5


def test_a_known_frame_has_its_known_bits() -> None:
    """Identifier and data alternate, so no bit is stuffed before the CRC."""
    frame = wire_frame(0x555, FOUR)

    text = "".join(map(str, frame.bits))
    assert text.startswith("0" + "10101010101" + "0" + "0" + "0" + "0100" + "10101010")
    assert frame.first == 19
    assert text.endswith("1" + "0" + "1" + "1111111")


# Frame 0x555#AAAAAAAA: the length is 0100 and the data 1010... begins at bit 19. Dominant bits
# follow the wrong bit.
@pytest.mark.parametrize(
    ("bit", "flag_bits"),
    [
        # Bit 19 becomes 0 after the two 0 of the length: three in a row. The third bit of the flag
        # is the sixth, and the six bits of the receivers follow: 3 + 6.
        (19, 9),
        # Bit 20 becomes 1, so the dominant run begins with the flag: all six bits, then six more.
        (20, 12),
        # Bit 21 becomes 0 after the 0 of bit 20: two in a row, four more, then six.
        (21, 10),
        (22, 12),
        (23, 10),
    ],
)
def test_the_overlap_of_error_flags_follows_from_the_stuffing(bit: int, flag_bits: int) -> None:
    frame = wire_frame(0x555, FOUR)

    bits = confinement.destroyed_bits(frame, bit, sender_passive=False, hearers_active=True)

    assert bits == bit + 1 + flag_bits + DELIMITER_AND_GAP


def test_all_nodes_detect_a_wrong_stuff_bit_at_once() -> None:
    """A stuff bit follows five recessive data bits; inverted it is the sixth."""
    frame = wire_frame(0x555, b"\xff" * 4)
    stuff_bit = frame.first + 5
    assert frame.bits[stuff_bit - 5 : stuff_bit + 1] == (1, 1, 1, 1, 1, 0)

    for passive in (False, True):
        bits = confinement.destroyed_bits(
            frame, stuff_bit, sender_passive=passive, hearers_active=True
        )
        assert bits == stuff_bit + 1 + FLAG + DELIMITER_AND_GAP


def test_a_passive_sender_among_passive_receivers_leaves_the_wire_recessive() -> None:
    frame = wire_frame(0x555, FOUR)

    bits = confinement.destroyed_bits(frame, 20, sender_passive=True, hearers_active=False)

    assert bits == 20 + 1 + FLAG + DELIMITER_AND_GAP


def test_the_recessive_flag_of_a_passive_sender_is_answered_by_dominant_ones() -> None:
    """Bit 20 becomes recessive after the recessive bit 19: four more make six, then six follow."""
    frame = wire_frame(0x555, FOUR)

    bits = confinement.destroyed_bits(frame, 20, sender_passive=True, hearers_active=True)

    assert bits == 20 + 1 + 4 + FLAG + DELIMITER_AND_GAP


@given(
    can_id=st.integers(0, 0x7FF),
    data=st.binary(max_size=8),
    place_ratio=st.floats(0.0, 1.0),
    passive=st.booleans(),
)
def test_every_wrong_bit_is_detected_within_the_limit_of_the_standard(
    can_id: int, data: bytes, place_ratio: float, passive: bool
) -> None:
    frame = wire_frame(can_id, data)
    at_bit = frame.first + round(place_ratio * (frame.last - frame.first))

    bits = confinement.destroyed_bits(frame, at_bit, sender_passive=passive, hearers_active=True)

    flags = bits - at_bit - 1 - DELIMITER_AND_GAP
    assert FLAG <= flags <= 2 * FLAG or (passive and frame.last - at_bit < 6)


def test_an_unacknowledged_frame_ends_with_one_flag() -> None:
    """The frame has 79 bits with intermission and no stuff bit: 19, 32 and 15, delimiter and
    slot, then 6, 8 and 3."""
    can_id = next(can_id for can_id in range(0x800) if frame_bits(can_id, FOUR) == 47 + 32)

    assert confinement.unacknowledged_bits(frame_bits(can_id, FOUR)) == 66 + 2 + 6 + 8 + 3
