"""Runs one LS-BUS node: `python -m metro_hil.foreign_plant.node_host` speaks `node_messages`.

The FMU has a process of its own, so that neither its crash nor its endless loop stops the bench.
"""

import os
import sys
from pathlib import Path
from typing import BinaryIO, Final

from firmware_py.assertions import require_assertions
from firmware_py.settings import SettingsError, nearest
from metro_hil.foreign_plant.fmu import Fmu, FmuError
from metro_hil.foreign_plant.node_messages import (
    GO,
    HELLO,
    NodeDone,
    NodeHello,
    NodeReady,
    encode,
)
from metro_hil.foreign_plant.terminal_node import TerminalNode, members_of, notify, terminal_of

SENT_BYTES_MAX: Final = 65_536
"""Maximum length of the operations of one visit, which is that of 2,700 frames."""


def main() -> int:
    require_assertions("node")
    # What the FMU prints must not mix with the answers.
    with os.fdopen(os.dup(1), "wb", buffering=0) as wire:
        os.dup2(2, 1)
        return serve(sys.stdin.buffer, wire)


def serve(lines: BinaryIO, wire: BinaryIO) -> int:
    """Answer the lines until they end; return the exit code."""
    hello = HELLO.decode(lines.readline())
    fmu: Fmu | None = None
    try:
        try:
            fmu = Fmu(Path(hello.fmu), events=True)
            node, notified = _started(fmu, hello)
        except (SettingsError, FmuError) as error:
            text = str(error)
            known = text.startswith((hello.source, hello.fmu))
            wire.write(encode(NodeReady(refusal=text if known else f"{hello.source}: {text}")))
            return 0
        wire.write(encode(NodeReady(node.due_ns, node.sent.hex(), notified)))
        for line in lines:
            go = GO.decode(line)
            node.go(go.at_ns, bytes.fromhex(go.received))
            if len(node.sent) > SENT_BYTES_MAX:
                raise FmuError(f"floods the bus: {len(node.sent)} bytes at one instant")
            wire.write(encode(NodeDone(node.due_ns, node.sent.hex())))
    except FmuError as error:
        print(error, file=sys.stderr)
        return 1
    finally:
        if fmu is not None:
            fmu.close()
    return 0


def _started(fmu: Fmu, hello: NodeHello) -> tuple[TerminalNode, bool]:
    """Return the node at the instant 0. Raises SettingsError or FmuError."""
    terminal = terminal_of(fmu, hello.terminal, hello.source)
    members = members_of(fmu, terminal, hello.source)
    for name, value in hello.parameters.items():
        where = f"{hello.source}: parameters.{name}"
        if name not in fmu.variables:
            hint = nearest(name, list(fmu.variables), "variable")
            raise SettingsError(f"{where}: no variable of the FMU; {hint}")
        fmu.check(name, where)
        fmu.set(name, value)
    notified = notify(fmu, members)
    fmu.start(0.0)
    node = TerminalNode(fmu, members, step_ns=hello.step_ns)
    node.begin(0)
    return node, notified


if __name__ == "__main__":
    sys.exit(main())
