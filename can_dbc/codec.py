"""Converts frames to bytes and back: alive counter, CRC and inverted twin.

A bad frame gives a value, not an exception.
"""

import enum
from binascii import crc_hqx
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final

from can_dbc.agreement import payload_bytes
from can_dbc.binding import Binding, Frame, MessageProtection, binding_of, known_ids
from can_dbc.c_source import compiled_kinds
from can_dbc.messages import Message
from can_dbc.packing import EncodeError, invalid_values, packer, unpacker, value_table
from can_dbc.rejection import Reason, Rejected
from can_dbc.trailer import AliveCounter, crc_of_data_id, damage, jumped, opener, stuck

__all__ = [
    "Decoder",
    "EncodeError",
    "Encoder",
    "Reason",
    "Rejected",
    "TWIN_WITHIN_NS",
    "compiled_codec",
    "use_compiled",
]

TWIN_WITHIN_NS: Final = 20_000_000
"""Maximum time between the two halves of a vital pair."""

Sent = tuple[tuple[int, bytes], ...]


Heard = Frame | Rejected | None
Hear = Callable[[bytes, int], Heard]
Reject = Callable[[bytes, Reason, str], Rejected]


class WireVerdict(enum.IntEnum):
    """Verdicts of `wire.h` that reject a frame, with their numbers there."""

    WRONG_LENGTH = 2
    WRONG_CRC = 3
    STUCK_COUNTER = 4
    JUMPED_COUNTER = 5
    INVALID_VALUE = 6
    ALONE = 7
    NO_FIRST = 8
    LATE_TWIN = 9
    NOT_INVERSE = 10


_compiled: Any = None


def compiled_codec() -> Any:
    """The extension module in use; None for the functions of this module."""
    return _compiled


def use_compiled(module: Any) -> None:
    """Let new encoders and decoders use this extension module, built from `c_source.sources`.

    It gives the same bytes, frames and rejections. With None they use the functions of this module,
    which are its readable reference.
    """
    global _compiled
    _compiled = module


class Encoder:
    """Converts frames to bus data and counts every transmission.

    Numbers beyond the range of their signal, including infinity, are sent as the end of the range.
    """

    def __init__(self, kinds: Iterable[type[Frame]] = ()) -> None:
        """`kinds` are prepared now; any other kind takes a millisecond when it is first sent."""
        self._send: dict[type, Callable[[Any], Sent]] = {}
        for kind in kinds:
            self._prepare(kind)

    def encode(self, frame: Frame) -> Sent:
        """Return identifier and payload; for a vital frame those of the frame and of its inverted
        twin.

        Raises:
            EncodeError: for NaN or a value of another type than the field's.
        """
        send = self._send.get(type(frame))
        if send is None:
            send = self._prepare(type(frame))
        return send(frame)

    def restart(self, kind: type[Frame]) -> None:
        """Count the transmissions of this frame from 0 again, as a sender that has restarted."""
        self._send.pop(kind, None)

    def _prepare(self, kind: type[Frame]) -> Callable[[Any], Sent]:
        bound = binding_of(kind)
        make = {
            MessageProtection.NONE: _plain_sender,
            MessageProtection.SAFETY: _safe_sender,
            MessageProtection.VITAL: _vital_sender,
        }[bound.protection]
        if _has_compiled(bound):
            make = _compiled_sender
        send = self._send[kind] = make(bound)
        return send


class Decoder:
    """Converts received data to frames, and rejects data that cannot be trusted."""

    def __init__(
        self,
        kinds: Iterable[type[Frame]],
        timeouts_s: Mapping[type[Frame], float] | None = None,
    ) -> None:
        """Decode the frames of `kinds`.

        Args:
            timeouts_s: silence after which any alive counter is accepted as a new start, for kinds
                that are sent at another period than their DBC file gives.
        """
        self.rejections: Counter[tuple[int, Reason]] = Counter()
        """Rejection counts by identifier and reason."""
        self.lost: Counter[int] = Counter()
        """Number of lost frames by identifier, from gaps in accepted alive counters."""
        self._receivers: dict[int, Hear] = {}
        for kind in kinds:
            bound = binding_of(kind)
            silence_s = (timeouts_s or {}).get(kind, bound.timeout_s)
            self._prepare(bound, silence_s)

    @property
    def ids(self) -> frozenset[int]:
        """The identifiers that it decodes, for acceptance filters."""
        return frozenset(self._receivers)

    def decode(self, can_id: int, data: bytes, heard_ns: int) -> Heard:
        """Decode one received frame.

        Returns None for the first half of a vital pair, which has no meaning without its twin, and
        for known identifiers outside of `kinds`. A first half whose twin never arrived is rejected
        when the next first half arrives.
        """
        hear = self._receivers.get(can_id)
        if hear is not None:
            return hear(data, heard_ns)
        if can_id in known_ids():
            return None
        return self._reject(can_id)(data, Reason.UNKNOWN_ID, f"{can_id:#x} is in no DBC file")

    def _prepare(self, bound: Binding, silence_s: float) -> None:
        can_id = bound.message.frame_id
        reject = self._reject(can_id)
        if _has_compiled(bound):
            self._prepare_compiled(bound, silence_s)
            return
        if bound.protection is MessageProtection.NONE:
            self._receivers[can_id] = _plain_receiver(bound, reject)
            return
        alive = AliveCounter(can_id, self.lost, round(silence_s * 1e9))
        if bound.twin is None:
            self._receivers[can_id] = _safe_receiver(bound, alive, reject)
            return
        twin_id = bound.twin.frame_id
        self._receivers[can_id], self._receivers[twin_id] = _vital_receivers(
            bound, bound.twin, alive, reject, self._reject(twin_id)
        )

    def _prepare_compiled(self, bound: Binding, silence_s: float) -> None:
        can_id = bound.message.frame_id
        twin_id = can_id if bound.twin is None else bound.twin.frame_id
        guarded = bound.protection is not MessageProtection.NONE

        def count(lost: int) -> None:
            self.lost[can_id] += lost

        hear, hear_twin = _compiled.receivers(
            *(can_id, bound.kind, _tables(bound), round(silence_s * 1e9) if guarded else 0),
            *(count, _refuser(bound, self._reject(can_id), self._reject(twin_id))),
        )
        self._receivers[can_id] = hear
        if bound.twin is not None:
            self._receivers[twin_id] = hear_twin

    def _reject(self, can_id: int) -> Reject:
        def reject(data: bytes, reason: Reason, detail: str) -> Rejected:
            self.rejections[can_id, reason] += 1
            return Rejected(can_id, bytes(data), reason, detail)

        return reject


