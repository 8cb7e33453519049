"""Makes the controller of a run in virtual time, of any kind, and connects it to its ports."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Final

from firmware_py.clock.clock import Clock
from firmware_py.ports import CanFrame, CanPort, LinkCounters, RadioPort, SerialPort
from firmware_py.storage.nvram import Nvram, NvramRecord
from firmware_py.storage.port_log import PortLog
from metro_hil.external_controller import (
    ControllerDiedError,
    ControllerStartError,
    GrantedController,
    program_of,
)
from metro_hil.faults.process import BenchDevice, ControllerProcess
from metro_hil.model.case import ControllerSpec
from metro_hil.model.mission import Journey
from vobc.config import VobcConfig
from vobc.process import CycleLog, EventLog, remembered_start, unknown_start
from vobc.process.commission import Commission
from vobc.process.identity import identity_of

if TYPE_CHECKING:
    # Only trains that command themselves need this module.
    from vobc.process.line_command import LineCommand

SHIPPED: Final = ControllerSpec()
NS_PER_S: Final = 1_000_000_000
DAY_S: Final = 1_700_000_000
"""Time of day at the start of a run in virtual time, for a board that has lost its memory, s."""

Heard = Callable[[int, int, bytes], None]
"""Receives time, identifier and data of a frame."""


def memory_of(journey: Journey, config: VobcConfig) -> NvramRecord:
    """Content of the board's memory before its first start in a run."""
    if not journey.wakes_up:
        return NvramRecord(boot_count=1)
    stood = NvramRecord(boot_count=1, front_m=journey.start.stop_m, standing=True)
    return identity_of(config, journey.memory_line or journey.line).stamped(stood)


class ControllerSide:
    """Starts the controller, and restarts it after it was killed."""

    def __init__(
        self,
        controller: ControllerSpec,
        config: VobcConfig,
        journey: Journey,
        *,
        clock: Clock,
        cycle_log: CycleLog | None,
        port_log: PortLog | None,
        said: Heard | None,
        event_log: EventLog | None = None,
        command: "LineCommand | None" = None,
    ) -> None:
        """Args:
        command: train-to-train control of the shipped controller.
        cycle_log: cycle log of the shipped controller, like `event_log`.
        port_log: log of everything at the controller's own ports.
        said: receives every frame of the controller at the true time of sending.
        """
        self._controller, self._config, self._journey = controller, config, journey
        self._clock, self._cycle_log, self._port_log = clock, cycle_log, port_log
        self._said = said
        self._event_log, self._command = event_log, command
        self._nvram = Nvram(None, memory_of(journey, config))
        self._granted: GrantedController | None = None

    def device(
        self, can: CanPort, tags: SerialPort, radio: RadioPort, *, faulty: bool
    ) -> BenchDevice:
        """Start the controller. Raises ControllerStartError.

        Args:
            faulty: whether faults of its process may occur.
        """
        if not faulty:
            return self._start(can, tags, radio, 0, False)
        return ControllerProcess(
            self._start,
            self.close,
            can=can,
            tags=tags,
            radio=radio,
            start_ns=0,
            forget=self._forget,
        )

    def _forget(self) -> None:
        """Replace the board's memory by a new one, which counts its starts from the time of day."""
        time_of_day_s = DAY_S + self._clock.now_ns() // NS_PER_S
        self._nvram = Nvram(None, NvramRecord(boot_count=time_of_day_s))

    def _start(
        self, can: CanPort, tags: SerialPort, radio: RadioPort, now_ns: int, again: bool
    ) -> BenchDevice:
        if self._said is not None:
            can = _ObservedCan(can, self._clock, self._said)
        if self._port_log is not None:
            log = self._port_log
            can, tags, radio = log.can(can), log.tags(tags), log.radio(radio)
        commission = self._commission(now_ns, again)
        try:
            device = self._make(commission, can, tags, radio)
        except ControllerStartError as error:
            if not again:
                raise
            # It has started before, so the controller failed, not the bench.
            words = str(error).removeprefix("controller: ")
            at_s = self._clock.now_ns() / NS_PER_S
            raise ControllerDiedError(
                f"controller did not start again at t={at_s:.3f} s: {words}"
            ) from error
        if self._port_log is not None:
            self._port_log.start(commission.table(), device.executive, virtual=True)
        return device

    def _commission(self, now_ns: int, again: bool) -> Commission:
        # The board's memory keeps its content over a restart.
        config, journey, record = self._config, self._journey, self._nvram.record
        start = journey.handed_over
        if journey.wakes_up:
            start = remembered_start(config, journey.line, record)
        if again or (journey.wakes_up and start is None):
            start = unknown_start(config, journey.line, record)
        return Commission(config, journey.line, journey.mission, record, now_ns, start)

    def _make(
        self, commission: Commission, can: CanPort, tags: SerialPort, radio: RadioPort
    ) -> BenchDevice:
        if self._controller.kind == SHIPPED.kind:
            self._nvram = Nvram(None, commission.nvram)
            return commission.device(
                can=can,
                tags=tags,
                radio=radio,
                nvram=self._nvram,
                cycle_log=self._cycle_log,
                event_log=self._event_log,
                command=self._command,
            )
        self.close()
        # The memory of another program is unknown to the bench, except for the number of its
        # starts.
        boots = commission.nvram.boot_count + 1
        self._nvram = Nvram(None, NvramRecord(boot_count=boots))
        self._granted = GrantedController(
            program_of(self._controller),
            commission,
            can=can,
            tags=tags,
            radio=radio,
            lease_s=self._controller.lease_s,
        )
        return self._granted

    def close(self) -> None:
        """End the process of an external controller."""
        if self._granted is not None:
            self._granted.close()
            self._granted = None


class _ObservedCan:
    """The controller's own port, observed before a fault can change what it sends."""

    def __init__(self, port: CanPort, clock: Clock, said: Heard) -> None:
        self._port, self._clock, self._said = port, clock, said

    @property
    def counters(self) -> LinkCounters:
        return self._port.counters

    def send(self, now_ns: int, can_id: int, data: bytes) -> None:
        self._said(self._clock.now_ns(), can_id, data)
        self._port.send(now_ns, can_id, data)

    def receive(self, now_ns: int) -> Sequence[CanFrame]:
        return self._port.receive(now_ns)

    def close(self) -> None:
        self._port.close()
