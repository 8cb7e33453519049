"""A controller in another process with the interface of a local one, for runs in lockstep."""

from typing import Final

from firmware_py import grants
from firmware_py.clock.clock import NS_PER_S
from firmware_py.clock.executive import Executive
from firmware_py.ports import CanPort, RadioPort, SerialPort
from metro_hil.external_controller.link import (
    END_S,
    FORMS,
    LEASE_S,
    START_S,
    ControllerDiedError,
    ControllerLink,
    ControllerProgram,
    ControllerStartError,
    LinkDownError,
)
from metro_hil.external_controller.observed_state import ObservedState
from vobc.process import Commission
from vobc.process.identity import identity_of
from vobc.vocabulary import CycleOutput
from zenoh_config import keys
from zenoh_config.codec import BENCH_KEY

SAME_INSTANT_MAX: Final = 1000
"""Number of time grants at one time after which the controller counts as hanging."""


class GrantedController:
    """Run `executive`; call `stop` at the end, or `close` to end the process without its output."""

    def __init__(
        self,
        program: ControllerProgram,
        commission: Commission,
        *,
        can: CanPort,
        tags: SerialPort,
        radio: RadioPort,
        start_s: float = START_S,
        lease_s: float = LEASE_S,
    ) -> None:
        """Start the program and exchange hello. Raises ControllerStartError.

        Args:
            start_s: wall time until the answer to hello.
            lease_s: wall time for each later answer.
        """
        self._can, self._tags, self._radio = can, tags, radio
        self._observed = ObservedState()
        self._same_instant = 0
        self._died: ControllerDiedError | None = None
        self._link = ControllerLink(program, start_s=start_s, lease_s=lease_s)
        try:
            ready = self._greet(commission)
        except BaseException:
            self._link.close()
            raise
        self.name = ready.name
        """Name that the program gives itself."""
        self.executive = Executive.woken(
            "grant", self._grant, max(ready.next_wakeup_ns, commission.start_ns)
        )

    @property
    def output(self) -> CycleOutput:
        """The controller's state, as far as its frames on the bus show it."""
        return self._observed.output

    @property
    def pid(self) -> int:
        return self._link.pid

    def _greet(self, commission: Commission) -> grants.Ready:
        try:
            told = {**commission.table(), "radio": radio_table(commission)}
            answer = self._link.greet(grants.Hello(grants.VERSION, told))
        except LinkDownError as error:
            raise ControllerStartError(f"controller: at its start it {error}") from error
        if isinstance(answer, grants.Refuse):
            raise ControllerStartError(f"controller: refuses: {answer.reason}")
        if not isinstance(answer, grants.Ready):
            raise ControllerStartError("controller: answers hello with yield; ready is needed")
        if answer.version != grants.VERSION:
            raise ControllerStartError(
                f"controller: speaks version {answer.version} of the protocol, "
                f"the bench version {grants.VERSION}"
            )
        if answer.form not in FORMS:
            raise ControllerStartError(
                f"controller: asks for the form {answer.form!r}; the bench has {', '.join(FORMS)}"
            )
        self._link.form = FORMS[answer.form]
        return answer

    def _grant(self, now_ns: int) -> int:
        message = self._link.form.grant(
            now_ns,
            self._can.receive(now_ns),
            self._tags.receive(now_ns),
            self._radio.receive(now_ns),
        )
        next_ns = self._exchange(now_ns, message)
        self._same_instant = self._same_instant + 1 if next_ns <= now_ns else 0
        if self._same_instant > SAME_INSTANT_MAX:
            raise self._died_error(now_ns, f"hung: {SAME_INSTANT_MAX} wake-ups at one instant")
        return max(now_ns, next_ns)

    def _exchange(self, now_ns: int, message: bytes) -> int:
        """Deliver the controller's outputs; return its next wake-up. Raises ControllerDiedError."""
        try:
            answer = self._link.form.answer(self._link.exchange_bytes(message))
            if answer.now_ns != now_ns:
                raise LinkDownError(
                    f"broke the protocol: answers the message of {answer.now_ns / NS_PER_S:.3f} s"
                )
        except LinkDownError as error:
            raise self._died_error(now_ns, str(error)) from error
        except grants.GrantProtocolError as error:
            raise self._died_error(now_ns, f"broke the protocol: {error}") from error
        said = answer.said
        for can_id, data in said.frames:
            self._can.send(now_ns, can_id, data)
            self._observed.frame(now_ns, can_id, data)
        for chunk in said.serial:
            self._tags.send(now_ns, chunk)
        for key, payload in said.radio:
            self._radio.send(now_ns, key, payload)
        return answer.next_wakeup_ns

    def _died_error(self, now_ns: int, words: str) -> ControllerDiedError:
        self._link.close()
        did, _, how = words.partition(": ")
        self._died = ControllerDiedError(f"controller {did} at t={now_ns / NS_PER_S:.3f} s: {how}")
        return self._died

    def stop(self, now_ns: int) -> None:
        """Let the controller send its last output and end. Raises ControllerDiedError."""
        if self._died is not None:
            raise self._died
        self._exchange(now_ns, self._link.form.stop(now_ns))
        self._link.close(END_S)

    def close(self) -> None:
        """End the process without its output, as kill -9 does."""
        self._link.close()


def radio_table(commission: Commission) -> dict[str, str]:
    """What a controller needs for its radio messages and cannot easily compute itself.

    Whole numbers of 64 bits are hexadecimal, as many JSON readers make them floating-point numbers.
    """
    identity = identity_of(commission.config, commission.line)
    return {
        "report_key": keys.report(identity.line, identity.train),
        "status_key": keys.status(identity.line, identity.train),
        "database": f"{identity.database:016x}",
        "parameters": f"{identity.parameters:016x}",
        "safety_key": BENCH_KEY.hex(),
    }
