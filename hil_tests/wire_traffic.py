"""Frames with usual and unusual values, and traffic with every kind of damage."""

import math
import random
from binascii import crc_hqx
from collections.abc import Iterator
from typing import Any

from can_dbc import binding
from can_dbc.codec import Encoder
from can_dbc.trailer import crc_of_data_id

MS = 1_000_000
STEPS = 400


def sampled_value(field: Any, bits: random.Random) -> Any:
    """Return a value in, at or beyond the range of the field, or between two steps of it."""
    if field.kind is bool:
        return bits.random() < 0.5
    if field.kind is int:
        low, high = field.raw_minimum, field.raw_maximum
        return bits.choice([low, high, low - 1, high + 1, bits.randint(low, high)])
    if field.kind is float:
        span = field.maximum - field.minimum
        half = (bits.randint(field.raw_minimum, field.raw_maximum) + 0.5) * field.scale
        inside = bits.uniform(field.minimum, field.maximum)
        ends = (field.minimum, field.maximum, field.minimum - span, math.inf, -math.inf, -0.0)
        return bits.choice([inside, half + field.offset, round(inside), *ends])
    return bits.choice(list(field.kind))


def sampled_frame(kind: type[Any], bits: random.Random) -> Any:
    fields = binding.binding_of(kind).fields
    return kind(**{field.name: sampled_value(field, bits) for field in fields})


def damaged(
    kind: type[Any], bits: random.Random, steps: int = STEPS
) -> Iterator[tuple[int, bytes, int]]:
    """Traffic of one kind with every damage: identifier, data and instant.

    Frames are lost, repeated, replayed late, cut, extended, changed in up to three bits, swapped
    with their twin, or carry values that no sender sends, with a good counter and CRC.
    """
    encoder, bound = Encoder([kind]), binding.binding_of(kind)
    ids = [message.frame_id for message in bound.messages]
    past: list[tuple[int, bytes]] = []
    now_ns = 0
    for _ in range(steps):
        now_ns += round(1e6 * bits.choice([0, 1, 19.999999, 20, 20.000001, 50, 300, 5000]))
        sent = list(encoder.encode(sampled_frame(kind, bits)))
        past += sent
        damage = bits.randrange(12)
        if damage == 0:
            del sent[bits.randrange(len(sent))]
        elif damage == 1:
            sent += sent
        elif damage == 2:
            sent.append(bits.choice(past))
        elif damage == 3:
            sent.reverse()
        elif damage == 4:
            sent = [(can_id, data[: bits.randrange(len(data) + 1)]) for can_id, data in sent]
        elif damage == 5:
            sent = [(can_id, data + b"\x00") for can_id, data in sent]
        elif damage == 6:
            sent = [(bits.choice(ids), flipped(data, bits)) for _, data in sent]
        elif damage == 7:
            sent = forged(bound, bits)
        for _ in range(bits.choice([0, 0, 0, 1, 2, 3, 4, 127, 255])):
            encoder.encode(sampled_frame(kind, bits))
        for can_id, data in sent:
            yield can_id, data, now_ns
            now_ns += bits.choice([0, 0, 300_000, 21 * MS])


def flipped(data: bytes, bits: random.Random) -> bytes:
    word = int.from_bytes(data, "little")
    for _ in range(bits.randint(1, 3)):
        word ^= 1 << bits.randrange(8 * len(data))
    return word.to_bytes(len(data), "little")


def forged(bound: Any, bits: random.Random) -> list[tuple[int, bytes]]:
    """Frames with any payload and counter, under a good CRC and with an inverted twin."""
    if bound.protection is binding.MessageProtection.NONE:
        return [(bound.message.frame_id, bits.randbytes(bound.message.length))]
    payload = bits.randbytes(bound.message.length - 3)
    inverted = bytes(0xFF - byte for byte in payload)
    counter = bits.randbytes(1)
    found = []
    for message, body in zip(bound.messages, (payload, inverted), strict=False):
        crc = crc_hqx(body + counter, crc_of_data_id(message))
        found.append((message.frame_id, body + counter + crc.to_bytes(2, "little")))
    return found
