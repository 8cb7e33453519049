"""Verdicts of the project's own codec on every frame of a log, computed for whole columns.

On board, `can_dbc.codec.Decoder` judges frame by frame. Here the same rules run over columns, so
that a log of millions of frames is judged in seconds. Tests compare both.
"""

from collections import Counter
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

import numpy as np

from can_dbc.agreement import FieldLayout, payload_bytes
from can_dbc.binding import Binding, MessageProtection, binding_of, kinds
from can_dbc.codec import TWIN_WITHIN_NS
from can_dbc.packing import invalid_values, value_table
from can_dbc.rejection import Reason
from can_dbc.trailer import AliveCounter, crc_of_data_id, damage
from canlog.frames import EXTENDED, NOT_DATA, Bytes, Frames, Ints
from canlog.table import Groups
from canlog.verdict_codes import ACCEPTED, NOT_JUDGED, UNCONFIRMED

CODES: Final = {reason: number for number, reason in enumerate(Reason, 3)}
REASONS: Final = {number: reason for reason, number in CODES.items()}
_POLYNOMIAL: Final = 0x1021


def _crc_table(bits: int) -> Any:
    """CRC-16 of every number of `bits` bits, from the state 0."""
    value = np.arange(1 << bits, dtype=np.uint32) << np.uint32(16 - bits)
    for _ in range(bits):
        high = (value & 0x8000) != 0
        value = (value << np.uint32(1) & np.uint32(0xFFFF)) ^ np.where(
            high, np.uint32(_POLYNOMIAL), np.uint32(0)
        )
    return value.astype(np.uint16)


_CRC_8: Final = _crc_table(8)
_CRC_16: Final = _crc_table(16)


def crc16(data: Bytes, start: int) -> Any:
    """(n,): CRC-16 with polynomial 0x1021 over the rows of (n, k), from the state `start`."""
    state = np.full(len(data), start, np.uint16)
    odd = data.shape[1] % 2
    if odd:
        state = (state << np.uint16(8)) ^ _CRC_8[state >> np.uint16(8) ^ data[:, 0]]
    for at in range(odd, data.shape[1], 2):
        word = data[:, at].astype(np.uint16) << np.uint16(8) | data[:, at + 1]
        state = _CRC_16[state ^ word]
    return state


@dataclass(frozen=True, slots=True)
class Verdicts:
    """Verdicts on the frames of one log."""

    code: Bytes
    """(n,) NOT_JUDGED, ACCEPTED, UNCONFIRMED, or the number of the rejection's reason in CODES."""
    lost: dict[int, int]
    """By identifier: frames that never came, counted from gaps in alive counters."""

    def rejected(self) -> Any:
        """(k,) rows of rejected frames."""
        return np.flatnonzero(self.code > UNCONFIRMED)

    def reason(self, row: int) -> Reason | None:
        return REASONS.get(int(self.code[row]))


@dataclass(slots=True)
class _Pair:
    """First half of a vital pair that waits for its twin: row, stamp, and payload with counter."""

    waiting: tuple[int, int, int] | None = None
    late: list[tuple[int, int]] = field(default_factory=list)
    """Row and code of the half that waited since an earlier block."""


class LateVerdict(NamedTuple):
    """Final verdict on a frame of an earlier block."""

    row: int
    """Row in the whole log."""
    code: int
    channel: str
    can_id: int


