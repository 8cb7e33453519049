"""Decodes signals exactly, one signal for a whole column of frames at a time."""

from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt

from canlog import kernel
from canlog.database import MessageSpec, SignalSpec
from canlog.frames import Bools, Bytes

WORD_BITS: Final = 64
WORD_BYTES: Final = 8
LOOKUP_BITS_MAX: Final = 16
"""Maximum length of a multiplexer that uses a lookup table; longer ones are searched."""
_FLOATS: Final[dict[int, tuple[Any, Any]]] = {
    16: (np.uint16, np.float16),
    32: (np.uint32, np.float32),
    64: (np.uint64, np.float64),
}

Column = npt.NDArray[Any]
Raws = npt.NDArray[np.uint64]


class Payloads:
    """The data of frames, and the words from which signals are extracted, each made once."""

    def __init__(self, data: Bytes, length: "Bytes | npt.NDArray[np.uint16]") -> None:
        """Hold `data` (n, 8), (n, 64) or longer for multi-frame messages, and `length` (n,)."""
        self.data = np.ascontiguousarray(data)
        self.length = length
        self.shortest = int(length.min()) if len(length) else WORD_BYTES
        self._words: dict[tuple[int, bool], Raws] = {}

    def __len__(self) -> int:
        return len(self.data)

    @property
    def width(self) -> int:
        return int(self.data.shape[1])

    def word(self, first_byte: int, *, big_endian: bool) -> Raws:
        """(n,): eight bytes from `first_byte` on as one number, with zeros after the end of the
        data.
        """
        found = self._words.get((first_byte, big_endian))
        if found is None:
            found = self._words[first_byte, big_endian] = self._cut(first_byte, big_endian)
        return found

    def _cut(self, first_byte: int, big_endian: bool) -> Raws:
        order = ">u8" if big_endian else "<u8"
        if self.width == WORD_BYTES and first_byte == 0:
            return self.data.view(order)[:, 0].astype(np.uint64, copy=False)
        piece = np.zeros((len(self), WORD_BYTES), np.uint8)
        taken = self.data[:, first_byte : first_byte + WORD_BYTES]
        piece[:, : taken.shape[1]] = taken
        return piece.view(order)[:, 0].astype(np.uint64, copy=False)


@dataclass(frozen=True, slots=True)
class Cut:
    """Position of the bits of one signal."""

    spec: SignalSpec
    needed: int
    """Data bytes that a frame needs to carry the signal."""
    first_byte: int
    """First byte of the word that holds the signal, or of its first bit if one word is too
    short.
    """
    skipped: int
    """Bits before the signal in that word: from the low end, or the high end for Motorola."""


def cut_of(spec: SignalSpec) -> Cut:
    byte = spec.start // 8
    bit = 7 - spec.start % 8 if spec.big_endian else spec.start % 8
    needed = byte + (bit + spec.length - 1) // 8 + 1
    aligned = byte - byte % WORD_BYTES
    skipped = 8 * (byte - aligned) + bit
    if skipped + spec.length <= WORD_BITS:
        return Cut(spec, needed, aligned, skipped)
    return Cut(spec, needed, byte, bit)


def raw_of(cut: Cut, payloads: Payloads) -> Raws:
    """(n,) uint64: the bits of a signal without sign.

    For a signal of more than 64 bits, (n,) Python integers.
    """
    spec = cut.spec
    if spec.length > WORD_BITS:
        return _long_raw(spec, payloads)
    word = payloads.word(cut.first_byte, big_endian=spec.big_endian)
    over = cut.skipped + spec.length - WORD_BITS
    if over > 0:
        tail = payloads.word(cut.first_byte + WORD_BYTES, big_endian=spec.big_endian)
        if spec.big_endian:
            word = word << np.uint64(over) | tail >> np.uint64(WORD_BITS - over)
        else:
            word = word >> np.uint64(cut.skipped) | tail << np.uint64(WORD_BITS - cut.skipped)
    else:
        down = -over if spec.big_endian else cut.skipped
        word = word >> np.uint64(down) if down else word
    return word & np.uint64((1 << spec.length) - 1) if spec.length < WORD_BITS else word


