"""A tap on a train's bus reports the state of protection, and an emergency with its cause."""

from can_dbc.binding import Frame
from can_dbc.codec import Encoder
from can_dbc.vobc import (
    AtoPhase,
    Cause,
    Inhibit,
    Missing,
    OperatingMode,
    Supervision,
    VobcMode,
    VobcStatus,
    Withheld,
)
from firmware_py.buses.inproc import InprocBus
from metro_hil.line.exercise.taps import RECEIVED_IDS, ProtectionOutput, ProtectionTap

MS = 1_000_000


def status(supervision: Supervision) -> VobcStatus:
    return VobcStatus(supervision, AtoPhase.OFF, Missing.NOTHING, True, False, 0.0, 0)


def mode(cause: Cause) -> VobcMode:
    return VobcMode(
        *(OperatingMode.STANDBY, cause, Inhibit.NONE, Withheld.NONE),
        jog_attempts=0,
        replicas_agree=True,
        alarm_raised=False,
    )


class Heard:
    """A controller and a tap on one bus."""

    def __init__(self) -> None:
        self.bus = InprocBus("train2", 250_000, None)
        self._controller = self.bus.port("VOBC", frozenset())
        self._encoder = Encoder()
        self.tap = ProtectionTap(2, self.bus.port("TAP", RECEIVED_IDS))

    def says(self, at_ms: int, *frames: Frame) -> list[tuple[int, Supervision, int]]:
        for frame in frames:
            for can_id, payload in self._encoder.encode(frame):
                self._controller.send(at_ms * MS, can_id, payload)
        return [each[1:] for each in self.tap.on_message((at_ms + 5) * MS)]


def test_an_emergency_is_reported_with_its_cause_and_other_states_at_once() -> None:
    heard = Heard()
    nominal, emergency = status(Supervision.NOMINAL), status(Supervision.EMERGENCY)

    assert heard.says(0, nominal, mode(Cause.NONE)) == [(2, Supervision.NOMINAL, 0)]
    assert heard.says(50, emergency) == []
    assert heard.says(100, emergency, mode(Cause.AUTHORITY_OLD)) == [
        (2, Supervision.EMERGENCY, Cause.AUTHORITY_OLD)
    ]
    assert heard.says(150, nominal) == [(2, Supervision.NOMINAL, 0)]


def test_a_state_is_reported_with_its_instant_on_the_bus() -> None:
    heard = Heard()
    for can_id, payload in Encoder().encode(status(Supervision.SERVICE)):
        heard.bus.port("X", frozenset()).send(20 * MS, can_id, payload)

    (said,) = heard.tap.on_message(500 * MS)

    assert isinstance(said, ProtectionOutput)
    assert 20 * MS < said.at_ns < 22 * MS
