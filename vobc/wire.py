"""Frames, telegrams and radio messages to the nouns of the controller, and back."""

from collections.abc import Iterable, Sequence
from typing import Any, Final

from can_dbc.binding import Frame
from can_dbc.brake import BrakeCommand, BrakeStatus
from can_dbc.cab import Desk
from can_dbc.codec import Decoder, Encoder
from can_dbc.diagnostics import EMERGENCIES, HEARTBEATS, NodeState, TcmsStatus
from can_dbc.doors import DoorCommand, DoorStatus
from can_dbc.energy import LineSupply
from can_dbc.nodes import Node
from can_dbc.odometer import Doppler, Imu, Tacho
from can_dbc.rejection import Rejected
from can_dbc.tags import TagReaderHealth
from can_dbc.traction import TractionCommand, TractionStatus
from can_dbc.vobc import VobcMotion, VobcPosition, VobcStatus, VobcTarget
from firmware_py.ports import CanFrame, RadioMessage, SerialChunk
from firmware_py.tag_reader.telegram import TagTelegram, TelegramParser
from vobc.atp.supervision import Cause
from vobc.odometry.sampling import SampleClock
from vobc.vocabulary import (
    NEVER_S,
    Authority,
    CycleInput,
    CycleOutput,
    TachoSample,
    TagReading,
)
from zenoh_config import keys
from zenoh_config.codec import pack, unpack
from zenoh_config.messages import MovementAuthority, PositionReport
from zenoh_config.sequencing import AuthorityGate

HEARD_KINDS: Final[tuple[type[Frame], ...]] = (
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
)
SENT_KINDS: Final[tuple[type[Frame], ...]] = (
    BrakeCommand,
    TractionCommand,
    DoorCommand,
    VobcStatus,
    VobcMotion,
    VobcPosition,
    VobcTarget,
    HEARTBEATS[Node.VOBC],
    EMERGENCIES[Node.VOBC],
)
HEARD_IDS: Final = Decoder(HEARD_KINDS).ids
"""For acceptance filters."""
S_PER_NS: Final = 1e-9
TACHO_SAMPLES_MAX: Final = 64
TAGS_MAX: Final = 32
TELEGRAM_LINE_S: Final = 0.002
"""A telegram of a magnetic tag on the line at 115 200 baud."""
SLIPS_PERIOD: Final = 64
PROTECTION_ERROR: Final = 0xFF01
"""EMCY code of the manufacturer's: the emergency brake is latched; its detail counts the cause."""
PROTECTION_REGISTER: Final = 0x81
CAUSE_NUMBERS: Final = {cause.value: number for number, cause in enumerate(Cause, 1)}