def _has_compiled(bound: Binding) -> bool:
    return _compiled is not None and bound.kind in compiled_kinds()


def _compiled_sender(bound: Binding) -> Callable[[Any], Sent]:
    send: Callable[[Any], Sent] = _compiled.sender(
        bound.message.frame_id, bound.kind, _tables(bound), packer(bound.kind)
    )
    return send


def _tables(bound: Binding) -> tuple[tuple[type, tuple[Any, ...]] | None, ...]:
    """For each field the class of its enumeration and the member of every raw value, or None."""
    tables = [(field.kind, value_table(field)) for field in bound.fields]
    return tuple(None if table is None else (kind, table) for kind, table in tables)


def _refuser(bound: Binding, reject: Reject, reject_twin: Reject) -> Callable[..., Rejected]:
    """Return the function from a verdict of the compiled module to the rejection and its text."""
    message, twin = bound.message, bound.twin

    def refuse(
        number: int, of_twin: bool, data: bytes, one: int, other: int, bits: int
    ) -> Rejected:
        verdict = WireVerdict(number)
        if verdict is WireVerdict.INVALID_VALUE:
            return reject(data, Reason.INVALID_VALUE, invalid_values(bound.fields, bits))
        if verdict is WireVerdict.STUCK_COUNTER:
            return reject(data, *stuck(one))
        if verdict is WireVerdict.JUMPED_COUNTER:
            return reject(data, *jumped(one, other))
        if verdict in (WireVerdict.WRONG_LENGTH, WireVerdict.WRONG_CRC):
            if of_twin and twin is not None:
                return reject_twin(data, *damage(twin, data))
            return reject(data, *damage(message, data))
        assert twin is not None
        if verdict is WireVerdict.ALONE:
            return reject(data, *_alone(twin))
        if verdict is WireVerdict.NO_FIRST:
            return reject_twin(data, *_no_first(message))
        if verdict is WireVerdict.LATE_TWIN:
            return reject_twin(data, *_late(message, one - other))
        return reject_twin(data, *_not_inverse(message))

    return refuse


def _alone(twin: Message) -> tuple[Reason, str]:
    return Reason.TWIN_TIMEOUT, f"no {twin.name} before the next pair"


def _no_first(message: Message) -> tuple[Reason, str]:
    return Reason.TWIN_MISMATCH, f"no {message.name} waits for it"


def _late(message: Message, after_ns: int) -> tuple[Reason, str]:
    return Reason.TWIN_TIMEOUT, f"{after_ns / 1e6:.1f} ms after {message.name}"


def _not_inverse(message: Message) -> tuple[Reason, str]:
    return Reason.TWIN_MISMATCH, f"not the inverse of {message.name}"


def _plain_sender(bound: Binding) -> Callable[[Any], Sent]:
    can_id, length = bound.message.frame_id, bound.message.length
    pack = packer(bound.kind)

    def send(frame: Any) -> Sent:
        return ((can_id, pack(frame).to_bytes(length, "little")),)

    return send


def _safe_sender(bound: Binding) -> Callable[[Any], Sent]:
    can_id, start = bound.message.frame_id, crc_of_data_id(bound.message)
    size = payload_bytes(bound.message) + 1
    counter_at = 8 * (size - 1)
    pack = packer(bound.kind)
    last: Any = None
    counter, payload = 0xFF, 0

    def send(frame: Any) -> Sent:
        nonlocal counter, last, payload
        if frame is not last:
            payload = pack(frame)
            last = frame
        counter = counter + 1 & 0xFF
        body = (payload + (counter << counter_at)).to_bytes(size, "little")
        return ((can_id, body + crc_hqx(body, start).to_bytes(2, "little")),)

    return send


