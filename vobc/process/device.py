"""The controller as a device: input image, step and output image in the period of its task
table.
"""

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from can_dbc.binding import Frame
from can_dbc.diagnostics import NodeState
from can_dbc.vobc import EventKind, Supervision
from firmware_py.clock.executive import Executive, Task
from firmware_py.ports import CanPort, RadioPort, SerialPort
from firmware_py.storage.nvram import Nvram
from firmware_py.trackdb import LineMap
from vobc.atp import ProtectionVerdict
from vobc.atp.change_ends import OtherPath, hand_over
from vobc.config import VobcConfig
from vobc.controller import Controller
from vobc.events import controller_ends, events_between, memory_foreign, memory_lost
from vobc.plausible import check_plausible
from vobc.process.cycle_log import CycleLog, cycle_row
from vobc.process.event_log import EventLog, EventQueue
from vobc.process.identity import identity_of
from vobc.process.start import commissioned_start
from vobc.vocabulary import (
    SAFE_OUTPUT,
    CycleInput,
    CycleOutput,
    Event,
    Mission,
    OdometryRecord,
    PlaceProof,
)
from vobc.wire import (
    SOURCE_IDS,
    Inbox,
    RadioLink,
    Refusal,
    analogue_frame,
    door_cars_frame,
    door_frame,
    emergency_message,
    heartbeat,
    limit_frames,
    make_encoder,
    mode_frame,
    motion_frames,
    status_frame,
    target_frames,
    vital_frames,
)
from zenoh_config.codec import BENCH_KEY

if TYPE_CHECKING:
    # Only a train that commands itself needs this module, and the controllers of others with it.
    from vobc.process.line_command import LineCommand

VITAL_MS: Final = 50.0
"""Period in which the units expect vital commands, whatever the cycle."""
DOOR_MS: Final = 100.0
MOTION_MS: Final = 100.0
TARGET_MS: Final = 200.0
LIFE_SIGN_MS: Final = 1000.0
BEAT_MS: Final = 10.0
"""Period of the answers of train-to-train control between control cycles."""
STALE_CYCLES: Final = 2
NS_PER_MS: Final = 1_000_000
NS_PER_S: Final = 1_000_000_000
NS_PER_US: Final = 1_000
NAMES: Final = {can_id: source.value for source, can_id in SOURCE_IDS.items()}
"""Names of the received frames, by identifier."""


