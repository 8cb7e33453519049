"""Received messages, stored and frozen into one image per cycle."""

from collections.abc import Iterable
from typing import Any, Final, TypeVar

from can_dbc.alarms import TrainAlarms
from can_dbc.binding import Frame
from can_dbc.brake import BrakeStatus
from can_dbc.cab import Desk
from can_dbc.codec import Decoder
from can_dbc.diagnostics import TcmsStatus
from can_dbc.doors import DoorStatus
from can_dbc.energy import LineSupply
from can_dbc.odometer import ColdMovement, Doppler, Imu, Tacho
from can_dbc.rejection import Reason, Rejected
from can_dbc.tags import TagReaderHealth
from can_dbc.traction import TractionStatus
from firmware_py.ports import CanFrame, SerialChunk
from firmware_py.tag_reader.telegram import (
    CLOCK_PERIOD_MS,
    HEALTH_PERIOD_S,
    HealthTelegram,
    TagTelegram,
    TelegramParser,
    encode,
)
from vobc.odometry.sampling import OdometerClocks, ReaderClock
from vobc.vocabulary import (
    S_PER_NS,
    CycleInput,
    Received,
    Source,
    TachoSample,
    TagReading,
    cycle_input,
)
from vobc.wire.evidence import SOURCE_KINDS, Evidence
from vobc.wire.radio import RadioLink
from vobc.wire.refusals import Refusals

F = TypeVar("F", bound=Frame)

RECEIVED_KINDS: Final[tuple[type[Frame], ...]] = (
    Tacho,
    Doppler,
    Imu,
    TractionStatus,
    BrakeStatus,
    DoorStatus,
    Desk,
    TagReaderHealth,
    LineSupply,
    TcmsStatus,
    TrainAlarms,
    ColdMovement,
)
RECEIVED_IDS: Final = Decoder(RECEIVED_KINDS).ids
"""Identifiers for acceptance filters."""
ODOMETER_KINDS: Final = (Tacho, Doppler, Imu)
"""Frames whose age counts from the stamp of their sensor."""
ALIVE_COUNTER_BYTE: Final = -3
"""Position of the counter, before the two CRC bytes."""
TACHO_SAMPLES_MAX: Final = 64
TAGS_MAX: Final = 32
TELEGRAM_LINE_S: Final = 0.002
"""Transmission time of a magnetic tag's telegram at 115 200 baud."""
TELEGRAM_LINE_NS: Final = 2_000_000
READER_SILENCE_NS: Final = round(2 * HEALTH_PERIOD_S * 1e9)
"""Silence of the reader after which telegrams may be missing."""


