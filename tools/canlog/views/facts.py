"""What the page says of messages and buses: how to decode them, and how well they did."""

from typing import Any, Final

import numpy as np

from canlog.database import MessageSpec
from canlog.frames import KEY_EXTENDED
from canlog.read import Log
from canlog.shelf import in_pieces
from canlog.stats import gather
from canlog.stats_rows import absent, bus_rows, message_rows, unjudged
from canlog.verdict import REASONS, Judge
from canlog.verdict_codes import JUDGED_BUS, UNCONFIRMED
from canlog.views.packed import KeyGroup

REFUSED_FROM: Final = UNCONFIRMED + 1
"""Codes from this on are those of refused frames."""


def statistics(log: Log) -> dict[str, Any]:
    """The rows of `canlog stats`."""
    found = gather((piece for _, piece in in_pieces(log.frames)), log.bus)
    return {
        "messages": message_rows(found),
        "buses": bus_rows(found),
        "absent": absent(found),
        "not_judged": unjudged(found),
    }


def verdict_codes(log: Log) -> Any:
    """(n,) uint8: what the codec said of each frame; None for a bus that is not this project's."""
    if log.bus.name != JUDGED_BUS:
        return None
    one, codes = Judge(), log.room(len(log), np.uint8)
    for at, piece in in_pieces(log.frames):
        codes[at : at + len(piece)] = one.feed(piece)
        for late in one.late:
            codes[late.row] = late.code
    return codes


def verdict_names() -> dict[str, str]:
    """Code to why a frame was refused, for people."""
    return {str(code): reason.name.lower().replace("_", " ") for code, reason in REASONS.items()}


def message_head(group: KeyGroup, spec: MessageSpec | None, name: str) -> dict[str, Any]:
    """What the page has to know of a message to decode and name it."""
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
                    "name": each.name,
                    "start": each.start,
                    "length": each.length,
                    "big": each.big_endian,
                    "signed": each.signed,
                    "float": each.is_float,
                    "scale": each.scale,
                    "offset": each.offset,
                    "unit": each.unit,
                    "state": each.is_state,
                    "choices": {str(raw): text for raw, text in each.choices.items()},
                    "comment": each.comment,
                    "mux": each.multiplexer,
                    "muxIds": list(each.multiplexer_ids),
                }
                for each in spec.signals
            ],
        }
    return head
