"""Exhaustive corruption of protected frames as on a disturbed bus: no corrupted frame is
accepted."""

import dataclasses
import itertools
import random
from collections.abc import Iterator
from typing import Any

import pytest
from crccheck.crc import Crc16CcittFalse
from hypothesis import assume, given
from hypothesis import strategies as st

from can_dbc import binding
from can_dbc.brake import BrakeCommand
from can_dbc.codec import Decoder, Encoder, Reason, Rejected
from can_dbc.doors import DoorCommand
from can_dbc.nodes import Direction
from can_dbc.traction import TractionCommand
from hil_tests.parsed_by_cantools import data_id_of, message_of

PROTECTED = [kind for kind in binding.kinds() if "crc16" in message_of(kind).signal_tree]
SINGLE = [kind for kind in PROTECTED if not binding.is_vital(kind)]
VITAL = [kind for kind in PROTECTED if binding.is_vital(kind)]

RESTRICTIVE: list[Any] = [
    BrakeCommand(service_decel_mps2=2.0, emergency_released=False, holding_released=False),
    TractionCommand(force_n=0.0, direction=Direction.NEUTRAL, traction_permitted=False),
    DoorCommand(enable_left=False, enable_right=False, open_left=False, open_right=False),
]
PERMISSIVE: list[Any] = [
    BrakeCommand(service_decel_mps2=0.0, emergency_released=True, holding_released=True),
    TractionCommand(force_n=4e5, direction=Direction.FORWARD, traction_permitted=True),
    DoorCommand(enable_left=True, enable_right=True, open_left=True, open_right=True),
]

Sent = tuple[tuple[int, bytes], ...]


def some_frames(kind: type[Any], count: int) -> Iterator[Any]:
    """Valid frames with arbitrary bits, not limited to the ranges of their DBC file."""
    bits = random.Random(kind.__name__)
    for _ in range(count):
        values: dict[str, Any] = {}
        for field in binding.binding_of(kind).fields:
            if field.kind is bool:
                values[field.name] = bits.random() < 0.5
            elif field.kind is float:
                values[field.name] = bits.uniform(field.minimum, field.maximum)
            elif field.kind is int:
                values[field.name] = bits.randint(field.raw_minimum, field.raw_maximum)
            else:
                values[field.name] = bits.choice(list(field.kind.__members__.values()))
        yield kind(**values)


def flipped(data: bytes, *bits: int) -> bytes:
    word = int.from_bytes(data, "little")
    for bit in bits:
        word ^= 1 << bit
    return word.to_bytes(len(data), "little")


def in_step(kind: type[Any]) -> tuple[Encoder, Decoder]:
    """An encoder and a decoder that have exchanged one frame, so that the counter is known."""
    encoder, decoder = Encoder(), Decoder([kind])
    heard = receive(decoder, encoder.encode(next(some_frames(kind, 1))))
    assert isinstance(heard[-1], kind)
    return encoder, decoder


def receive(decoder: Decoder, sent: Sent, heard_ns: int = 0) -> list[Any]:
    return [decoder.decode(can_id, data, heard_ns) for can_id, data in sent]


def refused(heard: list[Any]) -> bool:
    return all(each is None or isinstance(each, Rejected) for each in heard)


def replaced(sent: Sent, half: int, data: bytes) -> Sent:
    return tuple((can_id, data if index == half else old)
                 for index, (can_id, old) in enumerate(sent))  # fmt: skip


@pytest.mark.parametrize("kind", SINGLE)
def test_every_flip_of_up_to_three_bits_breaks_the_crc(kind: type[Any]) -> None:
    """The polynomial guarantees a Hamming distance of 4; every combination of 1, 2 and 3 bits
    checks it."""
    encoder, decoder = in_step(kind)
    ((can_id, data),) = encoder.encode(next(some_frames(kind, 1)))
    bits = range(8 * len(data))

    for count in (1, 2, 3):
        for combination in itertools.combinations(bits, count):
            heard = decoder.decode(can_id, flipped(data, *combination), 0)

            assert isinstance(heard, Rejected), combination
            assert heard.reason is Reason.WRONG_CRC
    assert isinstance(decoder.decode(can_id, data, 0), kind)