@dataclass(slots=True)
class Judge:
    """Judges a log block by block. Every channel has its own receivers."""

    lost: Counter[int] = field(default_factory=Counter)
    late: list[LateVerdict] = field(default_factory=list)
    """Frames of earlier blocks that were UNCONFIRMED and that the last block decided."""
    _fed: int = 0
    _alive: dict[tuple[str, int], AliveCounter] = field(default_factory=dict)
    _pairs: dict[tuple[str, int], _Pair] = field(default_factory=dict)

    def feed(self, frames: Frames, groups: Groups | None = None) -> Bytes:
        """Return (n,) codes of the next frames; `late` has the verdicts on earlier ones."""
        self.late = []
        code = np.full(len(frames), CODES[Reason.UNKNOWN_ID], np.uint8)
        skipped = (frames.flags & np.uint8(NOT_DATA | EXTENDED)) != 0
        code[skipped] = NOT_JUDGED
        groups = groups or Groups(frames)
        for bound in _bindings():
            rows = groups.rows(bound.message.frame_id)
            twins = groups.rows(bound.twin.frame_id) if bound.twin is not None else rows[:0]
            for channel, name in enumerate(frames.channels):
                mine, other = (
                    _of_channel(frames, rows, channel),
                    _of_channel(frames, twins, channel),
                )
                if len(mine) or len(other):
                    self._judge(bound, name, frames, mine, other, code)
        self._fed += len(frames)
        return code

    def _judge(
        self, bound: Binding, channel: str, frames: Frames, rows: Ints, twins: Ints, code: Bytes
    ) -> None:
        if bound.protection is MessageProtection.NONE:
            right = frames.length[rows] == bound.message.length
            code[rows] = np.where(right, ACCEPTED, CODES[Reason.WRONG_LENGTH])
            _refuse_invalid(bound, frames, rows[right], code)
            return
        whole = _checked(bound.message, frames, rows, code)
        accepted = self._counted(bound, channel, frames, whole, code)
        if bound.twin is None:
            _refuse_invalid(bound, frames, accepted, code)
            return
        intact = _checked(bound.twin, frames, twins, code)
        pair = self._pairs.setdefault((channel, bound.message.frame_id), _Pair())
        self._paired(bound, pair, frames, accepted, intact, code)
        self.late += [
            LateVerdict(row, told, channel, bound.message.frame_id)
            for row, told in pair.late
            if told != UNCONFIRMED
        ]

    def _counted(
        self, bound: Binding, channel: str, frames: Frames, rows: Ints, code: Bytes
    ) -> Ints:
        """Return the rows that the alive counter accepts; the others get the code of their
        reason.
        """
        can_id = bound.message.frame_id
        alive = self._alive.get((channel, can_id))
        if alive is None:
            alive = AliveCounter(can_id, self.lost, round(bound.timeout_s * 1e9))
            self._alive[channel, can_id] = alive
        counter = frames.data[rows, payload_bytes(bound.message)]
        faults = follow(alive, frames.at_ns[rows], counter)
        for at, reason in faults:
            code[rows[at]] = CODES[reason]
        return rows[code[rows] == ACCEPTED] if faults else rows

    def _paired(
        self,
        bound: Binding,
        pair: _Pair,
        frames: Frames,
        firsts: Ints,
        twins: Ints,
        code: Bytes,
    ) -> None:
        """Match the halves of vital pairs in log order."""
        counter_bits = 8 * (payload_bytes(bound.message) + 1)
        mask = np.uint64((1 << counter_bits) - 1)
        rows = np.concatenate([firsts, twins])
        is_first = np.arange(len(rows)) < len(firsts)
        order = np.argsort(rows, kind="stable")
        rows, is_first = rows[order], is_first[order]
        word = _words(frames, rows) & mask
        at_ns = frames.at_ns[rows]
        # Row numbers of this block start at `_fed`, because a waiting half of an earlier block has
        # one.
        rows = rows + self._fed
        if pair.waiting is not None:
            row, waited_ns, waited = pair.waiting
            rows, is_first = np.insert(rows, 0, row), np.insert(is_first, 0, True)
            word = np.insert(word, 0, np.uint64(waited))
            at_ns = np.insert(at_ns, 0, waited_ns)
        told = self._halves(bound, is_first, word, at_ns)
        pair.waiting = None
        if len(rows) and is_first[-1]:
            pair.waiting = int(rows[-1]), int(at_ns[-1]), int(word[-1])
        mine = rows >= self._fed
        code[rows[mine] - self._fed] = told[mine]
        pair.late = [(int(r), int(c)) for r, c in zip(rows[~mine], told[~mine], strict=True)]

    def _halves(self, bound: Binding, is_first: Any, word: Any, at_ns: Ints) -> Bytes:
        """(n,) codes of accepted first halves and intact twins, in log order."""
        told = np.full(len(word), UNCONFIRMED, np.uint8)
        before = np.concatenate([[False], is_first[:-1]])
        after = np.concatenate([is_first[1:], [False]])
        told[is_first & after] = CODES[Reason.TWIN_TIMEOUT]
        told[~is_first & ~before] = CODES[Reason.TWIN_MISMATCH]
        twin = np.flatnonzero(~is_first & before)
        first = twin - 1
        ones = np.uint64((1 << 8 * payload_bytes(bound.message)) - 1)
        late = at_ns[twin] - at_ns[first] > TWIN_WITHIN_NS
        unlike = (word[first] ^ word[twin]) != ones
        told[twin[unlike]] = CODES[Reason.TWIN_MISMATCH]
        told[twin[late]] = CODES[Reason.TWIN_TIMEOUT]
        good = ~(late | unlike)
        invalid = _invalid(bound, word[first])
        told[first[good & invalid]] = CODES[Reason.INVALID_VALUE]
        told[first[good & ~invalid]] = ACCEPTED
        told[twin[good & ~invalid]] = ACCEPTED
        return told


