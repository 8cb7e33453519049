"""Faults of the tag reader's serial line, applied at the reader's end.

Delays and repetitions happen in the reader. Truncation, bit flips, noise and cuts happen on the
line behind it. So a delayed telegram can still be truncated, and one that leaves while the line is
cut is lost. Telegrams that are due between two polls leave at the later one.
"""

from collections import Counter
from collections.abc import Sequence
from typing import Final

import numpy as np

from firmware_py.ports import LinkCounters, SerialChunk, SerialPort
from plant_emulator.faults.acting import (
    NS_PER_S,
    Acting,
    ActingFaults,
    DelayQueue,
    after_ns,
    flipped,
    hits,
)
from plant_emulator.faults.declared_wires import (
    SerialCut,
    SerialNoise,
    TelegramCorrupt,
    TelegramDelay,
    TelegramDuplicate,
    TelegramTorn,
)
from plant_emulator.faults.kinds import FaultPlace
from plant_emulator.faults.plan import FaultPlan

BYTE_NS: Final = 10 * NS_PER_S // 115_200
"""Time of one byte on the line. It gives the place in a telegram at which a byte of noise falls."""


class SerialFaults:
    """A SerialPort that applies faults to the reader's port; each `send` carries one telegram."""

    def __init__(self, port: SerialPort, seed: int) -> None:
        self._port = port
        self._acting = ActingFaults(FaultPlace.SERIAL, seed)
        self._held: DelayQueue[bytes] = DelayQueue()
        self._last_due_ns = 0
        """Latest due instant of all delayed telegrams. The reader sends in order, even after the
        delay has ended."""
        self._noise_ns: dict[int, int] = {}
        """Instant of the next noise byte, by the fault's index."""
        self.done: Counter[str] = Counter()
        """Number of telegrams that each kind affected; for serial_noise, of bytes. Data that
        arrives from the other end while the line is cut counts too."""

    @property
    def counters(self) -> LinkCounters:
        return self._port.counters

    def change(self, plan: FaultPlan, active: bool, now_ns: int) -> None:
        """Start or end a fault of the schedule; faults of other places are ignored."""
        self.poll(now_ns)
        if not self._acting.change(plan, active, now_ns):
            return
        if active and isinstance(plan.parameters, SerialNoise) and plan.parameters.bytes_per_s:
            draws = self._acting.draws_of(plan)
            self._noise_ns[plan.index] = after_ns(now_ns, _gap_s(draws, plan.parameters))
        else:
            self._noise_ns.pop(plan.index, None)

    def poll(self, now_ns: int) -> None:
        """Send the telegrams that are due; call it in every step."""
        for _, telegram in self._held.due(now_ns):
            self._leave(now_ns, telegram)
        if self._noise_ns:
            noise = self._noise_until(now_ns)
            if noise:
                self._put(now_ns, bytes(byte for _, byte in noise))

    def send(self, now_ns: int, data: bytes) -> None:
        if not self._acting and not self._held:
            self._port.send(now_ns, data)
            return
        self.poll(now_ns)
        due_ns = now_ns
        for acting, late in self._acting.of(TelegramDelay):
            self._count(acting, changed=late.delay_s > 0.0)
            due_ns = after_ns(due_ns, late.delay_s)
        due_ns = max(due_ns, self._last_due_ns)
        if due_ns > now_ns:
            self._last_due_ns = due_ns
        self._say(now_ns, due_ns, data)
        for acting, again in self._acting.of(TelegramDuplicate):
            self._count(acting)
            self._say(now_ns, after_ns(due_ns, again.gap_s), data)

    def receive(self, now_ns: int) -> Sequence[SerialChunk]:
        chunks = self._port.receive(now_ns)
        for acting, _ in self._acting.of(SerialCut):
            self._count(acting, len(chunks), changed=bool(chunks))
            return ()
        return chunks

    def close(self) -> None:
        self._port.close()

    @property
    def touched(self) -> Counter[int]:
        """Number of telegrams or bytes that each fault changed, by the fault's index."""
        return self._acting.touched

    @property
    def held(self) -> int:
        """Number of delayed telegrams."""
        return len(self._held)

    def _count(self, acting: Acting, number: int = 1, *, changed: bool = True) -> None:
        """Count telegrams or bytes that a fault affected, and whether the fault changed
        anything.
        """
        self.done[acting.name] += number
        self._acting.touched[acting.plan.index] += number if changed else 0

    def _say(self, now_ns: int, due_ns: int, data: bytes) -> None:
        if due_ns <= now_ns:
            self._leave(now_ns, data)
        else:
            self._held.hold(due_ns, data)

    def _leave(self, now_ns: int, data: bytes) -> None:
        for acting, torn in self._acting.of(TelegramTorn):
            if hits(acting.draws, torn.share_ratio):
                self._count(acting)
                data = _torn(data, acting)
        for acting, corrupt in self._acting.of(TelegramCorrupt):
            if data and hits(acting.draws, corrupt.share_ratio):
                self._count(acting)
                data = flipped(data, corrupt.bits, acting.draws)
        if self._noise_ns:
            data = self._strewn(now_ns, data)
        self._put(now_ns, data)

    def _put(self, now_ns: int, data: bytes) -> None:
        for acting, _ in self._acting.of(SerialCut):
            self._count(acting)
            return
        if data:
            self._port.send(now_ns, data)

    def _strewn(self, now_ns: int, data: bytes) -> bytes:
        """Return the telegram with the noise that falls between its bytes."""
        noise = self._noise_until(now_ns + BYTE_NS * len(data))
        mixed = bytearray(data)
        for at_ns, byte in reversed(noise):
            place = max(0, min(len(data), (at_ns - now_ns) // BYTE_NS))
            mixed.insert(place, byte)
        return bytes(mixed)

    def _noise_until(self, now_ns: int) -> list[tuple[int, int]]:
        found: list[tuple[int, int]] = []
        for acting, noise in self._acting.of(SerialNoise):
            at_ns = self._noise_ns.get(acting.plan.index)
            while at_ns is not None and at_ns <= now_ns:
                found.append((at_ns, int(acting.draws.integers(256))))
                self._count(acting)
                at_ns = after_ns(at_ns, _gap_s(acting.draws, noise))
                self._noise_ns[acting.plan.index] = at_ns
        return sorted(found)


def _torn(data: bytes, acting: Acting) -> bytes:
    """Cut off at least the last byte; the first remains unless it is the only one."""
    return data[: int(acting.draws.integers(1, len(data)))] if len(data) > 1 else b""


def _gap_s(draws: np.random.Generator, noise: SerialNoise) -> float:
    """Sample the time between two noise bytes from an exponential distribution."""
    return float(draws.exponential(1.0 / noise.bytes_per_s))