@pytest.mark.parametrize("kind", SINGLE)
def test_every_corruption_of_one_byte_breaks_the_crc(kind: type[Any]) -> None:
    encoder, decoder = in_step(kind)
    for frame in some_frames(kind, 3):
        ((can_id, data),) = encoder.encode(frame)

        for place, mask in itertools.product(range(len(data)), range(1, 256)):
            broken = bytearray(data)
            broken[place] ^= mask
            heard = decoder.decode(can_id, bytes(broken), 0)

            assert isinstance(heard, Rejected)
            assert heard.reason is Reason.WRONG_CRC
        assert isinstance(decoder.decode(can_id, data, 0), kind)


@pytest.mark.parametrize("frame", [*RESTRICTIVE, *PERMISSIVE])
def test_no_flip_of_up_to_two_bits_in_either_half_gives_a_command(frame: Any) -> None:
    kind = type(frame)
    half_bits = 8 * binding.message(kind).length

    for half, count in itertools.product((0, 1), (1, 2)):
        for combination in itertools.combinations(range(half_bits), count):
            encoder, decoder = in_step(kind)
            sent = encoder.encode(frame)

            heard = receive(decoder, replaced(sent, half, flipped(sent[half][1], *combination)))

            assert refused(heard), (half, combination)


@pytest.mark.parametrize("frame", [*RESTRICTIVE, *PERMISSIVE])
def test_no_corruption_of_one_byte_in_either_half_gives_a_command(frame: Any) -> None:
    kind = type(frame)

    for half, place in itertools.product((0, 1), range(binding.message(kind).length)):
        for mask in range(1, 256):
            encoder, decoder = in_step(kind)
            sent = encoder.encode(frame)
            broken = bytearray(sent[half][1])
            broken[place] ^= mask

            assert refused(receive(decoder, replaced(sent, half, bytes(broken))))


@pytest.mark.parametrize("frame", RESTRICTIVE)
@given(data=st.data())
def test_a_restrictive_pair_stays_restrictive_whatever_one_half_becomes(
    frame: Any, data: st.DataObject
) -> None:
    encoder, decoder = in_step(type(frame))
    sent = encoder.encode(frame)
    half = data.draw(st.sampled_from((0, 1)))
    broken = data.draw(st.binary(max_size=8))
    assume(broken != sent[half][1])

    assert refused(receive(decoder, replaced(sent, half, broken)))


@pytest.mark.parametrize("frame", RESTRICTIVE)
def test_a_forged_half_with_a_correct_crc_needs_its_twin(frame: Any) -> None:
    """One half of a permissive command, correct in every respect, is placed inside a restrictive
    pair."""
    kind = type(frame)
    permissive = next(each for each in PERMISSIVE if type(each) is kind)
    for half in (0, 1):
        encoder, decoder = in_step(kind)
        forger, _ = in_step(kind)
        sent, forged = encoder.encode(frame), forger.encode(permissive)

        heard = receive(decoder, replaced(sent, half, forged[half][1]))

        assert refused(heard)
        assert decoder.rejections == {(sent[1][0], Reason.TWIN_MISMATCH): 1}


@pytest.mark.parametrize("kind", PROTECTED)
def test_a_replayed_frame_is_refused(kind: type[Any]) -> None:
    """Any frame of the last 253 is refused; beyond that, an eight-bit counter cannot tell old
    from new."""
    for age in range(1, 254):
        encoder, decoder = in_step(kind)
        sent = [encoder.encode(frame) for frame in [next(some_frames(kind, 1))] * age]
        assert not any(refused(receive(decoder, each)) for each in sent)

        assert refused(receive(decoder, sent[0])), age


