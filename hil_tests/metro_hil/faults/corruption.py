"""Corrupts payloads: either so that the codec's CRC shows it, or so that no check does."""

import dataclasses
import enum
from binascii import crc_hqx
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from can_dbc.agreement import FieldLayout, payload_bytes
from can_dbc.binding import Binding, Frame, MessageProtection
from can_dbc.packing import packer, unpacker
from can_dbc.trailer import crc_of_data_id, opener
from metro_hil.model.frame_names import KnownMessage, known_messages
from plant_emulator.faults.acting import flipped

TRIES: Final = 100


def spoiled(can_id: int, data: bytes, bits: int, draws: np.random.Generator) -> bytes:
    """Invert bits anywhere in the data; if the frame has a CRC, it no longer fits.

    A frame without a CRC is changed as well, and no check can detect it.
    """
    known = known_messages().get(can_id)
    if known is None or known.bound.protection is MessageProtection.NONE or not data:
        return flipped(data, bits, draws) if data else data
    opened = opener(_message(known))
    for _ in range(TRIES):
        wrong = flipped(data, bits, draws)
        if opened(wrong) < 0:
            return wrong
    # With all bits of a short frame inverted there is only one result, and its CRC may fit.
    return flipped(data, 1, draws)


class Forger:
    """Changes values as in the sender's memory, so that counter, CRC and twin fit."""

    def __init__(self, bits: int, draws: np.random.Generator) -> None:
        self._bits, self._draws = bits, draws
        self._pairs: dict[int, tuple[int, int]] = {}
        """Alive counter and inverted bits of the last first half, by its identifier."""

    def forged(self, can_id: int, data: bytes, *, strike: bool) -> bytes | None:
        """Return the frame with another value that passes every check; None if it stays unchanged.

        `strike` decides for a whole pair when its first half arrives; the second half follows the
        first.
        """
        known = known_messages().get(can_id)
        if known is None or len(data) != _message(known).length:
            return None
        bound = known.bound
        size = payload_bytes(bound.message)
        word = int.from_bytes(data[:size], "little")
        counter = data[size] if bound.protection is not MessageProtection.NONE else 0
        if known.is_twin:
            first = self._pairs.get(bound.message.frame_id)
            if first is None or first[0] != counter:
                return None
            return sealed(known, word ^ first[1], counter)
        self._pairs.pop(can_id, None)
        flips = self._flips(bound, word) if strike else 0
        if not flips:
            return None
        self._pairs[can_id] = (counter, flips)
        return sealed(known, word ^ flips, counter)

    def _flips(self, bound: Binding, word: int) -> int:
        """Return bits whose inversion gives another valid frame; 0 if none were found."""
        read = unpacker(bound.kind)
        genuine = read(word)
        places = [place for each in bound.fields for place in _places(each)]
        for attempt in range(TRIES):
            if attempt < TRIES // 2:
                count = min(self._bits, len(places))
                chosen = self._draws.choice(len(places), size=count, replace=False)
                flips = sum(1 << places[int(index)] for index in chosen)
            else:
                # Two-bit booleans and value tables may not permit this number of bits, so change
                # one signal.
                field = bound.fields[int(self._draws.integers(len(bound.fields)))]
                flips = int(self._draws.integers(1, 1 << field.length)) << field.start
            forged = read(word ^ flips)
            if forged is not None and forged != genuine:
                return flips
        return 0


def masked(
    bound: Binding, genuine: bytes, values: Mapping[str, float], counter: int, twins: bool
) -> tuple[tuple[int, bytes], ...]:
    """Return a frame with the genuine values except for `values`, sealed with this counter.

    Return nothing if the genuine frame cannot be read.
    """
    size = payload_bytes(bound.message)
    known, word = known_messages()[bound.message.frame_id], int.from_bytes(genuine[:size], "little")
    frame = unpacker(bound.kind)(word)
    if frame is None or len(genuine) != bound.message.length:
        return ()
    fields = {field.name: field for field in bound.fields}
    told = {name: _value(fields[name], value) for name, value in values.items()}
    word = packer(bound.kind)(_replaced(frame, told))
    first = (known.can_id, sealed(known, word, counter))
    if bound.twin is None or not twins:
        return (first,)
    twin = known_messages()[bound.twin.frame_id]
    inverted = word ^ ((1 << 8 * size) - 1)
    return first, (twin.can_id, sealed(twin, inverted, counter))


def alive_counter(bound: Binding, data: bytes) -> int:
    """Return the alive counter of a protected frame; 0 for other frames."""
    size = payload_bytes(bound.message)
    return data[size] if bound.protection is not MessageProtection.NONE and len(data) > size else 0


def sealed(known: KnownMessage, word: int, counter: int) -> bytes:
    """Return the payload bits with the trailer, if the message has one."""
    size = payload_bytes(known.bound.message)
    body = word.to_bytes(size, "little")
    if known.bound.protection is MessageProtection.NONE:
        return body
    body += bytes([counter])
    crc = crc_hqx(body, crc_of_data_id(_message(known)))
    return body + crc.to_bytes(2, "little")


def _message(known: KnownMessage) -> Any:
    bound = known.bound
    return bound.twin if known.is_twin else bound.message


def _places(field: FieldLayout) -> range:
    return range(field.start, field.start + field.length)


def _value(field: FieldLayout, value: float) -> object:
    if field.kind is bool:
        return bool(value)
    if issubclass(field.kind, enum.Enum):
        return field.kind(int(value))
    return int(value) if field.kind is int else float(value)


def _replaced(frame: Frame, told: Mapping[str, Any]) -> Frame:
    changed: Frame = dataclasses.replace(frame, **told)
    return changed
