"""Worst-case response time of every message on a bus: Davis, Burns, Bril, Lukkien 2007.

"Controller Area Network (CAN) schedulability analysis: refuted, revisited and revised", Real-Time
Systems 35, equations 3 to 9. A frame waits for at most one frame of lower priority that has begun,
and for every frame of higher priority. The analysis checks every instance inside the busy period.
It needs only the longest time of each frame, so it also holds for CAN FD.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

ROUNDS_MAX: Final = 100_000
NS_PER_S: Final = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Cyclic:
    """One message of the analysis; messages are listed by falling priority."""

    name: str
    period_ns: int
    longest_ns: int
    """Longest time on the bus, with the maximum number of stuff bits."""
    jitter_ns: int = 0
    """Maximum variation of the queueing time."""


def longest_bits(length: int, *, extended: bool) -> int:
    """Maximum bits of a classic frame with stuff bits and intermission: equations 1 and 2."""
    return (80 if extended else 55) + 10 * length


def longest_fd_bits(length: int, *, extended: bool, switched: bool) -> tuple[int, int]:
    """Maximum bits of a CAN FD frame at the nominal and at the fast rate.

    Frame by ISO 11898-1: up to the end of the data, a stuff bit may follow the first five bits and
    then every fourth. Stuff count and CRC have a fixed one before and after every fourth bit. As
    many stuff bits as possible count at the nominal rate, which is the slower one.

    Args:
        length: data bytes, one of the lengths that a frame can have.
        switched: whether the frame switches to the fast rate after its BRS bit.
    """
    head = 36 if extended else 17
    rest = 5 + 8 * length
    stuffed, slow = (head + rest - 1) // 4, (head - 1) // 4
    checked = 4 + (17 if length <= 16 else 21)
    fixed = -(-checked // 4)
    after = 12
    fast = rest + stuffed - slow + checked + fixed + 1
    return (head + slow + after, fast) if switched else (head + slow + after + fast, 0)


def response_ns(messages: Sequence[Cyclic], bit_ns: int) -> dict[str, int | None]:
    """Worst time from the event that queues a frame to its last bit; None if it is unbounded.

    Args:
        messages: messages of one bus, by falling priority.
        bit_ns: duration of one bit.
    """
    return {
        message.name: _response(messages[:at], message, messages[at + 1 :], bit_ns)
        for at, message in enumerate(messages)
    }


def _response(
    higher: Sequence[Cyclic], message: Cyclic, lower: Sequence[Cyclic], bit_ns: int
) -> int | None:
    blocked_ns = max((each.longest_ns for each in lower), default=0)
    same = [*higher, message]
    load_ratio = sum(each.longest_ns / each.period_ns for each in same)
    if load_ratio > 1.0 or (load_ratio == 1.0 and blocked_ns):
        return None
    busy_ns = _fixed_point(same, blocked_ns, message.longest_ns, slack_ns=0)
    if busy_ns is None:
        return None
    instances = -(-(busy_ns + message.jitter_ns) // message.period_ns)
    worst_ns = 0
    for instance in range(instances):
        begun_ns = blocked_ns + instance * message.longest_ns
        waited_ns = _fixed_point(higher, begun_ns, begun_ns, slack_ns=bit_ns)
        if waited_ns is None:
            return None
        done_ns = waited_ns - instance * message.period_ns + message.longest_ns
        worst_ns = max(worst_ns, message.jitter_ns + done_ns)
    return worst_ns


def _fixed_point(
    messages: Sequence[Cyclic], base_ns: int, start_ns: int, *, slack_ns: int
) -> int | None:
    """Least time in which `base_ns` and all that `messages` queue meanwhile is sent."""
    time_ns = start_ns
    for _ in range(ROUNDS_MAX):
        needed_ns = base_ns + sum(
            -(-(time_ns + each.jitter_ns + slack_ns) // each.period_ns) * each.longest_ns
            for each in messages
        )
        if needed_ns == time_ns:
            return time_ns
        time_ns = needed_ns
    return None
