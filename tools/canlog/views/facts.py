"""Facts about messages and buses for the page: how to decode them, and their statistics."""

from typing import Any, Final

import numpy as np

from canlog.database import MessageSpec, SignalSpec
from canlog.frames import KEY_EXTENDED
from canlog.reader import Log
from canlog.shelf import in_pieces
from canlog.stats import gather
from canlog.stats_rows import absent, bus_rows, message_rows, unjudged
from canlog.verdict import REASONS, Judge
from canlog.verdict_codes import JUDGED_BUS, UNCONFIRMED
from canlog.views.packed import KeyGroup

REFUSED_FROM: Final = UNCONFIRMED + 1
"""Lowest code of a rejected frame."""


def statistics(log: Log) -> dict[str, Any]:
    """Return the rows of `canlog stats`."""
    found = gather((piece for _, piece in in_pieces(log.frames)), log.bus)
    return {
        "messages": message_rows(found),
        "buses": bus_rows(found),
        "absent": absent(found),
        "not_judged": unjudged(found),
    }


def verdict_codes(log: Log) -> Any:
    """(n,) uint8: the codec's verdict on each frame; None for another bus than this project's."""
    if log.bus.name != JUDGED_BUS:
        return None
    one, codes = Judge(), log.room(len(log), np.uint8)
    for at, piece in in_pieces(log.frames):
        codes[at : at + len(piece)] = one.feed(piece)
        for late in one.late:
            codes[late.row] = late.code
    return codes


def verdict_names() -> dict[str, str]:
    """Return the reason of rejection for each code, as text for people."""
    return {str(code): reason.name.lower().replace("_", " ") for code, reason in REASONS.items()}


def message_head(group: KeyGroup, spec: MessageSpec | None, name: str) -> dict[str, Any]:
    """Return what the page needs to decode and name a message."""
    head: dict[str, Any] = {
        "id": group.key & ~KEY_EXTENDED,
        "extended": bool(group.key & KEY_EXTENDED),
        "kind": group.flags,
        "name": name,
        "known": spec is not None and not group.flags,
        "count": len(group.rows),
        "period": 0,
        "signals": [],
    }
    if spec is not None and not group.flags:
        head |= {
            "senders": list(spec.senders),
            "comment": spec.comment,
            "timeout": spec.timeout_ms,
            "period": spec.period_ms,
            "signals": [
                {
                    **_bits(each),
                    "name": each.name,
                    "unit": each.unit,
                    "state": each.is_state,
                    "choices": {str(raw): text for raw, text in each.choices.items()},
                    "comment": each.comment,
                    "others": [_bits(other) for other in each.others],
                }
                for each in spec.signals
            ],
        }
    return head


def _bits(signal: SignalSpec) -> dict[str, Any]:
    """Return where a signal is in one page of the multiplexer, and how to decode it there."""
    return {
        "start": signal.start,
        "length": signal.length,
        "big": signal.big_endian,
        "signed": signal.signed,
        "float": signal.is_float,
        "scale": signal.scale,
        "offset": signal.offset,
        "mux": signal.multiplexer,
        "muxIds": list(signal.multiplexer_ids),
    }
