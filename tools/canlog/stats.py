"""Statistics of a log, gathered block by block: of each message, its signals, and the bus."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from can_dbc.rejection import Reason
from canlog.bits import frame_bits
from canlog.database import Bus, MessageSpec, SignalSpec
from canlog.declared import Follower
from canlog.frames import BRS, ERROR, FD, REMOTE, Frames, Ints
from canlog.gaps import Gaps
from canlog.plan import DecodingPlan, Payloads, physical_of, signed_raw
from canlog.table import Groups, table_of
from canlog.transport.counts import TransportStats, sender_stats
from canlog.transport.messages import Messages, TransportStatus
from canlog.transport.reassembly import Reassembler, is_part, options_for
from canlog.transport.senders import PRIORITY, by_sender, message_key
from canlog.verdict import CODES, REASONS, Judge
from canlog.verdict_codes import JUDGED_BUS, UNCONFIRMED

NS_PER_MS: Final = 1_000_000
NS_PER_S: Final = 1_000_000_000
REASSEMBLED: Final = 1 << 32
"""Added to the key of a message that is reassembled from several frames."""
WINDOW_NS: Final = 100 * NS_PER_MS
"""Window over which the peak bus load is measured: 100 ms."""


@dataclass(slots=True)
class SignalRange:
    """Observed range of one signal."""

    spec: SignalSpec
    least: Any = None
    most: Any = None
    seen: int = 0
    out_of_range: int = 0
    """Number of frames with a value outside the minimum and maximum of the DBC file."""

    def feed(self, values: Any) -> None:
        if values.dtype.kind == "f":
            values = values[~np.isnan(values)]
        if not len(values):
            return
        least, most = values.min().item(), values.max().item()
        self.seen += len(values)
        self.least = least if self.least is None else min(self.least, least)
        self.most = most if self.most is None else max(self.most, most)
        low, high = self.spec.minimum, self.spec.maximum
        if low is None or high is None or (low == 0 and high == 0):
            return
        # Rounding may put a value at the end of the range slightly beyond it.
        slack = 1e-9 * max(abs(low), abs(high))
        if least < low - slack or most > high + slack:
            outside = (values < low - slack) | (values > high + slack)
            self.out_of_range += int(outside.sum())


@dataclass(slots=True)
class MessageStats:
    """Statistics of one message, or one unknown identifier, on one channel."""

    channel: str
    key: int
    """Key of its frames; REASSEMBLED is added if it consists of several."""
    name: str
    spec: MessageSpec | None
    gaps: Gaps
    frames: int = 0
    bits: int = 0
    short: int = 0
    """Number of frames that are too short for the message."""
    undefined: int = 0
    """Number of frames with a multiplexer value that the DBC file does not define."""
    rejected: dict[Reason, int] = field(default_factory=dict)
    unconfirmed: int = 0
    lost: int = 0
    """Number of frames that never came, according to the alive counter."""
    signals: dict[str, SignalRange] = field(default_factory=dict)
    plan: DecodingPlan | None = None
    follower: Follower | None = None
    """Checks declared counters and CRCs on a bus that this project's codec does not judge."""
    fd_flags: int = 0
    """FD if any frame was an FD frame, BRS if any switched to the fast rate."""
    slow_fd: bool = False
    """Whether any FD frame stayed at the nominal rate."""
    longest: int = 0
    """Data bytes of the longest frame."""


@dataclass(slots=True)
class BusStats:
    """Statistics of one channel."""

    channel: str
    frames: int = 0
    data_frames: int = 0
    error_frames: int = 0
    remote_frames: int = 0
    fd_frames: int = 0
    unknown_frames: int = 0
    backwards: int = 0
    """Number of stamps that are earlier than the one before."""
    first_ns: int | None = None
    last_ns: int = 0
    busy_ns: int = 0
    """Time for which frames occupied the bus, stuff bits and intermissions included."""
    window: int = -1
    window_busy_ns: int = 0
    peak_busy_ns: int = 0
    """Busy time in the fullest WINDOW_NS."""

    @property
    def span_ns(self) -> int:
        return self.last_ns - self.first_ns if self.first_ns is not None else 0

    @property
    def load_ratio(self) -> float:
        return self.busy_ns / self.span_ns if self.span_ns else 0.0

    @property
    def load_ratio_max(self) -> float:
        return self.peak_busy_ns / WINDOW_NS


