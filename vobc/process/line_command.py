"""The train's part in train-to-train control, with its own radio port and period."""

from collections.abc import Callable
from dataclasses import replace
from typing import Final

from firmware_py.ports import TunableRadioPort
from firmware_py.trackdb import LineMap
from vobc.atp.braking import SafeBraking
from vobc.config import VobcConfig
from vobc.process.line_silence import LineSilence
from vobc.train_to_train.vocabulary import HeldAuthority, OwnTrain
from vobc.vocabulary import Authority, Event, Motion, Restriction
from vobc.wire import RadioLink
from vobc.wire.line_radio import LineRadio
from vobc.wire.refusals import Refusals
from zenoh_config.timers import LineTimers

EASY_LEAD_S: Final = 3.0
EASY_DECEL_MPS2: Final = 0.5
"""Braking that passengers and timetable tolerate. If a train cannot stop like this before a closing
object, the object lets it pass."""
HARDEST_DECEL_MPS2: Final = 10.0
"""Upper bound of any train's deceleration. More would need an adhesion above 1."""
S_PER_MS: Final = 1e-3


def commanded(config: VobcConfig, timers: LineTimers) -> VobcConfig:
    """The same train with the maximum age of authorities that the line has agreed on."""
    age_max_s = timers.authority_ms * S_PER_MS
    return replace(config, atp=replace(config.atp, authority_age_max_s=age_max_s))


class LineCommand:
    """Answers messages between control cycles. Authorities are taken only with the cycle."""

    def __init__(
        self,
        radio: LineRadio,
        port: TunableRadioPort,
        config: VobcConfig,
        line: LineMap,
        *,
        axles: int,
        write_down: Callable[[], None] | None = None,
        silence: LineSilence | None = None,
    ) -> None:
        """`port` already has the radio's subscriptions.

        Args:
            write_down: writes what passed the port into a log; called between control cycles.
            silence: watches the messages received, including those of the centre.
        """
        self.radio = radio
        self._write_down, self._silence = write_down, silence
        self._port, self._length_m, self._axles = port, config.train.length_m, axles
        atp = config.atp
        braking = SafeBraking(
            guaranteed_decel_mps2=atp.guaranteed_decel_mps2,
            runaway_mps2=atp.runaway_mps2,
            runaway_s=atp.runaway_s(config.cycle_ms * S_PER_MS),
            build_up_s=atp.brake_build_up_s,
        )
        self._curve = braking.on(line.worst_gradient_permille(line.start_m, line.end_m))
        self._cycle_s = config.cycle_ms * S_PER_MS
        self.refusals = Refusals()
        """Refusals of the line's radio."""
        self._out: list[tuple[str, bytes]] = []
        self.out_of_service = False
        self.waits = False
        """The train is not due yet: it takes part, but its controller gets no authority."""

    def apply(self, now_ns: int, motion: Motion | None) -> None:
        """Receive at the beginning of a control cycle. The cycle then acts on the authority
        held.
        """
        self.radio.takes(self._port.receive(now_ns))
        self._out += self.radio.step(now_ns, self._own(motion), apply=True)

    def send(self, now_ns: int) -> None:
        """Send after the cycle has commanded the brakes.

        Only now may the authority be acknowledged.
        """
        for key, payload in self._out:
            self._port.send(now_ns, key, payload)
        self._out.clear()
        self.radio.tune(self._port)

    def beat(self, now_ns: int, motion: Motion | None) -> None:
        """Process messages between two cycles."""
        self.radio.takes(self._port.receive(now_ns))
        if self.radio.is_due(now_ns):
            self._out += self.radio.step(now_ns, self._own(motion), apply=False)
            self.send(now_ns)
        self._note_refusals()
        if self._write_down is not None:
            self._write_down()

    def _note_refusals(self) -> None:
        now, before = self.radio.refused(), self.refusals.totals
        for reason, count in now.items():
            more = count - before[0, reason]
            if more > 0:
                self.refusals.note(0, reason, "from the line", more)

    def silence(self, now_ns: int, from_centre: int) -> Event | None:
        """Event if the radio has become silent or slow, or is back.

        Args:
            from_centre: number of messages from the centre so far.
        """
        if self._silence is None:
            return None
        event = self._silence.look(now_ns, self._port.counters.received + from_centre)
        return event or self._silence.look_at_answers(*self.radio.round_trip_ms)

    @property
    def silence_words(self) -> str:
        return "" if self._silence is None else self._silence.words or self._silence.slow

    @property
    def held(self) -> HeldAuthority | None:
        return self.radio.authority

    def hold_on(self, link: RadioLink) -> None:
        """Give the authority held, or its absence, to the link from which the controller reads."""
        held = self.held
        if held is None or self.waits:
            link.hold(None, 0, ())
            return
        link.hold(_authority_of(held), held.echo_ns, _restrictions_of(held))

    def _own(self, motion: Motion | None) -> OwnTrain:
        if motion is None or not motion.localised:
            return OwnTrain(
                *(False, 0.0, 0.0, 0.0, 0.0, 0.0, False, 0.0, 0.0, self._axles),
                self.out_of_service,
            )
        front_m, speed_mps = motion.front_m, max(0.0, motion.speed_mps.high)
        reach_m = front_m.high + self._curve.stopping_m(speed_mps, lead_s=self._cycle_s)
        if motion.standstill:
            reach_m = front_m.high
        easy_m = front_m.high + speed_mps * EASY_LEAD_S + speed_mps**2 / (2.0 * EASY_DECEL_MPS2)
        rear_m, least_mps = front_m.low - self._length_m, max(0.0, motion.speed_mps.low)
        return OwnTrain(
            True,
            front_m.low,
            front_m.high,
            rear_m,
            rear_m + least_mps**2 / (2.0 * HARDEST_DECEL_MPS2),
            motion.speed_mps.best,
            motion.standstill,
            reach_m,
            max(reach_m, easy_m),
            self._axles,
            self.out_of_service,
        )


def _authority_of(held: HeldAuthority) -> Authority:
    return Authority(held.end_m, held.term, held.sequence, held.rear_m)


def _restrictions_of(held: HeldAuthority) -> tuple[Restriction, ...]:
    return tuple([Restriction(e.start_m, e.end_m, e.limit_mps) for e in held.restrictions])
