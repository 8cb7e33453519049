"""Statistics as rows of named numbers, for tables, JSON, CSV, JUnit and rules."""

from collections.abc import Mapping
from typing import Any, Final

from can_dbc.rejection import Reason
from canlog.database import MessageSpec
from canlog.frames import BRS, CLASSIC_BYTES, FD, FD_BYTES, FD_LENGTHS, KEY_EXTENDED
from canlog.gaps import Gaps
from canlog.latency import Cyclic, longest_bits, longest_fd_bits, response_ns
from canlog.stats import NS_PER_MS, NS_PER_S, REASSEMBLED, BusStats, MessageStats, Statistics
from canlog.transport.reassembly import carries_parts
from canlog.transport.senders import addresses

COUNTER: Final = (Reason.STUCK_COUNTER, Reason.JUMPED_COUNTER)
TWIN: Final = (Reason.TWIN_MISMATCH, Reason.TWIN_TIMEOUT)
LEAST_GAPS: Final = 3
"""Number of gaps needed to estimate a period that the DBC file does not give."""

MESSAGE_NUMBERS: Final = (
    *("frames", "rate_hz", "load_ratio", "period_ms", "gap_ms_mean", "gap_ms_min", "gap_ms_max"),
    *("gap_ms_p50", "gap_ms_p99", "jitter_ms", "missing", "extra", "gaps", "backwards"),
    *("stale", "stale_ms", "lost", "rejected", "crc_errors", "counter_errors", "twin_errors"),
    *("invalid_values", "wrong_length", "unconfirmed", "short", "undefined", "out_of_range"),
    *("latency_ms", "known"),
)
"""Numbers of a message that rules may name."""
BUS_NUMBERS: Final = (
    *("bus_frames", "bus_load_ratio", "bus_load_ratio_max", "error_frames", "remote_frames"),
    *("fd_frames", "unknown_frames", "bus_backwards", "span_s"),
)
"""Numbers of a bus that rules may name."""
TRANSPORT_NUMBERS: Final = (
    *("messages", "incomplete", "parts", "bytes_min", "bytes_max"),
    *("interval_ms_p50", "interval_ms_max"),
)
"""Numbers of the reassembled messages of a sender that rules may name."""

Row = dict[str, Any]


def message_rows(found: Statistics) -> list[Row]:
    """Return one row per message and channel, by channel and key, with all of MESSAGE_NUMBERS."""
    latencies = {channel: latencies_ms(found, channel) for channel in found.buses}
    ordered = sorted(found.messages.values(), key=lambda one: (one.channel, one.key))
    return [
        _message_row(one, found.buses[one.channel], found, latencies[one.channel].get(one.name))
        for one in ordered
    ]


def _message_row(
    one: MessageStats, bus: BusStats, found: Statistics, latency_ms: float | None
) -> Row:
    gaps = one.gaps
    span_s = bus.span_ns / NS_PER_S
    return {
        "channel": one.channel,
        "id": _id_text(one.key),
        "message": one.name,
        "known": int(one.spec is not None),
        "frames": one.frames,
        "rate_hz": round(one.frames / span_s, 3) if span_s else 0.0,
        "load_ratio": _load_ratio(one, found, span_s),
        **_gap_numbers(gaps),
        **_verdict_numbers(one, judged=found.judged),
        "short": one.short,
        "undefined": one.undefined,
        "out_of_range": sum(signal.out_of_range for signal in one.signals.values()),
        "latency_ms": latency_ms,
    }


def _load_ratio(one: MessageStats, found: Statistics, span_s: float) -> float | None:
    """Return the share of the bus; None for reassembled messages, whose frames count elsewhere."""
    if one.key & REASSEMBLED:
        return None
    return round(one.bits / found.baudrate / span_s, 6) if span_s else 0.0


def transport_rows(found: Statistics) -> list[Row]:
    """Return one row per sender of reassembled messages, with all of TRANSPORT_NUMBERS."""
    rows = []
    for place, one in sorted(found.transport.items()):
        _, key, group = place
        source, destination = addresses(key)
        rows.append(
            {
                "channel": one.channel,
                "id": _id_text(key),
                "message": one.name,
                "protocol": "isotp" if group < 0 else "j1939",
                "pgn": None if group < 0 else group,
                "source": source,
                "destination": destination,
                "messages": one.whole,
                "incomplete": sum(one.incomplete.values()),
                "parts": one.frames,
                "bytes_min": one.shortest if one.whole else None,
                "bytes_max": one.longest if one.whole else None,
                "interval_ms_p50": one.gaps.percentile_us(50) / 1000 if one.gaps.count else None,
                "interval_ms_max": one.gaps.most_ns / NS_PER_MS if one.gaps.count else None,
                "reasons": {why.name.lower(): n for why, n in sorted(one.incomplete.items())},
                "services": dict(sorted(one.services.items())),
            }
        )
    return rows