class Inbox:
    """Keeps the latest of every frame with the instant it was heard; freezes them into an image."""

    def __init__(self, radio: "RadioLink") -> None:
        self._decoder = Decoder(HEARD_KINDS)
        self._parser = TelegramParser()
        self._radio = radio
        self._latest: dict[type, tuple[Any, int]] = {}
        self._tachos: list[tuple[Tacho, int]] = []
        self._tacho_clock = SampleClock()
        self._tags: list[tuple[TagTelegram, int]] = []
        self.rejected = 0
        """Frames that were refused: unknown, damaged, stuck or out of order."""
        self.overflowed = 0
        """Samples and tags beyond what one cycle may take; the oldest are given up."""

    @property
    def late_samples(self) -> int:
        """Tacho samples that were too old when they came."""
        return self._tacho_clock.refused

    @property
    def torn_telegrams(self) -> int:
        return sum(self._parser.torn.values())

    def take_frames(self, frames: Iterable[CanFrame]) -> None:
        """What the bus delivered, in its order."""
        decode, latest = self._decoder.decode, self._latest
        for frame in frames:
            if frame.extended or frame.remote or frame.error:
                self.rejected += not frame.error
                continue
            stamp_ns = frame.stamp_ns
            heard = decode(frame.can_id, frame.data, stamp_ns)
            if heard is None:
                continue
            kind = type(heard)
            if kind is Rejected:
                self.rejected += 1
                continue
            if isinstance(heard, Tacho):
                sampled_ns = self._tacho_clock.sampled_ns(stamp_ns, heard.stamp_ms)
                if sampled_ns is None:
                    continue
                stamp_ns = sampled_ns
                self._tachos.append((heard, stamp_ns))
            latest[kind] = (heard, stamp_ns)
        if len(self._tachos) > TACHO_SAMPLES_MAX:
            self.overflowed += len(self._tachos) - TACHO_SAMPLES_MAX
            del self._tachos[:-TACHO_SAMPLES_MAX]

    def take_serial(self, chunks: Iterable[SerialChunk]) -> None:
        """What the tag reader's line delivered; a telegram may be spread over several chunks."""
        for chunk in chunks:
            for heard in self._parser.feed(chunk.data):
                if isinstance(heard, TagTelegram):
                    self._tags.append((heard, chunk.stamp_ns))
        if len(self._tags) > TAGS_MAX:
            self.overflowed += len(self._tags) - TAGS_MAX
            del self._tags[:-TAGS_MAX]

    def image(self, now_ns: int, *, dt_s: float, overruns: int) -> CycleInput:
        """Everything heard up to now, frozen; tacho samples and tags are handed over once."""
        tacho, tacho_age_s = self._aged(Tacho, now_ns)
        doppler, doppler_age_s = self._aged(Doppler, now_ns)
        imu, imu_age_s = self._aged(Imu, now_ns)
        traction, traction_age_s = self._aged(TractionStatus, now_ns)
        brake, brake_age_s = self._aged(BrakeStatus, now_ns)
        doors, doors_age_s = self._aged(DoorStatus, now_ns)
        desk, desk_age_s = self._aged(Desk, now_ns)
        tag_reader, tag_reader_age_s = self._aged(TagReaderHealth, now_ns)
        supply, supply_age_s = self._aged(LineSupply, now_ns)
        load, load_age_s = self._aged(TcmsStatus, now_ns)
        samples = tuple(
            [TachoSample(frame, (now_ns - stamp_ns) * S_PER_NS) for frame, stamp_ns in self._tachos]
        )
        self._tachos = []
        tags: tuple[TagReading, ...] = ()
        if self._tags:
            tags = tuple([_reading(tag, now_ns - stamp_ns) for tag, stamp_ns in self._tags])
            self._tags = []
        return CycleInput(
            now_ns,
            dt_s,
            overruns,
            tacho,
            tacho_age_s,
            samples,
            doppler,
            doppler_age_s,
            imu,
            imu_age_s,
            traction,
            traction_age_s,
            brake,
            brake_age_s,
            doors,
            doors_age_s,
            desk,
            desk_age_s,
            tag_reader,
            tag_reader_age_s,
            supply,
            supply_age_s,
            load,
            load_age_s,
            tags,
            self._radio.authority,
            self._radio.authority_age_s(now_ns),
        )

    def _aged(self, kind: type, now_ns: int) -> tuple[Any, float]:
        heard = self._latest.get(kind)
        if heard is None:
            return None, NEVER_S
        return heard[0], (now_ns - heard[1]) * S_PER_NS


def _reading(telegram: TagTelegram, since_ns: int) -> TagReading:
    age_s = telegram.age_at_sending_s + TELEGRAM_LINE_S + since_ns * S_PER_NS
    return TagReading(telegram.tag_id, telegram.pulses, age_s)


