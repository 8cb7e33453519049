"""An LS-BUS node in a process of its own: one exchange for each visit, within a time limit."""

import os
import sys

import msgspec

from metro_hil.external_controller import ControllerProgram, ControllerStartError
from metro_hil.external_controller.link import LEASE_S, ControllerLink, LinkDownError
from metro_hil.foreign_plant.node_messages import DONE, READY, NodeGo, NodeHello, encode
from metro_hil.foreign_plant.plant import PlantDiedError, PlantStartError

NS_PER_S = 1_000_000_000


class NodeProcess:
    """The process of one node."""

    def __init__(self, name: str, hello: NodeHello, lease_s: float = LEASE_S) -> None:
        """Start the process; `greet` waits for the node. Raises PlantStartError.

        Args:
            lease_s: wall time for each answer after the first, s.
        """
        self.name = name
        self._hello = hello
        self.due_ns = 0
        """Instant of the next visit at the latest."""
        self.sent = b""
        """Operations that the node sent in the last visit."""
        self.notified = False
        """Whether the node wants Confirm, Arbitration Lost and Bus Error."""
        words = (sys.executable, "-m", "metro_hil.foreign_plant.node_host")
        try:
            self._link = ControllerLink(ControllerProgram(words, dict(os.environ)), lease_s=lease_s)
        except ControllerStartError as error:
            raise PlantStartError(f"{hello.source}: {error}") from error

    def greet(self) -> None:
        """Wait until the node has started. Raises PlantStartError."""
        try:
            ready = READY.decode(self._link.greet_bytes(encode(self._hello)))
        except (LinkDownError, msgspec.MsgspecError) as error:
            raise PlantStartError(f"{self._hello.source}: at its start it {error}") from error
        if ready.refusal:
            raise PlantStartError(ready.refusal)
        self.due_ns, self.sent = ready.due_ns, bytes.fromhex(ready.sent)
        self.notified = ready.notified

    @property
    def pid(self) -> int:
        return self._link.pid

    def go(self, at_ns: int, received: bytes) -> None:
        """Let the node advance to `at_ns` and take these operations. Raises PlantDiedError."""
        try:
            line = self._link.exchange_bytes(encode(NodeGo(at_ns, received.hex())))
            done = DONE.decode(line)
        except (LinkDownError, msgspec.MsgspecError) as error:
            raise self.died_error(at_ns, str(error)) from error
        self.due_ns, self.sent = done.due_ns, bytes.fromhex(done.sent)

    def died_error(self, at_ns: int, words: str) -> PlantDiedError:
        """End the process and return the error that says why."""
        self._link.close()
        did, _, how = words.partition(": ")
        return PlantDiedError(f"node {self.name} {did} at t={at_ns / NS_PER_S:.6f} s: {how}")

    def close(self) -> None:
        """End the process."""
        self._link.close()