class Statistics:
    """Statistics of a log: feed it blocks of frames, then read `messages` and `buses`."""

    def __init__(self, bus: Bus, *, baudrate: int = 0, data_baudrate: int = 0) -> None:
        """Set the bit rates.

        Args:
            baudrate: bits per second; 0 takes that of the DBC file.
            data_baudrate: bits per second of the fast part of FD frames; 0 takes that of the DBC
                file, else `baudrate`.
        """
        self.bus = bus
        self.baudrate = baudrate or bus.baudrate
        self.data_baudrate = data_baudrate or bus.data_baudrate or self.baudrate
        self.messages: dict[tuple[str, int], MessageStats] = {}
        self.buses: dict[str, BusStats] = {}
        self.transport: dict[tuple[str, int, int], TransportStats] = {}
        """Reassembled messages by channel, key and parameter group."""
        self._reassembler = Reassembler(options_for(bus))
        self._judge = Judge() if bus.name == JUDGED_BUS else None

    @property
    def judged(self) -> bool:
        """Whether this project's codec judges the frames."""
        return self._judge is not None

    def feed(self, frames: Frames) -> None:
        """Add the next block of the log."""
        if not len(frames):
            return
        groups = Groups(frames)
        nominal, fast = frame_bits(frames)
        self._feed_buses(frames, nominal, fast)
        code = self._judge.feed(frames, groups) if self._judge else None
        self._late()
        for key, channel in groups.places:
            self._feed_message(channel, key, groups, nominal, fast, code)
        if any(map(is_part, groups.keys)):
            self._feed_transport(self._reassembler.feed(frames))

    def _feed_buses(self, frames: Frames, nominal: Any, fast: Any) -> None:
        for number, channel in enumerate(frames.channels):
            one = self.buses.setdefault(channel, BusStats(channel))
            if len(frames.channels) == 1:
                _feed_bus(one, frames, self._busy_ns(nominal, fast))
                continue
            mine = np.flatnonzero(frames.channel == number)
            if len(mine):
                _feed_bus(one, frames[mine], self._busy_ns(nominal[mine], fast[mine]))

    def _busy_ns(self, nominal: Any, fast: Any) -> Ints:
        busy: Ints = nominal * NS_PER_S // self.baudrate
        if fast.any():
            busy = busy + fast * NS_PER_S // self.data_baudrate
        return busy

    def _message(self, channel: str, key: int) -> MessageStats:
        found = self.messages.get((channel, key))
        if found is None:
            bus = self.bus.on(channel)
            spec = bus.spec_at(key & ~REASSEMBLED)
            gaps = Gaps(
                spec.period_ms * NS_PER_MS if spec else 0,
                spec.timeout_ms * NS_PER_MS if spec else 0,
            )
            found = MessageStats(channel, key, bus.name_of(key & ~REASSEMBLED), spec, gaps)
            if spec is not None:
                found.plan = DecodingPlan(spec)
                found.follower = None if self.judged else Follower(spec, found.plan)
                found.signals = {each.name: SignalRange(each) for each in spec.signals}
            self.messages[channel, key] = found
        return found

    def _feed_message(
        self,
        channel: str,
        key: int,
        groups: Groups,
        nominal: Any,
        fast: Any,
        code: Any,
    ) -> None:
        one, frames = self._message(channel, key), groups.frames
        rows = groups.rows(key, channel=channel)
        one.frames += len(rows)
        one.bits += int(nominal[rows].sum()) + int(fast[rows].sum())
        at_ns = groups.at_ns(key, channel=channel)
        one.gaps.feed(at_ns)
        _feed_lengths(one, frames.flags[rows], frames.length[rows])
        if code is not None:
            counts = np.bincount(code[rows], minlength=len(CODES) + 3)
            one.unconfirmed += int(counts[UNCONFIRMED])
            for reason, number in CODES.items():
                if counts[number]:
                    one.rejected[reason] = one.rejected.get(reason, 0) + int(counts[number])
        if one.plan is None or one.spec is None:
            self.buses[channel].unknown_frames += len(rows)
            return
        _feed_values(one, groups.payloads(key, channel=channel), at_ns)

    def _feed_transport(self, parts: Sequence[Messages]) -> None:
        for found in parts:
            for place, rows in by_sender(found):
                one = self.transport.get(place)
                if one is None:
                    one = self.transport[place] = sender_stats(self.bus, *place)
                one.feed(found, rows)
                whole = rows[found.status[rows] == TransportStatus.WHOLE]
                if one.spec is not None and len(whole):
                    frames = np.diff(found.row_ends, prepend=0)[whole]
                    self.buses[one.channel].unknown_frames -= int(frames.sum())
                    self._feed_reassembled(one, found, whole)

    def _feed_reassembled(self, sender: TransportStats, found: Messages, rows: Ints) -> None:
        """Add whole messages that a DBC file defines to the statistics of that message."""
        assert sender.spec is not None
        key = message_key(sender.group, sender.key, sender.spec.key & PRIORITY)
        one = self._message(sender.channel, REASSEMBLED | key)
        one.frames += len(rows)
        at_ns = found.at_ns[rows]
        one.gaps.feed(at_ns)
        data = [found.payload(at) for at in rows.tolist()]
        _feed_values(one, table_of(sender.spec, data).payloads, at_ns)

    def _late(self) -> None:
        """Correct the verdicts of pair halves in earlier blocks, which the last block has
        decided.
        """
        for late in self._judge.late if self._judge is not None else ():
            one = self.messages[late.channel, late.can_id]
            one.unconfirmed -= 1
            reason = REASONS.get(late.code)
            if reason is not None:
                one.rejected[reason] = one.rejected.get(reason, 0) + 1

    def finish(self) -> None:
        """Finish after the last block: count lost frames, and messages that ended before the
        log.
        """
        self._feed_transport(self._reassembler.finish())
        for (channel, key), one in self.messages.items():
            one.gaps.finish(self.buses[channel].last_ns)
            if self._judge is not None:
                one.lost = self._judge.lost.get(key, 0)
        for sender in self.transport.values():
            sender.gaps.finish(self.buses[sender.channel].last_ns)