class RadioLink:
    """Position reports out, movement authorities in."""

    def __init__(
        self,
        *,
        line_name: str,
        train: int,
        boot: int,
        max_age_s: float,
        train_length_m: float,
        seen_term: int = 0,
    ) -> None:
        self._train = train
        self._boot = boot
        self._length_m = train_length_m
        self._sequence = 0
        self._gate = AuthorityGate(
            train=train, boot=boot, max_age_ns=round(max_age_s / S_PER_NS), seen_term=seen_term
        )
        self._echo_ns = 0
        self.report_key = keys.report(line_name, train)
        self.subscriptions = (keys.authorities(line_name, train),)
        self.authority: Authority | None = None
        self.refused = 0
        """Radio messages that were not acted on."""

    @property
    def seen_term(self) -> int:
        return self._gate.seen_term

    def authority_age_s(self, now_ns: int) -> float:
        """By this train's clock, since it sent the report that the held authority answers."""
        return NEVER_S if self.authority is None else (now_ns - self._echo_ns) * S_PER_NS

    def take(self, now_ns: int, messages: Iterable[RadioMessage]) -> None:
        """Hold the newest authority that is for this train and in order; count the rest."""
        for message in messages:
            heard = unpack(message.payload)
            if not isinstance(heard, MovementAuthority) or self._gate.check(heard, now_ns):
                self.refused += 1
                continue
            self._echo_ns = heard.echo_stamp_ns
            self.authority = Authority(heard.end_m, heard.term, heard.sequence)

    def report(self, now_ns: int, output: CycleOutput) -> bytes | None:
        """Where the train is for certain; None while it does not know."""
        motion = output.motion
        if motion is None or not motion.localised:
            return None
        self._sequence += 1
        return pack(
            PositionReport(
                train=self._train,
                boot=self._boot,
                sequence=self._sequence,
                stamp_ns=now_ns,
                front_min_m=motion.front_m.low,
                front_max_m=motion.front_m.high,
                rear_min_m=motion.front_m.low - self._length_m,
                speed_mps=motion.speed_mps.best,
                standstill=motion.standstill,
            )
        )


def vital_frames(output: CycleOutput) -> tuple[Frame, Frame]:
    """What brakes and drives the train, brake first."""
    return (
        BrakeCommand(
            service_decel_mps2=output.service_decel_mps2,
            emergency_released=output.emergency_released,
            holding_released=output.holding_released,
        ),
        TractionCommand(
            force_n=output.force_n,
            direction=output.direction,
            traction_permitted=output.traction_permitted,
        ),
    )


def door_frame(output: CycleOutput) -> Frame:
    return DoorCommand(
        enable_left=output.enable_left,
        enable_right=output.enable_right,
        open_left=output.open_left,
        open_right=output.open_right,
    )


def status_frame(output: CycleOutput, *, work_us: float, slips: int) -> Frame:
    motion = output.motion
    return VobcStatus(
        supervision=output.supervision,
        ato_phase=output.ato_phase,
        missing=output.missing,
        localised=motion is not None and motion.localised,
        slip_detected=motion is not None and motion.slip,
        work_us=work_us,
        cycle_slips=slips % SLIPS_PERIOD,
    )


def motion_frames(output: CycleOutput) -> Sequence[Frame]:
    """Speed and position; nothing is said that is not known."""
    motion, ceiling = output.motion, output.ceiling
    if motion is None or ceiling is None:
        return ()
    front_m = motion.front_m
    return (
        VobcMotion(
            speed_mps=motion.speed_mps.best,
            ceiling_mps=ceiling.permitted_mps,
            emergency_mps=ceiling.emergency_mps,
        ),
        VobcPosition(front_m=front_m.best, uncertainty_m=0.5 * (front_m.high - front_m.low)),
    )


def target_frames(output: CycleOutput) -> Sequence[Frame]:
    """What lies ahead; that there is no stop is said with the largest distance on the wire."""
    if output.ceiling is None:
        return ()
    return (
        VobcTarget(
            distance_to_stop_m=output.distance_to_stop_m,
            distance_to_authority_m=output.ceiling.distance_to_authority_m,
        ),
    )


def heartbeat(state: NodeState) -> Frame:
    return HEARTBEATS[Node.VOBC](state)


def emergency_message(cause: str | None) -> Frame:
    """EMCY for a latched emergency brake; None says that it is gone."""
    message = EMERGENCIES[Node.VOBC]
    if cause is None:
        return message(0, 0, 0)
    return message(PROTECTION_ERROR, PROTECTION_REGISTER, CAUSE_NUMBERS.get(cause, 0))


def make_encoder() -> Encoder:
    """Ready for everything that the controller sends, so that no cycle waits for it."""
    return Encoder(SENT_KINDS)
