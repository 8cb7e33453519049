"""What the page says of each message beside its frames: how many, how regular, of which range."""

from typing import Any, Final

import numpy as np

from metro_tools.canlog.database import MessageSpec
from metro_tools.canlog.frames import KEY_EXTENDED, Ints
from metro_tools.canlog.read import Log
from metro_tools.canlog.run import NS_PER_S
from metro_tools.canlog.views.packed import Group
from metro_tools.canlog.views.traces import NS_PER_MS

LATE_RATIO: Final = 1.5
"""A gap longer than so many periods counts as a missing frame."""
DIGITS: Final = 4


def message_facts(log: Log, group: Group, at_ns: Ints) -> dict[str, Any]:
    """Counts, gaps in milliseconds, and frames that the period asks for and the log lacks."""
    spec = log.bus.by_key.get(group.key) if not group.flags else None
    gaps_ms = np.diff(at_ns) / NS_PER_MS
    period_ms = spec.period_ms if spec is not None else 0
    facts: dict[str, Any] = {"count": len(at_ns), "gap": None, "missing": None, "period": period_ms}
    if len(gaps_ms):
        span_s = float(at_ns[-1] - at_ns[0]) / NS_PER_S
        low, middle, high = np.percentile(gaps_ms, (1, 50, 99))
        facts["rate"] = round(len(gaps_ms) / span_s, DIGITS) if span_s > 0 else None
        facts["gap"] = [
            round(float(each), DIGITS) for each in (gaps_ms.min(), low, middle, high, gaps_ms.max())
        ]
        if period_ms:
            late = gaps_ms[gaps_ms > LATE_RATIO * period_ms]
            facts["missing"] = int(np.sum(np.rint(late / period_ms) - 1))
    return facts


def message_head(group: Group, spec: MessageSpec | None, name: str) -> dict[str, Any]:
    """What the page has to know of a message to decode and name it."""
    head: dict[str, Any] = {
        "id": group.key & ~KEY_EXTENDED,
        "extended": bool(group.key & KEY_EXTENDED),
        "kind": group.flags,
        "name": name,
        "known": spec is not None and not group.flags,
        "signals": [],
    }
    if spec is not None and not group.flags:
        head |= {
            "senders": list(spec.senders),
            "comment": spec.comment,
            "timeout": spec.timeout_ms,
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
                    "choices": {str(raw): text for raw, text in each.choices.items()},
                    "comment": each.comment,
                    "mux": each.multiplexer,
                    "muxIds": list(each.multiplexer_ids),
                }
                for each in spec.signals
            ],
        }
    return head
