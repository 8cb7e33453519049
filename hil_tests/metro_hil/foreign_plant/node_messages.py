"""Messages between the bench and the process of one LS-BUS node, each one line of JSON.

The bench sends first, and every line of it has one answer: `NodeHello` gets `NodeReady`, and each
`NodeGo` gets `NodeDone`.
"""

from typing import Final

import msgspec


class NodeHello(msgspec.Struct, frozen=True):
    """The node starts at the instant 0."""

    source: str
    """What a message about a mistake begins with."""
    fmu: str
    terminal: str
    parameters: dict[str, float]
    step_ns: int
    """Greatest step of a node whose transmit clock is a triggered output."""


class NodeReady(msgspec.Struct, frozen=True):
    due_ns: int = 0
    sent: str = ""
    """Operations that the node sends at the start, in hexadecimal."""
    notified: bool = False
    """Whether the node wants Confirm, Arbitration Lost and Bus Error."""
    refusal: str = ""
    """Why the node cannot start."""


class NodeGo(msgspec.Struct, frozen=True, array_like=True):
    """Advance to `at_ns`, which is not after the instant that is due, and take the operations."""

    at_ns: int
    received: str


class NodeDone(msgspec.Struct, frozen=True, array_like=True):
    due_ns: int
    """Instant of the next visit at the latest."""
    sent: str


_encoder: Final = msgspec.json.Encoder()
READY: Final = msgspec.json.Decoder(NodeReady)
DONE: Final = msgspec.json.Decoder(NodeDone)
HELLO: Final = msgspec.json.Decoder(NodeHello)
GO: Final = msgspec.json.Decoder(NodeGo)


def encode(message: NodeHello | NodeReady | NodeGo | NodeDone) -> bytes:
    return _encoder.encode(message) + b"\n"