def gather(blocks: Iterable[Frames], bus: Bus, **rates: int) -> Statistics:
    """Gather the statistics of a whole log. `rates` are the bit rates of Statistics."""
    found = Statistics(bus, **rates)
    for block in blocks:
        found.feed(block)
    found.finish()
    return found


def _feed_values(one: MessageStats, payloads: Payloads, at_ns: Ints) -> None:
    assert one.spec is not None
    assert one.plan is not None
    if payloads.shortest < one.spec.length:
        one.short += int((payloads.length < one.spec.length).sum())
    if one.follower is not None:
        one.follower.feed(payloads, at_ns)
    undefined = one.plan.undefined(payloads)
    one.undefined += int(undefined.sum()) if undefined is not None else 0
    for name, seen in one.signals.items():
        _feed_range(one.plan, name, seen, payloads)


def _feed_lengths(one: MessageStats, flags: Any, length: Any) -> None:
    one.longest = max(one.longest, int(length.max()))
    seen = int(np.bitwise_or.reduce(flags)) & (FD | BRS)
    one.fd_flags |= seen
    if seen & FD and not one.slow_fd:
        one.slow_fd = bool((flags & np.uint8(FD | BRS) == FD).any())


def _feed_bus(one: BusStats, frames: Frames, busy_ns: Ints) -> None:
    at_ns = frames.at_ns
    one.frames += len(frames)
    one.error_frames += int(((frames.flags & ERROR) != 0).sum())
    one.remote_frames += int(((frames.flags & REMOTE) != 0).sum())
    one.fd_frames += int(((frames.flags & FD) != 0).sum())
    one.data_frames += int(frames.is_data.sum())
    before = one.last_ns if one.first_ns is not None else int(at_ns[0])
    one.backwards += int((np.diff(at_ns, prepend=before) < 0).sum())
    one.first_ns = min(int(at_ns.min()), before if one.first_ns is None else one.first_ns)
    one.last_ns = max(int(at_ns.max()), one.last_ns)
    one.busy_ns += int(busy_ns.sum())
    _feed_windows(one, at_ns // WINDOW_NS, busy_ns)


def _feed_windows(one: BusStats, window: Ints, busy_ns: Ints) -> None:
    """Update the load of each window; the last window may continue in the next block."""
    cuts = np.flatnonzero(np.diff(window)) + 1
    starts = np.concatenate([[0], cuts])
    sums = np.add.reduceat(busy_ns, starts)
    numbers = window[starts]
    if int(numbers[0]) == one.window:
        sums[0] += one.window_busy_ns
    one.window, one.window_busy_ns = int(numbers[-1]), int(sums[-1])
    one.peak_busy_ns = max(one.peak_busy_ns, int(sums.max()))


def _feed_range(plan: DecodingPlan, name: str, seen: SignalRange, payloads: Payloads) -> None:
    raw = plan.raw(name, payloads)
    valid = plan.valid(name, payloads)
    if valid is not None:
        raw = raw[valid]
    spec = plan.cuts[name].spec
    if spec.is_float or not len(raw):
        seen.feed(physical_of(spec, raw))
        return
    # Scaling keeps or reverses the order, so the extremes of raw and physical values coincide.
    signed = signed_raw(spec, raw)
    ends = np.array([signed.min(), signed.max()]).view(np.uint64)
    values = physical_of(spec, ends)
    low, high = spec.minimum, spec.maximum
    within = low is None or high is None or (values.min() >= low and values.max() <= high)
    if within or (low == 0 and high == 0):
        seen.feed(values)
        seen.seen += len(raw) - len(values)
    else:
        seen.feed(physical_of(spec, raw))
