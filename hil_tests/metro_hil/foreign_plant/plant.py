"""Runs a foreign plant: one exchange for each step of the plant, each within a time limit."""

from collections.abc import Mapping
from typing import Any, Final

from can_dbc.nodes import Node
from firmware_py.clock.clock import NS_PER_S
from firmware_py.grants import GrantProtocolError
from firmware_py.ports import CanPort
from firmware_py.settings import SettingsError
from metro_hil.external_controller import ControllerProgram, ControllerStartError
from metro_hil.external_controller.link import END_S, ControllerLink, LinkDownError
from metro_hil.foreign_plant.checks import LoadCheck, TruthCheck, read_frames, read_hex, read_parts
from metro_hil.foreign_plant.messages import (
    VERSION,
    OfPlant,
    PlantGrant,
    PlantHello,
    PlantReady,
    PlantRefuse,
    PlantStop,
    PlantYield,
    encode,
    read_plant,
)
from plant_emulator.foreign import ForeignPartsError
from plant_emulator.world import STEP_NS

SERIAL_BYTES_MAX: Final = 1024
"""Maximum length of the tag reader's output in one step; the line carries about 12 bytes in it."""


class PlantStartError(SettingsError):
    """The case cannot run with this plant; the text says why."""


class PlantDiedError(ForeignPartsError):
    """The plant ended, hung or broke the protocol during a run; the text says when and how."""


class ForeignPlant:
    """The program in its process. Call `stop` at the end, or `close` to end it at once."""

    def __init__(
        self,
        program: ControllerProgram,
        told: Mapping[str, Any],
        *,
        port: CanPort,
        lease_s: float,
    ) -> None:
        """Start the program and exchange hello. Raises PlantStartError.

        Args:
            told: content of hello.
            port: receives the frames of the controller.
            lease_s: wall time for each answer after hello, s.
        """
        self._port = port
        self._frames: list[tuple[Node, int, bytes]] = []
        self._serial: list[bytes] = []
        self._died = False
        self._now_ns: int = told["start_ns"]
        """Time of the program. In real time it stands while the plant gives up steps."""
        self._load = LoadCheck()
        try:
            self._link = ControllerLink(program, lease_s=lease_s)
        except ControllerStartError as error:
            raise PlantStartError(f"plant{str(error).removeprefix('controller')}") from error
        try:
            ready = self._greet(PlantHello(VERSION, dict(told)))
            self._moves, self._nodes = read_parts(ready.provides)
            self._take(ready)
        except GrantProtocolError as error:
            self._link.close()
            raise PlantStartError(f"plant: at its start it broke the protocol: {error}") from error
        except BaseException:
            self._link.close()
            raise
        self.name = ready.name
        """Name that the program gives itself."""
        self._check = TruthCheck(self._moves, self._nodes, told["front_m"])

    @property
    def moves(self) -> bool:
        return self._moves

    @property
    def nodes(self) -> frozenset[Node]:
        return self._nodes

    @property
    def pid(self) -> int:
        return self._link.pid

    def _greet(self, hello: PlantHello) -> PlantReady:
        try:
            answer = self._answer(self._link.greet_bytes(encode(hello)))
        except LinkDownError as error:
            raise PlantStartError(f"plant: at its start it {error}") from error
        if isinstance(answer, PlantRefuse):
            raise PlantStartError(f"plant: refuses: {answer.reason}")
        if not isinstance(answer, PlantReady):
            raise PlantStartError("plant: answers hello with yield; ready is needed")
        if answer.version != VERSION:
            raise PlantStartError(
                f"plant: speaks version {answer.version} of the protocol, the bench {VERSION}"
            )
        return answer

    def _answer(self, line: bytes) -> OfPlant:
        try:
            return read_plant(line)
        except GrantProtocolError as error:
            raise LinkDownError(f"broke the protocol: {error}") from error

    def step(self, end_ns: int, inputs: Mapping[str, float]) -> Mapping[str, float]:
        """Advance the program to `end_ns` and return its truth. Raises PlantDiedError."""
        self._now_ns = now_ns = self._now_ns + STEP_NS
        frames = [
            # In real time a step that is made up for may receive what ended after it.
            (min(now_ns, now_ns - end_ns + frame.stamp_ns), frame.can_id, frame.data.hex())
            for frame in self._port.receive(end_ns)
            if not (frame.extended or frame.remote or frame.error)
        ]
        answer = self._exchange(PlantGrant(now_ns, dict(inputs), frames))
        try:
            return self._check.checked(answer.truth)
        except GrantProtocolError as error:
            raise self._died_error(f"broke the protocol: {error}") from error

    def _exchange(self, message: PlantGrant | PlantStop) -> PlantYield:
        try:
            answer = self._answer(self._link.exchange_bytes(encode(message)))
            if not isinstance(answer, PlantYield):
                raise LinkDownError("broke the protocol: answers with no yield")
            if answer.now_ns != message.now_ns:
                at_s = answer.now_ns / NS_PER_S
                raise LinkDownError(f"broke the protocol: answers the message of {at_s:.3f} s")
            self._take(answer)
        except LinkDownError as error:
            raise self._died_error(str(error)) from error
        except GrantProtocolError as error:
            raise self._died_error(f"broke the protocol: {error}") from error
        return answer

    def _take(self, answer: PlantReady | PlantYield) -> None:
        """Keep what its nodes send. Raises GrantProtocolError."""
        frames = read_frames(answer.frames, self._nodes)
        self._load.offer([data for _, _, data in frames])
        self._frames += frames
        self._serial += self._pieces(answer.serial)

    def _pieces(self, serial: tuple[str, ...]) -> list[bytes]:
        pieces = [read_hex("serial", text) for text in serial]
        if pieces and Node.BTM not in self._nodes:
            raise GrantProtocolError("serial: bytes of the tag reader; it does not provide BTM")
        if sum(map(len, pieces)) > SERIAL_BYTES_MAX:
            raise GrantProtocolError(f"serial: over {SERIAL_BYTES_MAX} bytes in one yield")
        return pieces

    def _died_error(self, words: str) -> PlantDiedError:
        self._died = True
        self._link.close()
        did, _, how = words.partition(": ")
        return PlantDiedError(f"plant {did} at t={self._now_ns / NS_PER_S:.3f} s: {how}")

    def take_frames(self) -> list[tuple[Node, int, bytes]]:
        taken, self._frames = self._frames, []
        return taken

    def take_serial(self) -> list[bytes]:
        taken, self._serial = self._serial, []
        return taken

    def stop(self) -> None:
        """Let the program send its last output and end. Raises PlantDiedError."""
        if not self._died:
            self._exchange(PlantStop(self._now_ns))
            self._link.close(END_S)

    def close(self) -> None:
        """End the process."""
        self._link.close()