def _verdict_numbers(one: MessageStats, *, judged: bool) -> Mapping[str, Any]:
    """Return the numbers of the verdicts, None if they cannot be judged; `unjudged` says why."""
    if judged and one.spec is not None:
        refused = one.rejected
        return {
            "lost": one.lost,
            "rejected": sum(refused.values()),
            "crc_errors": refused.get(Reason.WRONG_CRC, 0),
            "counter_errors": sum(refused.get(reason, 0) for reason in COUNTER),
            "twin_errors": sum(refused.get(reason, 0) for reason in TWIN),
            "invalid_values": refused.get(Reason.INVALID_VALUE, 0),
            "wrong_length": refused.get(Reason.WRONG_LENGTH, 0),
            "unconfirmed": one.unconfirmed,
        }
    follower = one.follower
    has_counter = follower is not None and follower.declared.counter is not None
    has_crc = follower is not None and follower.declared.crc is not None
    counter_errors = follower.counter_errors if follower and has_counter else None
    crc_errors = follower.crc_errors if follower and has_crc else None
    told = [each for each in (counter_errors, crc_errors) if each is not None]
    return {
        "lost": follower.lost if follower and has_counter else None,
        "rejected": sum(told) if told else None,
        "crc_errors": crc_errors,
        "counter_errors": counter_errors,
        "twin_errors": None,
        "invalid_values": None,
        "wrong_length": None,
        "unconfirmed": None,
    }


def unjudged(found: Statistics) -> list[Row]:
    """List what could not be judged for each message, and why; by channel, key and item."""
    rows = []
    for one in sorted(found.messages.values(), key=lambda each: (each.channel, each.key)):
        why: dict[str, str] = {}
        if one.spec is None and found.bus.on(one.channel).by_group and carries_parts(one.key):
            # Frames of J1939 transport; each reassembled message is judged by itself.
            continue
        if one.spec is None:
            why["signals, cycle time, counter, CRC"] = "no DBC file defines the identifier"
        else:
            if not one.gaps.period_ns:
                why["missing and extra frames"] = "no cycle time (GenMsgCycleTime)"
            if not one.gaps.timeout_ns:
                why["stale times"] = "neither cycle time nor TimeoutMs or E2ETimeout"
            why |= one.follower.why_not if one.follower is not None else {}
            if one.follower is not None and one.spec.attributes.get("Protection"):
                why["protection"] = "it is judged on this project's own bus only, without --dbc"
        rows += [
            {"channel": one.channel, "message": one.name, "what": what, "why": words}
            for what, words in why.items()
        ]
    return rows


def absent(found: Statistics) -> list[str]:
    """Return cyclic messages of the DBC file of which no channel has a frame.

    Optional messages do not count.
    """
    return [spec.name for spec in _absent(found)]


def absent_count(found: Statistics) -> int | None:
    """Number of absent messages; None if the DBC file requires none, so that none can be absent."""
    return len(_absent(found)) if _due(found) else None


def _due(found: Statistics) -> list[MessageSpec]:
    """Return the messages that must come: cyclic and not optional."""
    buses = (found.bus, *found.bus.by_channel.values())
    specs = {(spec.name, spec.key): spec for bus in buses for spec in bus.by_key.values()}
    return [spec for spec in specs.values() if spec.period_ms and not spec.optional]


def _absent(found: Statistics) -> list[MessageSpec]:
    seen = {one.spec.name for one in found.messages.values() if one.spec is not None}
    return [spec for spec in _due(found) if spec.name not in seen]


def absent_rows(found: Statistics) -> list[Row]:
    """Return a row for each absent message: all its frames are missing, other numbers are
    unknown.
    """
    span_ns = max((bus.span_ns for bus in found.buses.values()), default=0)
    unknown: Row = dict.fromkeys(MESSAGE_NUMBERS)
    none = dict.fromkeys(("frames", "rate_hz", "load_ratio", "extra"), 0)
    return [
        {
            "channel": "log",
            "id": _id_text(spec.key),
            "message": spec.name,
            **unknown,
            **none,
            "known": 1,
            "period_ms": spec.period_ms,
            "missing": max(1, round(span_ns / (spec.period_ms * NS_PER_MS))),
            "gaps": 1,
            "gap_ms_max": round(span_ns / NS_PER_MS, 6),
            "stale": 1,
            "stale_ms": round(max(0.0, span_ns / NS_PER_MS - spec.timeout_ms), 6),
        }
        for spec in _absent(found)
    ]