def follow(alive: AliveCounter, at_ns: Ints, counter: Bytes) -> list[tuple[int, Reason]]:
    """Step an alive counter over intact frames; return which are rejected, and why.

    A run that counts up by one only changes the last value and instant. Therefore the counter gets
    only the ends of such runs, and the frames between them, one by one.
    """
    breaks = np.flatnonzero(np.diff(counter) != 1) + 1
    ends = [*breaks.tolist(), len(counter)]
    faults: list[tuple[int, Reason]] = []
    at, run, count = 0, 0, len(counter)
    while at < count:
        fault = alive.fault(int(counter[at]), int(at_ns[at]))
        at += 1
        if fault is not None:
            faults.append((at - 1, fault[0]))
            continue
        while ends[run] < at:
            run += 1
        if ends[run] > at:
            at = ends[run]
            alive.value = int(counter[at - 1])
            alive.heard_ns = int(at_ns[at - 1])
    return faults


def judge(frames: Frames, groups: Groups | None = None) -> Verdicts:
    """Return the verdicts on a whole log of this project's bus."""
    one = Judge()
    code = one.feed(frames, groups)
    return Verdicts(code, {key: count for key, count in one.lost.items() if count})


def detail_of(frames: Frames, row: int, code: int) -> str:
    """Return why a frame was rejected, as text for people."""
    reason = REASONS.get(code)
    data, can_id = frames.payload(row), int(frames.identifier[row])
    for bound in _bindings():
        for message in bound.messages:
            if message.frame_id != can_id:
                continue
            if reason in (Reason.WRONG_LENGTH, Reason.WRONG_CRC):
                return damage(message, data)[1]
            if reason is Reason.INVALID_VALUE:
                return invalid_values(bound.fields, int.from_bytes(data, "little"))
            if reason in (Reason.STUCK_COUNTER, Reason.JUMPED_COUNTER):
                return f"counter is {data[payload_bytes(message)]}"
    return ""


def _bindings() -> list[Binding]:
    return [binding_of(kind) for kind in kinds()]


def _of_channel(frames: Frames, rows: Ints, channel: int) -> Ints:
    if len(frames.channels) == 1:
        return rows
    mine: Ints = rows[frames.channel[rows] == channel]
    return mine


def _words(frames: Frames, rows: Ints) -> Any:
    if frames.data.shape[1] == 8 and frames.data.flags.c_contiguous:
        return frames.data.view("<u8")[:, 0][rows]
    return np.ascontiguousarray(frames.data[rows, :8]).view("<u8")[:, 0]


def _checked(message: Any, frames: Frames, rows: Ints, code: Bytes) -> Ints:
    """Return the rows with correct length and CRC, which become ACCEPTED for now."""
    right = frames.length[rows] == message.length
    if not right.all():
        code[rows[~right]] = CODES[Reason.WRONG_LENGTH]
        rows = rows[right]
    data = _words(frames, rows).view(np.uint8).reshape(-1, 8)
    length = message.length
    wanted = crc16(data[:, : length - 2], crc_of_data_id(message))
    found = data[:, length - 1].astype(np.uint16) << np.uint16(8) | data[:, length - 2]
    good = wanted == found
    code[rows] = np.where(good, ACCEPTED, CODES[Reason.WRONG_CRC])
    return rows if good.all() else rows[good]


def _refuse_invalid(bound: Binding, frames: Frames, rows: Ints, code: Bytes) -> None:
    invalid = _invalid(bound, _words(frames, rows))
    if invalid.any():
        code[rows[invalid]] = CODES[Reason.INVALID_VALUE]


def _invalid(bound: Binding, word: Any) -> Any:
    """(n,) whether a field has a value that its type does not define."""
    found = np.zeros(len(word), np.bool_)
    for layout in bound.fields:
        bad = _bad_raws(layout, word)
        if bad is not None:
            found |= bad
    return found


def _bad_raws(layout: FieldLayout, word: Any) -> Any:
    if layout.kind is bool:
        return None
    mask = (1 << layout.length) - 1
    raw = word >> np.uint64(layout.start) & np.uint64(mask)
    table = value_table(layout)
    if table is not None:
        known = np.array([member is not None for member in table])
        return None if known.all() else ~known[raw]
    if layout.raw_maximum - layout.raw_minimum >= mask:
        return None
    signed = raw.astype(np.int64)
    if layout.signed:
        sign = 1 << layout.length - 1
        signed = (signed ^ sign) - sign
    return (signed < layout.raw_minimum) | (signed > layout.raw_maximum)
