"""Disturbances that an attacker or a defective wire adds to genuine traffic, from one generator."""

from binascii import crc_hqx
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from can_dbc.binding import MessageProtection, binding_of
from can_dbc.trailer import crc_of_data_id
from firmware_py.ports import CanFrame, RadioMessage, SerialChunk
from metro_hil.proof.genuine import Genuine
from vobc.wire.inbox import RECEIVED_KINDS

STANDARD_IDS: Final = 2048
MAX_BYTES: Final = 8
TRAILER_BYTES: Final = 3
FLIPS_MAX: Final = 3
"""Number of flipped bits that the CRC always detects."""
GARBAGE_BYTES_MAX: Final = 64
COUNTER_MASK: Final = 0xFF
TELEGRAMS_KNOWN: Final = 8
"""Number of recent telegrams that a parser recognises byte for byte."""

_BOUND: Final = [binding_of(kind) for kind in RECEIVED_KINDS]
PROTECTED: Final = {
    bound.message.frame_id: (bound.message.length, crc_of_data_id(bound.message))
    for bound in _BOUND
    if bound.protection is not MessageProtection.NONE
}
"""Identifiers that the controller receives with a CRC: length, and state of the CRC after the data
id."""
UNPROTECTED: Final = frozenset(
    bound.message.frame_id for bound in _BOUND if bound.protection is MessageProtection.NONE
)


def authentic(frame: CanFrame) -> bool:
    """Tell whether only its counter can show a receiver that the frame is not genuine."""
    if frame.extended or frame.remote or frame.error:
        return False
    if frame.can_id in UNPROTECTED:
        return True
    known = PROTECTED.get(frame.can_id)
    if known is None or len(frame.data) != known[0]:
        return False
    return crc_hqx(frame.data[:-2], known[1]) == int.from_bytes(frame.data[-2:], "little")