def _long_raw(spec: SignalSpec, payloads: Payloads) -> Column:
    """Return (n,) Python integers."""
    rows = payloads.data.tobytes()
    width, mask = payloads.width, (1 << spec.length) - 1
    order: Literal["big", "little"] = "big" if spec.big_endian else "little"
    down = spec.start
    if spec.big_endian:
        down = 8 * width - (8 * (spec.start // 8) + 7 - spec.start % 8) - spec.length
    found = np.empty(len(payloads), object)
    for at in range(len(payloads)):
        whole = int.from_bytes(rows[at * width : (at + 1) * width], order)
        found[at] = (whole >> down if down >= 0 else whole << -down) & mask
    return found


def signed_raw(spec: SignalSpec, raw: Raws) -> Column:
    """Return (n,) int64 for a signed signal, or `raw` unchanged."""
    if not spec.signed:
        return raw
    if spec.length > WORD_BITS:
        half, whole = 1 << spec.length - 1, 1 << spec.length
        return np.where(raw >= half, raw - whole, raw) if len(raw) else raw
    up = WORD_BITS - spec.length
    signed: Column = (raw << np.uint64(up)).view(np.int64) >> np.int64(up)
    return signed


def physical_of(spec: SignalSpec, raw: Raws) -> Column:
    """Return (n,) raw * scale + offset.

    The result is an integer if scale and offset are integers: int64, or uint64 for values that need
    all 64 bits. It is float64 if the range of the signal fits neither. All other results are
    float64, rounded like Python's `raw * scale + offset`; products beyond 64 bits are rounded once
    more.
    """
    if spec.is_float:
        return _float_physical(spec, raw)
    if spec.length > WORD_BITS:
        return signed_raw(spec, raw) * spec.scale + spec.offset
    if float(spec.scale).is_integer():
        whole = float(spec.offset).is_integer()
        offset = int(spec.offset) if whole else 0
        kind = _integer_kind(spec, offset)
        if kind is not None:
            # Modulo 2**64 every step is exact, and the result is known to fit.
            value = signed_raw(spec, raw).view(np.uint64)
            if spec.scale != 1:
                value = value * np.uint64(int(spec.scale) % (1 << WORD_BITS))
            if offset:
                value = value + np.uint64(offset % (1 << WORD_BITS))
            return value.view(kind) if whole else value.view(kind) + np.float64(spec.offset)
    scaled: Column = signed_raw(spec, raw).astype(np.float64)
    scaled *= spec.scale
    if spec.offset or spec.scale < 0:
        # Adding 0 turns -0.0 into 0.0, as in Python.
        scaled += spec.offset
    return scaled


def _float_physical(spec: SignalSpec, raw: Raws) -> Column:
    bits, kind = _FLOATS[spec.length]
    # A signalling NaN in the data is not an error of this program.
    with np.errstate(invalid="ignore", over="ignore"):
        value: Column = raw.astype(bits).view(kind).astype(np.float64)
        if spec.scale != 1 or spec.offset != 0:
            value = value * spec.scale + spec.offset
    return value


def raw_limits(spec: SignalSpec) -> tuple[int, int]:
    """Return the range of the raw values of an integer signal."""
    if spec.signed:
        return -(1 << spec.length - 1), (1 << spec.length - 1) - 1
    return 0, (1 << spec.length) - 1


def _integer_kind(spec: SignalSpec, offset: int) -> Any:
    ends = [raw * int(spec.scale) + offset for raw in raw_limits(spec)]
    if min(ends) >= -(1 << 63) and max(ends) < 1 << 63:
        return np.int64
    if min(ends) >= 0 and max(ends) < 1 << 64:
        return np.uint64
    return None


def _compiled(cut: Cut, payloads: Payloads, room: Column) -> Column | None:
    """Compute `physical_of` with the kernel; None for a signal that the kernel does not support."""
    spec = cut.spec
    over = cut.skipped + spec.length - WORD_BITS
    if spec.is_float or over > 0 or spec.length > WORD_BITS:
        return None
    kind: Any = np.float64
    if float(spec.scale).is_integer():
        if not float(spec.offset).is_integer():
            return None
        kind = _integer_kind(spec, int(spec.offset)) or np.float64
    word = payloads.word(cut.first_byte, big_endian=spec.big_endian)
    down = -over if spec.big_endian else cut.skipped
    bits = (down, spec.length, spec.signed)
    found: Column | None = kernel.scaled(word, bits, spec.scale, spec.offset, room.view(kind))
    return found


class DecodingPlan:
    """Decodes one message from columns."""

    def __init__(self, spec: MessageSpec) -> None:
        self.spec = spec
        self.cuts = {signal.name: cut_of(signal) for signal in spec.signals}
        self._others = {
            signal.name: [cut_of(each) for each in signal.others]
            for signal in spec.signals
            if signal.others
        }
        """Positions of signals that are also in other pages of the multiplexer."""

    def raw(self, name: str, payloads: Payloads) -> Raws:
        """Return (n,) bits of a signal."""
        raw = raw_of(self.cuts[name], payloads)
        for cut in self._others.get(name, ()):
            raw = np.where(self._carries(cut, payloads), raw_of(cut, payloads), raw)
        return raw

    def physical(self, name: str, payloads: Payloads, room: Column | None = None) -> Column:
        """Return (n,) values; those of frames without the signal have no meaning.

        Args:
            room: (n,) column of eight-byte items for the values.
        """
        cut = self.cuts[name]
        room = np.empty(len(payloads), np.uint64) if room is None else room
        found = _compiled(cut, payloads, room)
        if found is None:
            found = physical_of(cut.spec, raw_of(cut, payloads))
        for other in self._others.get(name, ()):
            value = physical_of(other.spec, raw_of(other, payloads))
            found = np.where(self._carries(other, payloads), value, found)
        return found

    def valid(self, name: str, payloads: Payloads) -> Bools | None:
        """(n,) whether the frame is long enough and its multiplexers select the signal.

        None if that holds for every frame.
        """
        valid = self._valid(self.cuts[name], payloads)
        for cut in self._others.get(name, ()):
            valid = (
                self._carries(cut, payloads)
                if valid is None
                else valid | self._carries(cut, payloads)
            )
        return valid

    def _carries(self, cut: Cut, payloads: Payloads) -> Bools:
        valid = self._valid(cut, payloads)
        return np.ones(len(payloads), np.bool_) if valid is None else valid

    def _valid(self, cut: Cut, payloads: Payloads) -> Bools | None:
        valid = None
        if payloads.shortest < cut.needed:
            valid = payloads.length >= cut.needed
        parent = cut.spec.multiplexer
        if parent is None or parent not in self.cuts:
            return valid
        chosen = among(self.raw(parent, payloads), cut.spec.multiplexer_ids, self.cuts[parent])
        for more in (valid, self.valid(parent, payloads)):
            chosen = chosen if more is None else chosen & more
        return chosen

    def undefined(self, payloads: Payloads) -> Bools | None:
        """(n,) frames with a multiplexer value that selects no signal; None if there are none."""
        found: Bools | None = None
        for name, cut in self.cuts.items():
            if not cut.spec.is_multiplexer:
                continue
            known = {
                each
                for signal in self.spec.signals
                for page in (signal, *signal.others)
                if page.multiplexer == name
                for each in page.multiplexer_ids
            }
            if not known:
                continue
            here = ~among(self.raw(name, payloads), tuple(sorted(known)), cut)
            there = self.valid(name, payloads)
            here = here if there is None else here & there
            found = here if found is None else found | here
        return found if found is not None and found.any() else None


def among(raw: Raws, wanted: tuple[int, ...], cut: Cut) -> Bools:
    """(n,) whether a raw value is one of `wanted`."""
    length = cut.spec.length
    if length <= LOOKUP_BITS_MAX:
        table = np.zeros(1 << length, np.bool_)
        table[[each for each in wanted if 0 <= each < len(table)]] = True
        return table[raw]
    return np.isin(raw, np.array(wanted, np.uint64))