def _gap_numbers(gaps: Gaps) -> Mapping[str, Any]:
    def ms(ns: float) -> float:
        return round(ns / NS_PER_MS, 6)

    return {
        "period_ms": ms(gaps.period_ns),
        "gap_ms_mean": ms(gaps.mean_ns),
        "gap_ms_min": ms(gaps.least_ns),
        "gap_ms_p50": gaps.percentile_us(50) / 1000,
        "gap_ms_p99": gaps.percentile_us(99) / 1000,
        "gap_ms_max": ms(gaps.most_ns),
        "jitter_ms": ms(gaps.jitter_ns),
        "gaps": gaps.late if gaps.period_ns else None,
        "missing": gaps.missing if gaps.period_ns else None,
        "extra": gaps.extra if gaps.period_ns else None,
        "backwards": gaps.backwards,
        "stale": gaps.stale if gaps.timeout_ns else None,
        "stale_ms": ms(gaps.stale_ns) if gaps.timeout_ns else None,
    }


def bus_rows(found: Statistics) -> list[Row]:
    """Return one row per channel, with all of BUS_NUMBERS."""
    return [
        {
            "channel": one.channel,
            "bus_frames": one.frames,
            "span_s": round(one.span_ns / NS_PER_S, 9),
            "baudrate": found.baudrate,
            "bus_load_ratio": round(one.load_ratio, 6),
            "bus_load_ratio_max": round(one.load_ratio_max, 6),
            "error_frames": one.error_frames,
            "remote_frames": one.remote_frames,
            "fd_frames": one.fd_frames,
            "unknown_frames": one.unknown_frames,
            "bus_backwards": one.backwards,
        }
        for one in found.buses.values()
    ]


def signal_rows(found: Statistics) -> list[Row]:
    """Return the range of each observed signal."""
    rows = []
    for one in sorted(found.messages.values(), key=lambda each: (each.channel, each.key)):
        for name, seen in one.signals.items():
            rows.append(
                {
                    "channel": one.channel,
                    "message": one.name,
                    "signal": name,
                    "unit": seen.spec.unit,
                    "frames": seen.seen,
                    "least": seen.least,
                    "most": seen.most,
                    "minimum": seen.spec.minimum,
                    "maximum": seen.spec.maximum,
                    "out_of_range": seen.out_of_range,
                }
            )
    return rows


def latencies_ms(found: Statistics, channel: str) -> dict[str, float | None]:
    """Worst-case latency of each message of a channel that is sent with a period.

    The period is that of the DBC file, or else the median gap. Messages without a period are left
    out as if they were rare. A frame has the length in the DBC file, or the observed length if that
    is greater.
    """
    bit_ns = NS_PER_S // found.baudrate
    known = sorted(
        (
            one
            for one in found.messages.values()
            if one.channel == channel and not one.key & REASSEMBLED
        ),
        key=lambda one: _priority(one.key),
    )
    messages = []
    for one in known:
        period_ns = one.gaps.period_ns
        if not period_ns and one.gaps.count >= LEAST_GAPS:
            period_ns = one.gaps.percentile_us(50) * 1000
        if period_ns:
            messages.append(Cyclic(one.name, period_ns, _longest_ns(one, found)))
    told = response_ns(messages, bit_ns)
    return {name: None if ns is None else round(ns / NS_PER_MS, 6) for name, ns in told.items()}


def _longest_ns(one: MessageStats, found: Statistics) -> int:
    extended = bool(one.key & KEY_EXTENDED)
    told = one.spec.length if one.spec else 0
    if not (one.fd_flags & FD or (one.spec and one.spec.is_fd)):
        length = max(min(told, CLASSIC_BYTES), one.longest) if one.spec else CLASSIC_BYTES
        return longest_bits(length, extended=extended) * NS_PER_S // found.baudrate
    length = next(each for each in FD_LENGTHS if each >= min(max(told, one.longest), FD_BYTES))
    switched = bool(one.fd_flags & BRS) and not one.slow_fd
    nominal, fast = longest_fd_bits(length, extended=extended, switched=switched)
    return nominal * NS_PER_S // found.baudrate + fast * NS_PER_S // found.data_baudrate


def _priority(key: int) -> tuple[int, int, int]:
    """Sort key of arbitration: the first eleven bits, then 11 bits before 29, then the rest."""
    if key & KEY_EXTENDED:
        wide = key & ~KEY_EXTENDED
        return wide >> 18, 1, wide & 0x3FFFF
    return key, 0, 0


def _id_text(key: int) -> str:
    key &= ~REASSEMBLED
    return f"{key & ~KEY_EXTENDED:08X}" if key & KEY_EXTENDED else f"{key:03X}"