class Attacker:
    """Generates disturbances around the genuine traffic of one run."""

    def __init__(self, genuine: Genuine, generator: np.random.Generator) -> None:
        self._genuine, self._draw = genuine, generator
        self._ids = sorted(PROTECTED)
        self.lucky = 0
        """Number of noise frames with a correct CRC by chance or without need of one; they are left
        out."""
        self._counters: dict[int, int] = {}
        self._payloads: dict[int, bytes] = {}
        # Attack one kind of frame at a time: all of them at once would only show a braked train.
        aim = int(generator.integers(0, len(self._ids) + 1))
        self._aimed_at = frozenset(self._ids if aim == len(self._ids) else self._ids[aim : aim + 1])
        self._noises: tuple[Callable[[int], CanFrame], ...] = (
            self._random_frame,
            self._random_of_known,
            self._flipped,
            self._shortened,
            self._other_kind,
            self._under_other_id,
        )

    def noise(self, count: int, now_ns: int) -> list[CanFrame]:
        """Return frames that must have no effect: damaged, foreign, of the wrong length or kind."""
        made = []
        for kind in self._draw.integers(0, len(self._noises), count).tolist():
            frame = self._noises[kind](now_ns)
            if authentic(frame):
                self.lucky += 1
            else:
                made.append(frame)
        return made

    def replayed(self, count: int, before: int, now_ns: int) -> list[CanFrame]:
        """Return single genuine frames of the past; `before` is the number of frames so far."""
        if not before:
            return []
        frames = self._genuine.frames
        places = self._draw.integers(0, before, count).tolist()
        picked = [frames[place] for place in places]
        return [f._replace(stamp_ns=now_ns) for f in picked if f.can_id in self._aimed_at]

    def forged(self, count: int, now_ns: int) -> list[CanFrame]:
        """Return frames with valid CRC, next counter and any payload; no check detects them."""
        ids = [self._ids[at] for at in self._draw.integers(0, len(self._ids), count).tolist()]
        return [
            self._signed(can_id, self._payload(can_id), now_ns)
            for can_id in ids
            if can_id in self._aimed_at
        ]

    def _payload(self, can_id: int) -> bytes:
        """Return any payload, or the last received one with a few bits changed."""
        last = self._payloads.get(can_id)
        if last is None or self._draw.integers(0, 2):
            return self._draw.bytes(MAX_BYTES)
        return self._with_flips(last)

    def heard(self, frames: Sequence[CanFrame]) -> None:
        """Note counters and payloads of genuine frames, from which forged frames continue."""
        for frame in frames:
            if frame.can_id in PROTECTED:
                self._counters[frame.can_id] = frame.data[-TRAILER_BYTES]
                self._payloads[frame.can_id] = frame.data[:-TRAILER_BYTES]

    def garbage(self, before: int, now_ns: int) -> SerialChunk:
        """Return random bytes, a torn telegram or one with flipped bits for the tag reader's line.

        Frames may share a flag, so a telegram without its closing flag becomes whole when the next
        one opens. It is chosen from those that the parser still knows, so that it is a duplicate.
        Older ones are replays, which the window of their tag has to judge.

        Args:
            before: number of pieces on the line so far.
        """
        chunks = self._genuine.chunks
        kind = int(self._draw.integers(0, 4))
        if kind == 0 or not before:
            return SerialChunk(now_ns, self._draw.bytes(self._up_to(GARBAGE_BYTES_MAX)))
        if kind == 1:
            recent = chunks[max(0, before - TELEGRAMS_KNOWN) : before]
            return SerialChunk(now_ns, recent[self._up_to(len(recent) - 1)].data[:-1])
        data = chunks[int(self._draw.integers(0, len(chunks)))].data
        if kind == 2:
            return SerialChunk(now_ns, data[: self._up_to(len(data) - 2)])
        return SerialChunk(now_ns, data[:1] + self._with_flips(data[1:-1]) + data[-1:])

    def babble(self, before: int, now_ns: int) -> RadioMessage:
        """Return random bytes, a damaged message, or an old message for the radio."""
        messages = self._genuine.messages[:before]
        kind = int(self._draw.integers(0, 4))
        if kind == 0 or not messages:
            return RadioMessage(now_ns, "m", self._draw.bytes(self._up_to(GARBAGE_BYTES_MAX)))
        old = messages[int(self._draw.integers(0, len(messages)))]
        payload = old.payload
        if kind == 1:
            payload = self._with_flips(payload)
        elif kind == 2:
            payload = payload[: self._up_to(len(payload) - 1)]
        return RadioMessage(now_ns, old.key, payload)

    def _random_frame(self, now_ns: int) -> CanFrame:
        can_id = int(self._draw.integers(0, STANDARD_IDS))
        return CanFrame(now_ns, can_id, self._draw.bytes(self._up_to(MAX_BYTES)))

    def _random_of_known(self, now_ns: int) -> CanFrame:
        can_id = self._ids[int(self._draw.integers(0, len(self._ids)))]
        length, _ = PROTECTED[can_id]
        return CanFrame(now_ns, can_id, self._draw.bytes(length))

    def _flipped(self, now_ns: int) -> CanFrame:
        frame = self._any()
        return CanFrame(now_ns, frame.can_id, self._with_flips(frame.data))

    def _shortened(self, now_ns: int) -> CanFrame:
        frame = self._any()
        return CanFrame(now_ns, frame.can_id, frame.data[: self._up_to(len(frame.data) - 1)])

    def _other_kind(self, now_ns: int) -> CanFrame:
        frame = self._any()
        remote = bool(self._draw.integers(0, 2))
        return CanFrame(now_ns, frame.can_id, frame.data, extended=not remote, remote=remote)

    def _under_other_id(self, now_ns: int) -> CanFrame:
        can_id = self._ids[int(self._draw.integers(0, len(self._ids)))]
        frame = self._any()
        if frame.can_id == can_id:
            return self._flipped(now_ns)
        return CanFrame(now_ns, can_id, frame.data)

    def _signed(self, can_id: int, payload: bytes, now_ns: int) -> CanFrame:
        length, start = PROTECTED[can_id]
        counter = self._counters.get(can_id, 0) + 1 & COUNTER_MASK
        self._counters[can_id] = counter
        body = payload[: length - TRAILER_BYTES] + bytes((counter,))
        return CanFrame(now_ns, can_id, body + crc_hqx(body, start).to_bytes(2, "little"))

    def _any(self) -> CanFrame:
        frames = self._genuine.frames
        return frames[int(self._draw.integers(0, len(frames)))]

    def _with_flips(self, data: bytes) -> bytes:
        bits = int.from_bytes(data, "little")
        wanted = self._draw.choice(8 * len(data), self._up_to(FLIPS_MAX - 1) + 1, replace=False)
        for bit in wanted.tolist():
            bits ^= 1 << bit
        return bits.to_bytes(len(data), "little")

    def _up_to(self, most: int) -> int:
        return int(self._draw.integers(0, most + 1))
