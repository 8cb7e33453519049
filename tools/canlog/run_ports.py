"""Finds the control cycle that received or sent each frame, from the record of the controller's
ports.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from canlog.damage import Damages, shown
from canlog.frames import Frames, Ints
from canlog.table import Groups, taken

PORTS_LOG: Final = "ports.log"
CYCLE_TASKS: Final = frozenset({"control", "grant"})
NS_PER_MS: Final = 1_000_000
HEARD_WITHIN_NS: Final = 5 * NS_PER_MS
"""Maximum difference between the stamps of two receivers of one frame."""
SENT_WITHIN_NS: Final = 200 * NS_PER_MS
"""Maximum time that a sent frame may wait for the bus."""
TRIED_MAX: Final = 64
"""Maximum number of frames of one identifier that are compared with one record."""
OFFSET_SAMPLE: Final = 200


@dataclass(frozen=True, slots=True)
class Ports:
    """CAN records of ports.log as columns. Instants are on the controller's clock."""

    start_ns: int
    begin_ns: Ints
    """(c,) begin of each control cycle."""
    at_ns: Ints
    """(k,) stamp of a received frame; for a sent frame, the begin of its cycle."""
    identifier: Any
    """(k,) uint32: CAN identifier of the frame."""
    word: Any
    """(k,) uint64: the data, padded with zeros."""
    cycle: Ints
    """(k,) number of the control cycle."""
    sent: Any
    """(k,) bool: whether the controller sent the frame."""


def read_ports(path: Path, damages: Damages) -> Ports | None:
    """Read ports.log; None if there is none. A torn line is left out and counted."""
    if not path.is_file():
        return None
    start_ns, begins = 0, []
    rows: list[tuple[int, int, int, int, bool]] = []
    begin_ns, in_cycle, virgin = 0, False, True
    with path.open("rb") as lines:
        for number, line in enumerate(lines, 1):
            words = line.split()
            try:
                if words[0] == b"run":
                    begin_ns, in_cycle = int(words[2]), words[1].decode() in CYCLE_TASKS
                    if in_cycle:
                        begins.append(begin_ns)
                elif words[0] == b"rx" and words[1] == b"can":
                    heard = int(words[2]), int(words[3], 16), _word(words[4])
                    # A frame that another task receives feeds the next cycle.
                    rows.append((*heard, len(begins) - in_cycle, False))
                elif words[0] == b"tx" and words[1] == b"can":
                    said = begin_ns, int(words[2], 16), _word(words[3])
                    rows.append((*said, max(len(begins) - 1, 0), True))
                elif words[0] == b"start" and virgin:
                    start_ns, virgin = _told_start_ns(line), False
            except (IndexError, ValueError, OverflowError):
                damages.add("torn line of ports.log", "line", number, shown(line))
    columns = list(zip(*rows, strict=True)) if rows else [(), (), (), (), ()]
    return Ports(
        start_ns,
        np.array(begins, np.int64),
        np.array(columns[0], np.int64),
        np.array(columns[1], np.uint32),
        np.array(columns[2], np.uint64),
        np.array(columns[3], np.int64),
        np.array(columns[4], np.bool_),
    )


def _told_start_ns(line: bytes) -> int:
    told = json.loads(line.removeprefix(b"start "))
    return int(told["told"].get("start_ns", 0)) if isinstance(told, dict) else 0


def _word(text: bytes) -> int:
    if text == b"-":
        return 0
    if b":" in text:
        raise ValueError
    return int.from_bytes(bytes.fromhex(text.decode()).ljust(8, b"\0")[:8], "little")


def offset_ns_of(ports: Ports, frames: Frames) -> int:
    """Return the offset from the controller's instants to stamps of the log.

    It compares the first received frames with all frames of the same identifier and data. The
    result is the most frequent distance, to a millisecond.
    """
    heard = np.flatnonzero(~ports.sent)[:OFFSET_SAMPLE]
    if not len(heard) or not len(frames):
        return 0
    groups, apart = Groups(frames), []
    for at in heard.tolist():
        rows = groups.rows(int(ports.identifier[at]))
        same = taken(frames, rows)[:, :8].copy().view(np.uint64)[:, 0] == ports.word[at]
        apart.append(frames.at_ns[rows[same]] - ports.at_ns[at])
    distances = np.concatenate(apart)
    if not len(distances):
        return 0
    numbers, counts = np.unique(
        np.round(distances / NS_PER_MS).astype(np.int64), return_counts=True
    )
    best = int(numbers[counts.argmax()])
    near = distances[np.abs(distances - best * NS_PER_MS) <= NS_PER_MS]
    offset_ns = int(np.median(near))
    # Stamps of the log may be cut to microseconds; clocks that agree within 2 us are the same.
    return 0 if abs(offset_ns) < 2_000 else offset_ns


def match(ports: Ports, frames: Frames, offset_ns: int) -> Ints:
    """(n,) cycle that each frame of the log fed or came from, -1 for other frames."""
    cycle = np.full(len(frames), -1, np.int64)
    groups = Groups(frames)
    for identifier in np.unique(ports.identifier).tolist():
        rows = groups.rows(identifier)
        words = taken(frames, rows)[:, :8].copy().view(np.uint64)[:, 0]
        at_ns = frames.at_ns[rows]
        order = np.argsort(at_ns, kind="stable")
        rows, words, at_ns = rows[order], words[order], at_ns[order]
        for sent in (False, True):
            mine = np.flatnonzero((ports.identifier == identifier) & (ports.sent == sent))
            if len(mine) and len(rows):
                _match_one(ports, mine, offset_ns, rows, words, at_ns, cycle, sent=sent)
    return cycle


def _match_one(
    ports: Ports,
    mine: Ints,
    offset_ns: int,
    rows: Ints,
    words: Any,
    at_ns: Ints,
    cycle: Ints,
    *,
    sent: bool,
) -> None:
    wanted_ns = ports.at_ns[mine] + offset_ns
    early_ns = wanted_ns - (NS_PER_MS if sent else HEARD_WITHIN_NS)
    late_ns = wanted_ns + (SENT_WITHIN_NS if sent else HEARD_WITHIN_NS)
    first = np.searchsorted(at_ns, early_ns, "left")
    open_ = np.ones(len(mine), np.bool_)
    for step in range(TRIED_MAX):
        at = first + step
        inside = open_ & (at < len(rows))
        inside[inside] &= at_ns[at[inside]] <= late_ns[inside]
        if not inside.any():
            return
        hit = inside.copy()
        hit[inside] &= words[at[inside]] == ports.word[mine[inside]]
        cycle[rows[at[hit]]] = ports.cycle[mine[hit]]
        open_ &= ~hit
