"""Finds the bit fields of a bus that follow a course, by their correlation with it.

The value of a bit field is a weighted sum of its bits. So its variance, and its covariance with the
course, follow from those of the single bits. Every field of every message is tried at that price.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from canlog.course import ReferenceCourse
from canlog.frames import KEY_EXTENDED, Bools, Ints
from canlog.reader import Log

FRAMES_MIN: Final = 16
"""Minimum frames of an identifier within the course."""
BITS_TAKEN: Final = 1_300_000
"""Bits of an identifier that are looked at: 20,000 frames of eight bytes, spread over the log."""
LENGTH_MAX: Final = 32
"""Maximum bits of a field; longer ones are found by their upper 32 bits."""
SHIFTS: Final = 40
"""Number of shifts that are tried in each direction."""
ALIKE: Final = 1.1
"""Fields whose unexplained share is within this factor of the least one count as equally good."""
EXACT: Final = 1e-9
"""Unexplained share from which on fields are compared by their values, not by sums over bits."""
ROUNDING: Final = 1e-24
"""Unexplained share that rounding of values alone can cause."""
PER_MESSAGE: Final = 3
"""Maximum fields of one message in the result."""
STEEP: Final = 1.25
"""Factor by which a bit may change more often than the one below it in the same field."""
QUIET: Final = 0.45
"""Share of the most frequent changes from which on this says nothing: of a fast ramp, the bit that
counts its steps changes most often."""
OFFSET_DIGITS: Final = 6
"""Digits of the offset in steps of the raw value; the rest is rounding."""
TINY: Final = 1e-300
"""Keeps a course without variance from a division by zero."""


@dataclass(frozen=True, slots=True)
class FieldMatch:
    """A bit field that follows the course: course = raw value * scale + offset."""

    key: int
    channel: str
    frames: int
    """Number of frames that were compared."""
    start: int
    """Start bit as in a DBC file."""
    length: int
    big_endian: bool
    signed: bool
    correlation: float
    """From -1 to 1; negative where the field falls while the course rises."""
    scale: float
    offset: float
    shift_s: float
    """How much later the field follows than the course was given."""

    @property
    def layout(self) -> str:
        """Position as in a DBC file, such as `8|16@1+`."""
        order, sign = int(not self.big_endian), "-" if self.signed else "+"
        return f"{self.start}|{self.length}@{order}{sign}"

    @property
    def identifier(self) -> int:
        return self.key & ~KEY_EXTENDED

    def bits(self) -> frozenset[int]:
        """Return all bits of the field as 8 * byte + bit from the low end."""
        return bits_of(self.start, self.length, big_endian=self.big_endian)


def bits_of(start: int, length: int, *, big_endian: bool) -> frozenset[int]:
    """Return the bits of a signal of a DBC file as 8 * byte + bit from the low end."""
    if not big_endian:
        return frozenset(range(start, start + length))
    return frozenset(mirrored(at) for at in range(mirrored(start), mirrored(start) + length))


def mirrored(bit: int) -> int:
    """Number a bit from the other end of its byte."""
    return bit ^ 7


def search(
    log: Log,
    course: ReferenceCourse,
    *,
    shift_s: float = 0.0,
    least: float = 0.5,
    left_out: Iterable[tuple[int, str]] = (),
) -> list[FieldMatch]:
    """Return the best fields of each identifier, the best first.

    Args:
        shift_s: how much earlier or later than given the course may be.
        least: the least correlation of a match.
        left_out: key and channel of frames that carry the course itself.
    """
    found: list[FieldMatch] = []
    skipped = set(left_out)
    for key, channel in log.groups.places:
        if (key, channel) not in skipped:
            found += _of_message(log, key, channel, course, round(shift_s * 1e9), least)
    return sorted(found, key=lambda each: (-abs(each.correlation), each.key, each.channel))


def _of_message(
    log: Log, key: int, channel: str, course: ReferenceCourse, shift_ns: int, least: float
) -> Iterator[FieldMatch]:
    at_ns = log.groups.at_ns(key, channel=channel)
    inside = at_ns >= course.at_ns[0] + shift_ns
    inside &= at_ns <= course.at_ns[-1] - shift_ns
    rows = np.flatnonzero(inside)
    payloads = log.groups.payloads(key, channel=channel)
    width = int(payloads.length.max(initial=0))
    if len(rows) < FRAMES_MIN or not width:
        return
    most = max(FRAMES_MIN, BITS_TAKEN // (8 * width * (8 if shift_ns else 1)))
    if len(rows) > most:
        rows = rows[np.linspace(0, len(rows) - 1, most).astype(np.int64)]
    shifts = np.linspace(-shift_ns, shift_ns, 2 * SHIFTS + 1 if shift_ns else 1).astype(np.int64)
    wanted = np.stack([course.at(at_ns[rows] - shift) for shift in shifts], axis=1)
    now, before = payloads.data[rows, :width], payloads.data[np.maximum(rows - 1, 0), :width]
    bits = np.unpackbits(now, axis=1, bitorder="little")
    flips = np.unpackbits(now ^ before, axis=1, bitorder="little").mean(axis=0)
    sums = _Sums(bits, wanted, flips)
    for field in sums.best(least**2):
        scale, offset = sums.fit(field)
        yield FieldMatch(
            key,
            channel,
            len(rows),
            mirrored(field.start) if field.big_endian else field.start,
            field.length,
            field.big_endian,
            field.signed,
            float(np.sign(scale)) * float(np.sqrt(field.explained)),
            scale,
            offset,
            float(shifts[field.shift]) / 1e9,
        )


@dataclass(frozen=True, slots=True)
class _Field:
    """A field by its first bit, counted from the low or, if big endian, the high end of bytes."""

    start: int
    length: int
    big_endian: bool
    signed: bool
    explained: float
    """Share of the variance of the course that the field explains."""
    shift: int

    def places(self) -> Ints:
        """(length,) columns of the bits, lowest bit first."""
        at = np.arange(self.start, self.start + self.length)
        return at[::-1] ^ 7 if self.big_endian else at


class _Sums:
    """Means and covariances of the bits of one message and of the shifted course."""

    def __init__(self, bits: Any, wanted: Any, flips: Any) -> None:
        """Take bits (n, m) of 0 and 1, the course (n, s) for each shift, and flip ratios (m,)."""
        self._mean, self._wanted_mean = bits.mean(axis=0), wanted.mean(axis=0)
        centred, aim = bits - self._mean, wanted - self._wanted_mean
        self._bits, self._aim = bits.astype(np.float64), aim
        self._among = centred.T @ centred / len(bits)
        self._with = centred.T @ aim / len(bits)
        self._power = (aim**2).mean(axis=0)
        self._flips = flips
        self._moving: Bools = self._among.diagonal() > 0

    def best(self, least: float) -> Iterator[_Field]:
        """Yield the best field, then the best of those that share no bit with it, and so on.

        Args:
            least: share of the variance of the course that a field has to explain.
        """
        fields = [each for order in (False, True) for each in self._columns(big_endian=order)]
        columns = [np.concatenate(column) for column in zip(*fields, strict=True)]
        start, length, big, _, explained, _ = columns
        rest = 1 - explained
        left = explained >= least
        for _ in range(PER_MESSAGE):
            if not left.any():
                return
            limit = max(ALIKE * rest[left].min(), EXACT)
            good = [
                _Field(*(column[at].item() for column in columns))
                for at in np.flatnonzero(left & (rest <= limit))
            ]
            good = self._alike(good) if limit <= EXACT else good
            chosen = min(good, key=self._oddness)
            yield chosen
            taken = np.zeros(len(self._moving), np.int64)
            taken[chosen.places()] = 1
            for order, column in ((False, taken), (True, taken[np.arange(len(taken)) ^ 7])):
                until = np.concatenate([[0], np.cumsum(column)])
                mine = big == order
                left[mine] &= until[(start + length)[mine]] == until[start[mine]]

    def _alike(self, fields: list[_Field]) -> list[_Field]:
        """Return the fields that are equally good by their values, which have more digits."""
        rest = np.array([self._rest(each) for each in fields])
        limit = ALIKE * rest.min() + ROUNDING
        return [each for each, share in zip(fields, rest, strict=True) if share <= limit]

    def _rest(self, field: _Field) -> float:
        """Return the share of the course that the values of a field do not explain."""
        value, aim = self._bits[:, field.places()] @ _weights(field), self._aim[:, field.shift]
        value = value - value.mean()
        power = float(value @ value)
        left = aim - value * (float(value @ aim) / power) if power else aim
        return float(left @ left) / max(float(aim @ aim), TINY)

    def _oddness(self, field: _Field) -> tuple[int, int, bool]:
        """Order equally good fields: a bit rarely changes more often than a quiet one below it."""
        flips = self._flips[field.places()]
        quiet = flips[:-1] < QUIET * flips.max()
        steep = int((quiet & (flips[1:] > STEEP * flips[:-1])).sum())
        return steep, -field.length, field.big_endian

    def _columns(self, *, big_endian: bool) -> Iterator[tuple[Any, ...]]:
        """Yield columns of fields of one length and sign: those whose end bits both move."""
        count = len(self._moving)
        # In this order of bits, a field is a run whose highest bit comes last.
        order = np.arange(count)
        if big_endian:
            order = order[::-1] ^ 7
        among, with_, moving = (
            self._among[np.ix_(order, order)],
            self._with[order],
            self._moving[order],
        )
        own = among.diagonal()
        power, with_course = np.zeros(count + 1), np.zeros((count + 1, with_.shape[1]))
        for length in range(1, min(LENGTH_MAX, count) + 1):
            fields = count - length + 1
            top, weight = slice(length - 1, length - 1 + fields), 2.0 ** (length - 1)
            cross = np.zeros(fields)
            for low in range(length - 1):
                cross += 2.0**low * np.diagonal(among, length - 1 - low)[low : low + fields]
            below, below_course = power[:fields], with_course[:fields]
            square = below + weight**2 * own[top]
            ends = moving[:fields] & moving[top]
            first = np.arange(fields)
            starts = count - length - first if big_endian else first
            for signed in (False, True)[: 1 + (length > 1)]:
                sign = -1 if signed else 1
                total = square + sign * 2 * weight * cross
                course = below_course + sign * weight * with_[top]
                share = course**2 / np.maximum(total[:, None] * self._power, TINY)
                shift = share.argmax(axis=1)
                # A sum that almost cancels is lost in rounding; a shorter field has the same value.
                sound = ends & (total > 1e-9 * square)
                explained = np.where(sound, np.minimum(share.max(axis=1), 1.0), 0.0)
                flags = np.full(fields, big_endian), np.full(fields, signed)
                yield (starts, np.full(fields, length), *flags, explained, shift)
                if not signed:
                    power, with_course = total, course

    def fit(self, field: _Field) -> tuple[float, float]:
        """Return scale and offset of the line that maps raw values to the course best."""
        at, weights = field.places(), _weights(field)
        power = weights @ self._among[np.ix_(at, at)] @ weights
        scale = float(weights @ self._with[at, field.shift] / power)
        steps = float(self._wanted_mean[field.shift]) / scale - float(weights @ self._mean[at])
        return scale, scale * round(steps, OFFSET_DIGITS)


def _weights(field: _Field) -> Any:
    """(length,) what each bit adds to the value, lowest bit first."""
    weights = 2.0 ** np.arange(field.length)
    if field.signed:
        weights[-1] = -weights[-1]
    return weights