@pytest.mark.parametrize("kind", PROTECTED)
def test_a_recording_replayed_beside_the_live_sender_is_refused(kind: type[Any]) -> None:
    """The sender's frames keep counting on, and only they are accepted."""
    encoder, decoder = in_step(kind)
    recording = [encoder.encode(frame) for frame in some_frames(kind, 20)]
    for each in recording:
        receive(decoder, each)

    for old, frame in zip(recording, some_frames(kind, 20), strict=True):
        assert refused(receive(decoder, old))
        assert not refused(receive(decoder, encoder.encode(frame)))


@pytest.mark.parametrize("kind", PROTECTED)
def test_frames_in_the_wrong_order_never_give_an_old_value(kind: type[Any]) -> None:
    """The second of four frames arrives last and must not override the third and the fourth."""
    encoder, decoder = in_step(kind)
    first, late, third, fourth = (encoder.encode(frame) for frame in some_frames(kind, 4))

    assert not refused(receive(decoder, first))
    assert not refused(receive(decoder, third))
    assert not refused(receive(decoder, fourth))
    assert refused(receive(decoder, late))


@pytest.mark.parametrize(
    ("sender", "victim"),
    [(a, b) for a, b in itertools.permutations(PROTECTED, 2)
     if binding.message(a).length == binding.message(b).length],
)  # fmt: skip
def test_a_frame_under_the_identifier_of_another_is_refused(
    sender: type[Any], victim: type[Any]
) -> None:
    """The data id distinguishes two messages of equal length."""
    decoder = Decoder([victim])
    for (_, data), message in zip(
        Encoder().encode(next(some_frames(sender, 1))),
        binding.binding_of(victim).messages,
        strict=False,
    ):
        heard = decoder.decode(message.frame_id, data, 0)

        assert isinstance(heard, Rejected)
        assert heard.reason is Reason.WRONG_CRC


@pytest.mark.parametrize("kind", VITAL)
def test_swapped_halves_of_a_pair_are_refused(kind: type[Any]) -> None:
    """A first half is sent under the identifier of the twin, and the other way round."""
    (first_id, first), (twin_id, second) = Encoder().encode(next(some_frames(kind, 1)))
    decoder = Decoder([kind])

    assert refused(receive(decoder, ((first_id, second), (twin_id, first))))
    assert {reason for _, reason in decoder.rejections} == {Reason.WRONG_CRC}


@pytest.mark.parametrize("kind", binding.kinds())
@pytest.mark.parametrize("length", range(9))
def test_a_wrong_length_is_refused(kind: type[Any], length: int) -> None:
    for message in binding.binding_of(kind).messages:
        if length != message.length:
            heard = Decoder([kind]).decode(message.frame_id, bytes(length), 0)

            assert isinstance(heard, Rejected)
            assert heard.reason is Reason.WRONG_LENGTH
            assert message.name in heard.detail


@pytest.mark.parametrize("kind", PROTECTED)
def test_a_truncated_frame_with_a_fitting_crc_is_refused_for_its_length(kind: type[Any]) -> None:
    """The bytes end where the CRC should begin and make the CRC 0, as missing bits are read."""
    for message in binding.binding_of(kind).messages:
        data_id = data_id_of(message.name)
        body = bytes(message.length - 4)
        cut = body + int(Crc16CcittFalse.calc(data_id + body)).to_bytes(2, "big")
        assert Crc16CcittFalse.calc(data_id + cut) == 0

        heard = Decoder([kind]).decode(message.frame_id, cut, 0)

        assert isinstance(heard, Rejected)
        assert heard.reason is Reason.WRONG_LENGTH


def test_the_samples_differ_in_every_value() -> None:
    """Otherwise the tests above could compare a command with itself."""
    for restrictive, permissive in zip(RESTRICTIVE, PERMISSIVE, strict=True):
        for field in dataclasses.fields(restrictive):
            assert getattr(restrictive, field.name) != getattr(permissive, field.name)