class Inbox:
    """Stores the latest frame of each kind with its time of arrival, and freezes them into an
    image.
    """

    def __init__(self, radio: RadioLink) -> None:
        self._decoder = Decoder(RECEIVED_KINDS)
        self._parser = TelegramParser()
        self._begun_ns = 0
        """Start of reception of the bytes that the parser still holds."""
        self._reader_ns = 0
        """Time of the last telegram of the tag reader."""
        self._gaps = self._jumps = 0
        self._reader_clock = ReaderClock(CLOCK_PERIOD_MS)
        self._tag_gap = False
        self._radio = radio
        self._latest: dict[type, Received[Any]] = {}
        self._frames: dict[type, CanFrame] = {}
        """The frame that carried the newest value of each kind."""
        self._tachos: list[tuple[Tacho, int]] = []
        self._odometer_clocks = OdometerClocks()
        self._tags: list[tuple[TagTelegram, int]] = []
        self._last_tags: list[tuple[TagTelegram, int]] = []
        """Tags of the last image that had any."""
        self.rejected = 0
        """Number of refused frames: unknown, damaged, stuck or out of order."""
        self.refusals = Refusals()
        """Refused frames by identifier and reason."""
        self.overflowed = 0
        """Samples and tags beyond the limit of one cycle. The oldest are discarded."""

    @property
    def late_samples(self) -> int:
        """Odometer samples that were too old on arrival."""
        return self._odometer_clocks.refused

    @property
    def torn_telegrams(self) -> int:
        return sum(self._parser.torn.values())

    def take_frames(self, frames: Iterable[CanFrame]) -> None:
        """Process frames in the order of the bus."""
        decode = self._decoder.decode
        latest, frames_of = self._latest, self._frames
        for frame in frames:
            if frame.extended or frame.remote or frame.error:
                if not frame.error:
                    self._refuse(frame.can_id, Reason.UNKNOWN_ID, "extended or remote frame")
                continue
            stamp_ns = frame.stamp_ns
            heard = decode(frame.can_id, frame.data, stamp_ns)
            if heard is None:
                continue
            kind = type(heard)
            if kind is Rejected:
                assert isinstance(heard, Rejected)
                self._refuse(heard.can_id, heard.reason, f"{heard.detail} [{heard.data.hex(' ')}]")
                continue
            if isinstance(heard, ODOMETER_KINDS):
                counter = frame.data[ALIVE_COUNTER_BYTE]
                sampled_ns = self._odometer_clocks.sampled_ns(heard, stamp_ns, counter)
                if sampled_ns is None:
                    continue
                stamp_ns = sampled_ns
                if isinstance(heard, Tacho):
                    self._tachos.append((heard, stamp_ns))
            latest[kind] = Received(heard, stamp_ns)
            frames_of[kind] = frame
        if len(self._tachos) > TACHO_SAMPLES_MAX:
            self.overflowed += len(self._tachos) - TACHO_SAMPLES_MAX
            del self._tachos[:-TACHO_SAMPLES_MAX]

    def take_serial(self, chunks: Iterable[SerialChunk]) -> None:
        """Process bytes of the tag reader. A telegram may be spread over several chunks.

        A telegram carries its age when its first byte was sent, so its age counts from there. If
        its closing flag is lost, the next opening flag closes it, and that comes much later.
        """
        for chunk in chunks:
            begun_ns = self._begun_ns if self._parser.pending_bytes else chunk.stamp_ns
            for heard in self._parser.feed(chunk.data):
                if isinstance(heard, TagTelegram | HealthTelegram):
                    came_ns = min(chunk.stamp_ns, begun_ns + TELEGRAM_LINE_NS)
                    came_ns -= self._late_ns(came_ns, heard.sent_ms)
                    if isinstance(heard, TagTelegram):
                        self._tags.append((heard, came_ns))
                    self._watch_silence(chunk.stamp_ns)
                begun_ns = chunk.stamp_ns
            self._begun_ns = begun_ns
        if len(self._tags) > TAGS_MAX:
            self.overflowed += len(self._tags) - TAGS_MAX
            self._tag_gap = True
            del self._tags[:-TAGS_MAX]
        if self._parser.gaps != self._gaps:
            self._gaps = self._parser.gaps
            self._tag_gap = True

    def _late_ns(self, came_ns: int, sent_ms: float) -> int:
        """Waiting time of a telegram before it was read. A restarted reader gets a new clock."""
        if self._parser.jumps != self._jumps:
            self._jumps = self._parser.jumps
            self._reader_clock = ReaderClock(CLOCK_PERIOD_MS)
        return self._reader_clock.late_ns(came_ns, sent_ms)

    def _watch_silence(self, stamp_ns: int) -> None:
        """Detect a gap.

        After a long silence the sequence number may have wrapped to the same value.
        """
        if stamp_ns - self._reader_ns > READER_SILENCE_NS:
            self._tag_gap = True
        self._reader_ns = stamp_ns

    def image(self, now_ns: int, *, dt_s: float, overruns: int) -> CycleInput:
        """Freeze all inputs up to now. Tacho samples and tags are passed on only once."""
        samples = tuple(
            [TachoSample(frame, (now_ns - stamp_ns) * S_PER_NS) for frame, stamp_ns in self._tachos]
        )
        self._tachos = []
        tags: tuple[TagReading, ...] = ()
        if self._tags:
            tags = tuple([_reading(tag, now_ns - stamp_ns) for tag, stamp_ns in self._tags])
            self._last_tags, self._tags = self._tags, []
        tag_gap, self._tag_gap = self._tag_gap, False
        return cycle_input(
            now_ns=now_ns,
            dt_s=dt_s,
            overruns=overruns,
            tacho=self._newest(Tacho),
            tacho_samples=samples,
            doppler=self._newest(Doppler),
            imu=self._newest(Imu),
            traction=self._newest(TractionStatus),
            brake=self._newest(BrakeStatus),
            doors=self._newest(DoorStatus),
            desk=self._newest(Desk),
            tag_reader=self._newest(TagReaderHealth),
            supply=self._newest(LineSupply),
            load=self._newest(TcmsStatus),
            tags=tags,
            authority=self._radio.received_authority,
            alarms=self._newest(TrainAlarms),
            cold=self._newest(ColdMovement),
            orders=self._radio.received_orders,
            tag_gap=tag_gap,
        )

    def evidence(self, source: Source, number: int = 0) -> Evidence | None:
        """The last message of a source. None: no message, or the source is the clock.

        Args:
            number: id of the tag, if there were several. 0: the last one.
        """
        if source is Source.AUTHORITY:
            return self._radio.authority_evidence
        if source is Source.ORDERS:
            return self._radio.orders_evidence
        if source is Source.TAG:
            return self._tag_evidence(number)
        kind = SOURCE_KINDS.get(source)
        frame = None if kind is None else self._frames.get(kind)
        if frame is None:
            return None
        return Evidence(source, frame.can_id, bytes(frame.data), frame.stamp_ns)

    def _tag_evidence(self, tag_id: int) -> Evidence | None:
        if not self._last_tags:
            return None
        named = [heard for heard in self._last_tags if heard[0].tag_id == tag_id]
        telegram, stamp_ns = (named or self._last_tags)[-1]
        return Evidence(Source.TAG, telegram.tag_id, encode(telegram), stamp_ns)

    def _refuse(self, can_id: int, reason: Reason, detail: str) -> None:
        self.rejected += 1
        self.refusals.note(can_id, reason.name, detail)

    def _newest(self, kind: type[F]) -> Received[F] | None:
        return self._latest.get(kind)


def _reading(telegram: TagTelegram, since_ns: int) -> TagReading:
    age_s = telegram.age_at_sending_s + TELEGRAM_LINE_S + since_ns * S_PER_NS
    return TagReading(telegram.tag_id, telegram.pulses, age_s)