class VobcDevice:
    """One train's controller on its wires. Run `executive`, and call `stop` at the end."""

    def __init__(
        self,
        config: VobcConfig,
        line: LineMap,
        mission: Mission,
        *,
        can: CanPort,
        tags: SerialPort,
        radio: RadioPort,
        nvram: Nvram,
        cycle_log: CycleLog | None,
        start_ns: int,
        start: OdometryRecord | None = None,
        event_log: EventLog | None = None,
        forgotten: bool = False,
        command: "LineCommand | None" = None,
    ) -> None:
        """Count this start in `nvram`. The count is on the disk before the first radio message.

        Raises SettingsError for parameters that do not fit the line, see `check_plausible`.

        Args:
            command: train-to-train control. Authorities then come only from it.
            start: place of the train; by default the start of its mission.
            forgotten: the memory of the board is unreadable. This is reported as the first event.
        """
        check_plausible(config, line)
        self._config = config
        self._can, self._tags, self._radio, self._nvram = can, tags, radio, nvram
        self._log, self._command, self._identity = cycle_log, command, identity_of(config, line)
        foreign = self._identity.foreign(nvram.record)
        record = self._identity.own(nvram.record)
        record = replace(record, boot_count=record.boot_count + 1, standing=False)
        nvram.put(record)
        self._link = RadioLink(
            line_name=line.name,
            train=config.address,
            boot=record.boot_count,
            max_age_s=config.atp.authority_age_max_s,
            train_length_m=config.train.length_m,
            database=self._identity.database,
            parameters=self._identity.parameters,
            seen_term=record.highest_term,
            key=BENCH_KEY if command is None else command.radio.key,
        )
        self._inbox = Inbox(self._link)
        self._encoder = make_encoder()
        self._by_loop = config.ato.output.stage == "current_loop"
        start = start or commissioned_start(config, line, mission, record)
        self._controller = Controller(config, line, mission, start)
        self._start_ns = start_ns
        self._cycle_ns = round(config.cycle_ms * NS_PER_MS)
        self._last_ns: int | None = None
        self._sent_ns = start_ns
        self._cycles = self._slips = 0
        self._cars_enabled = False
        """The last DOOR_CARS that was sent enabled a car."""
        self._stored = True
        self._seen: CycleInput | None = None
        self._seen_before: CycleInput | None = None
        self._output_before: CycleOutput | None = None
        self._events = EventQueue(event_log, self._inbox.evidence, start_ns)
        self._report_memory(start_ns, foreign, forgotten=forgotten)
        self._emergency = False
        self._life = NodeState.BOOT_UP
        self.output: CycleOutput = SAFE_OUTPUT
        """Output of the last cycle."""
        self.executive = Executive(self._tasks(), start_ns)

    def _tasks(self) -> Iterable[Task]:
        config = self._config
        yield Task("control", config.cycle_ms, self.control_cycle, budget_ms=config.cycle_ms / 2.0)
        if config.cycle_ms > VITAL_MS:
            yield Task("repeat", VITAL_MS, self.repeat_vital, budget_ms=VITAL_MS / 2.0)
        yield Task("report", config.report_ms, self.report_position, offset_ms=1.0)
        if self._command is not None:
            yield Task("line", BEAT_MS, self.line_beat, offset_ms=3.0)
        yield Task("life_sign", LIFE_SIGN_MS, self.life_sign, offset_ms=2.0)

    def _report_memory(self, now_ns: int, foreign: str, *, forgotten: bool) -> None:
        if forgotten:
            self._events.tell(now_ns, (memory_lost(),))
        if foreign:
            self._events.tell(now_ns, (memory_foreign(foreign),))

    @property
    def verdict(self) -> ProtectionVerdict | None:
        """Verdict of protection in the last cycle."""
        return self._controller.verdict

    def hand_over(self, path: OtherPath) -> OdometryRecord:
        """Place for the controller of the other path, as protection lets it go over."""
        motion = self.output.motion
        return hand_over(
            self._controller.record(),
            path,
            train_length_m=self._config.train.length_m,
            standstill=motion is not None and motion.standstill,
            emergency=self.output.supervision is Supervision.EMERGENCY,
            width_m_max=self._config.odometry.localisation_limit_m,
        )

    @property
    def slips(self) -> int:
        """Cycles missed since start."""
        return self._slips

    @property
    def refused(self) -> dict[str, int]:
        """Number of refused inputs, by their wire."""
        return {
            "frames": self._inbox.rejected,
            "telegrams": self._inbox.torn_telegrams,
            "radio": self._link.refused,
            "tags": self._controller.rejected_tags,
            "overflow": self._inbox.overflowed,
        }

    def control_cycle(self, now_ns: int) -> None:
        """Read all inputs, decide once, write all outputs. If anything fails, send the safe
        output.
        """
        overruns = self.executive.slips_before("control")
        try:
            output = self._decide(now_ns, overruns)
            self._send_cycle(now_ns, output)
            if self._command is not None:
                self._command.send(now_ns)
            self._tell(now_ns, output)
        except Exception:
            self.stop(now_ns)
            raise
        self.output = output
        self._remember(output)
        self._write_log(now_ns, output)

    def _decide(self, now_ns: int, overruns: int) -> CycleOutput:
        inbox = self._inbox
        inbox.take_frames(self._can.receive(now_ns))
        inbox.take_serial(self._tags.receive(now_ns))
        self._link.take(now_ns, self._radio.receive(now_ns))
        if self._command is not None:
            self._obey(now_ns, self._command)
        last_ns = now_ns - self._cycle_ns if self._last_ns is None else self._last_ns
        self._last_ns = now_ns
        self._slips += overruns
        image = inbox.image(now_ns, dt_s=(now_ns - last_ns) / NS_PER_S, overruns=overruns)
        self._seen_before, self._seen = self._seen, image
        return self._controller.step(image)

    def _obey(self, now_ns: int, command: "LineCommand") -> None:
        """Take the authority of train-to-train control, from this cycle on."""
        command.apply(now_ns, self.output.motion)
        command.hold_on(self._link)

    def line_beat(self, now_ns: int) -> None:
        """Answer other trains between two cycles. Authorities wait for the next cycle."""
        if self._command is not None:
            self._command.beat(now_ns, self.output.motion)

    def _send_cycle(self, now_ns: int, output: CycleOutput) -> None:
        """Send the frames of the cycle, brake first.

        Slower frames have their own period, or go in every cycle if that is slower.
        """
        self._send_vital(now_ns, output)
        self._sent_ns = now_ns
        cycle_ms, count = self._config.cycle_ms, self._cycles
        self._cycles += 1
        if count % _every(DOOR_MS, cycle_ms) == 0:
            self._send_doors(now_ns, output)
        if count % _every(VITAL_MS, cycle_ms) == 0:
            work_us = self.executive.execution_ns("control") / NS_PER_US
            self._send(now_ns, status_frame(output, work_us=work_us, slips=self._slips))
        if count % _every(MOTION_MS, cycle_ms) == 0:
            self._send(now_ns, *motion_frames(output), mode_frame(output))
            self._send(now_ns, *limit_frames(output))
        if count % _every(TARGET_MS, cycle_ms) == 0:
            self._send(now_ns, *target_frames(output))
        emergency = output.supervision is Supervision.EMERGENCY
        if emergency is not self._emergency:
            self._emergency = emergency
            self._send(now_ns, emergency_message(output.emergency_cause if emergency else None))

    def _tell(self, now_ns: int, output: CycleOutput) -> None:
        """Report the events of this cycle. They follow all commands on the bus."""
        assert self._seen is not None
        desk, inbox, link = self._events, self._inbox, self._link
        events = events_between(self._output_before, self._seen, output, self._seen_before)
        self._output_before = output
        if events:
            desk.tell(now_ns, events)
        if inbox.refusals.waiting:
            desk.tell(now_ns, map(_frame_rejected, inbox.refusals.due(now_ns)))
        if link.refusals.waiting:
            desk.tell(now_ns, map(_radio_refused, link.refusals.due(now_ns)))
        if self._command is not None and self._command.refusals.waiting:
            desk.tell(now_ns, map(_radio_refused, self._command.refusals.due(now_ns)))
        self._send(now_ns, *desk.due())

    def _send(self, now_ns: int, *frames: Frame) -> None:
        encode, send = self._encoder.encode, self._can.send
        for frame in frames:
            for can_id, payload in encode(frame):
                send(now_ns, can_id, payload)

    def _send_vital(self, now_ns: int, output: CycleOutput) -> None:
        self._send(now_ns, *vital_frames(output))
        if self._by_loop:
            self._send(now_ns, analogue_frame(output))

    def _send_doors(self, now_ns: int, output: CycleOutput) -> None:
        """DOOR_CARS follows only while single cars are enabled, and once to withdraw them."""
        self._send(now_ns, door_frame(output))
        cars = door_cars_frame(output)
        enabled = bool(cars.left_cars or cars.right_cars)
        if enabled or self._cars_enabled:
            self._send(now_ns, cars)
        self._cars_enabled = enabled

    def repeat_vital(self, now_ns: int) -> None:
        """Repeat vital commands between the cycles of a slow controller, as long as cycles come."""
        if self._last_ns is None or now_ns - self._last_ns > STALE_CYCLES * self._cycle_ns:
            return
        if now_ns - self._sent_ns >= VITAL_MS / 2.0 * NS_PER_MS:
            self._send_vital(now_ns, self.output)
            self._sent_ns = now_ns

    def report_position(self, now_ns: int) -> None:
        payload = None if self._command else self._link.report(now_ns, self.output)
        if payload is not None:
            self._radio.send(now_ns, self._link.report_key, payload)
        status = self._link.status(now_ns, self.output, self._seen)
        self._radio.send(now_ns, self._link.status_key, status)

    def life_sign(self, now_ns: int) -> None:
        self._send(now_ns, heartbeat(self._life))
        self._life = NodeState.OPERATIONAL
        self._look_for_line(now_ns)
        self._events.flush()

    @property
    def waits_for_line(self) -> str:
        """Text if the line's radio is silent. Empty if it is not, or if there is none."""
        return "" if self._command is None else self._command.silence_words

    def _look_for_line(self, now_ns: int) -> None:
        if self._command is None:
            return
        event = self._command.silence(now_ns, self._radio.counters.received)
        if event is not None:
            self._events.tell(now_ns, (event,))

    def stop(self, now_ns: int) -> None:
        """Send the safe output as the last message."""
        self.output = replace(SAFE_OUTPUT, cause="controller ends")
        self._send_vital(now_ns, self.output)
        self._send_doors(now_ns, self.output)
        self._send(now_ns, status_frame(self.output, work_us=0.0, slips=self._slips))
        self._send(now_ns, *limit_frames(self.output))
        self._events.tell(now_ns, (controller_ends(),))
        self._send(now_ns, *self._events.due(), heartbeat(NodeState.STOPPED))
        self._events.flush()

    def _remember(self, output: CycleOutput) -> None:
        """Store wheel and place once after each run, at standstill and outside of the cycle.

        When the train moves again, the stored place is invalidated. A controller that loses power
        on the way must not restart in its former place. The same applies in an emergency, even at
        standstill. After a power cycle the train then has no place, and a person has to release it.
        """
        motion = output.motion
        latched = output.supervision is Supervision.EMERGENCY
        if motion is None or not motion.standstill or latched:
            self._stored = motion is None
            if motion is not None and self._nvram.record.standing:
                self._nvram.put_later(replace(self._nvram.record, standing=False))
            return
        if self._stored:
            return
        self._stored = True
        record = self._controller.record()
        self._nvram.put_later(
            replace(
                self._identity.stamped(self._nvram.record),
                wheel_diameter_m=record.m_per_pulse * self._config.train.pulses_per_turn / math.pi,
                front_m=record.front_m,
                standing=(
                    record.proof is not PlaceProof.UNKNOWN
                    and record.bound_m <= self._config.odometry.cold_movement_m
                ),
                highest_term=self._link.seen_term,
            )
        )

    def _write_log(self, now_ns: int, output: CycleOutput) -> None:
        if self._log is None:
            return
        self._log.row(
            *cycle_row(
                (now_ns - self._start_ns) / NS_PER_S,
                output,
                work_us=self.executive.execution_ns("control") / NS_PER_US,
                lateness_us=self.executive.lateness_ns("control") / NS_PER_US,
                slips=self._slips,
            )
        )


def _frame_rejected(refusal: Refusal) -> Event:
    name = NAMES.get(refusal.number)
    of = f"{refusal.number:#05x}" if name is None else f"{name} ({refusal.number:#05x})"
    words = f"{_times(refusal)} {of} refused: {refusal.detail}"
    return Event(EventKind.FRAME_REJECTED, words, (), refusal.number)


def _radio_refused(refusal: Refusal) -> Event:
    words = f"{_times(refusal, 'message')} on the radio refused: {refusal.reason}"
    return Event(EventKind.RADIO_REFUSED, f"{words}, {refusal.detail}", (), refusal.count)


def _times(refusal: Refusal, what: str = "frame") -> str:
    return f"{refusal.count} {what}{'' if refusal.count == 1 else 's'}"


def _every(period_ms: float, cycle_ms: float) -> int:
    return max(1, round(period_ms / cycle_ms))