def _vital_sender(bound: Binding) -> Callable[[Any], Sent]:
    assert bound.twin is not None
    can_id, twin_id = bound.message.frame_id, bound.twin.frame_id
    start, twin_start = crc_of_data_id(bound.message), crc_of_data_id(bound.twin)
    size = payload_bytes(bound.message) + 1
    counter_at = 8 * (size - 1)
    ones = (1 << counter_at) - 1
    pack = packer(bound.kind)
    last: Any = None
    counter, payload = 0xFF, 0

    def send(frame: Any) -> Sent:
        nonlocal counter, last, payload
        if frame is not last:
            payload = pack(frame)
            last = frame
        counter = counter + 1 & 0xFF
        body = (payload + (counter << counter_at)).to_bytes(size, "little")
        inverted = ((payload ^ ones) + (counter << counter_at)).to_bytes(size, "little")
        return (
            (can_id, body + crc_hqx(body, start).to_bytes(2, "little")),
            (twin_id, inverted + crc_hqx(inverted, twin_start).to_bytes(2, "little")),
        )

    return send


def _reader(bound: Binding) -> Callable[[int], Frame | None]:
    """Convert payload bits to a frame; equal bits in succession give the same immutable frame
    object.
    """
    unpack = unpacker(bound.kind)
    last_bits, last = -1, None

    def read(bits: int) -> Frame | None:
        nonlocal last_bits, last
        if bits != last_bits:
            last = unpack(bits)
            last_bits = bits
        return last

    return read


def _plain_receiver(bound: Binding, reject: Reject) -> Hear:
    message, length = bound.message, bound.message.length
    read = _reader(bound)

    def hear(data: bytes, _heard_ns: int) -> Heard:
        if len(data) != length:
            return reject(data, *damage(message, data))
        bits = int.from_bytes(data, "little")
        frame = read(bits)
        if frame is None:
            return reject(data, Reason.INVALID_VALUE, invalid_values(bound.fields, bits))
        return frame

    return hear


def _safe_receiver(bound: Binding, alive: AliveCounter, reject: Reject) -> Hear:
    message, unpack = bound.message, unpacker(bound.kind)
    length, start, counter_at = message.length, crc_of_data_id(message), payload_bytes(message)
    crc_at, crc_shift = length - 2, 8 * (length - 2)
    mask = (1 << 8 * counter_at) - 1
    from_bytes = int.from_bytes
    last_bits, last = -1, None

    # Most of the traffic passes here. The checks of `opener` and the normal step of the alive
    # counter are therefore repeated inline to save two calls.
    def hear(data: bytes, heard_ns: int) -> Heard:
        nonlocal last_bits, last
        if len(data) != length:
            return reject(data, *damage(message, data))
        word = from_bytes(data, "little")
        if crc_hqx(data[:crc_at], start) != word >> crc_shift:
            return reject(data, *damage(message, data))
        counter = data[counter_at]
        if counter - alive.value & 0xFF != 1:
            fault = alive.fault(counter, heard_ns)
            if fault is not None:
                return reject(data, *fault)
        else:
            alive.value = counter
            alive.heard_ns = heard_ns
        bits = word & mask
        if bits != last_bits:
            last = unpack(bits)
            last_bits = bits
        if last is None:
            return reject(data, Reason.INVALID_VALUE, invalid_values(bound.fields, bits))
        return last

    return hear


def _vital_receivers(
    bound: Binding, twin: Message, alive: AliveCounter, reject: Reject, reject_twin: Reject
) -> tuple[Hear, Hear]:
    """Return the receivers of the two halves; the first half waits for the second."""
    message, opened, opened_twin = bound.message, opener(bound.message), opener(twin)
    read = _reader(bound)
    counter_at = 8 * payload_bytes(message)
    mask = (1 << counter_at) - 1
    waiting: tuple[int, int, bytes] | None = None

    def hear_first(data: bytes, heard_ns: int) -> Heard:
        nonlocal waiting
        word = opened(data)
        if word < 0:
            return reject(data, *damage(message, data))
        fault = alive.fault(word >> counter_at, heard_ns)
        if fault is not None:
            return reject(data, *fault)
        alone, waiting = waiting, (word, heard_ns, data)
        if alone is not None:
            return reject(alone[2], *_alone(twin))
        return None

    def hear_twin(data: bytes, heard_ns: int) -> Heard:
        nonlocal waiting
        word = opened_twin(data)
        if word < 0:
            return reject_twin(data, *damage(twin, data))
        if waiting is None:
            return reject_twin(data, *_no_first(message))
        (first, first_ns, first_data), waiting = waiting, None
        if heard_ns - first_ns > TWIN_WITHIN_NS:
            return reject_twin(data, *_late(message, heard_ns - first_ns))
        if first ^ word != mask:
            return reject_twin(data, *_not_inverse(message))
        frame = read(first & mask)
        if frame is None:
            detail = invalid_values(bound.fields, first & mask)
            return reject(first_data, Reason.INVALID_VALUE, detail)
        return frame

    return hear_first, hear_twin
