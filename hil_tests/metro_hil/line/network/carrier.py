"""Starts and controls the program that carries packets between networks."""

import json
import os
import subprocess
import sys
from collections.abc import Sequence

from metro_hil.line.network.options import OwnNetworks
from metro_hil.model.subprocesses import ChildError


class PacketCarrier:
    """Runs until it is ended. The calling program must have its own network, too."""

    def __init__(self, trains: Sequence[int], networks: OwnNetworks, *, priority: int) -> None:
        """Start the program. Raises ChildError with what the system refused."""
        words = [f"T{each}" for each in trains]
        words += ["--delay-ms", str(networks.delay_ms), "--jitter-ms", str(networks.jitter_ms)]
        words += ["--loss", str(networks.loss_ratio), "--duplicate", str(networks.duplicate_ratio)]
        words += ["--seed", str(networks.seed), "--priority", str(priority)]
        command = [sys.executable, "-m", "metro_hil.line.network.packet_process", *words]
        self._process = subprocess.Popen(
            [*command, "--parent", str(os.getpid())],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        self.namespaces: dict[int, str] = {}
        """File that stands for the network of each controller, by train."""
        for train in trains:
            line = self._said()
            if not line.startswith("/proc/"):
                self.end()
                raise ChildError(line or "what carries packets between networks did not start")
            self.namespaces[train] = line

    def order(self, order: str, train: int) -> None:
        """Order `cut`, `mute`, `deafen` or `heal` for a train."""
        self._tell(f"{order} T{train}")

    def counts(self) -> dict[str, dict[str, int]]:
        """Return packet counts by direction."""
        self._tell("counts")
        counts: dict[str, dict[str, int]] = json.loads(self._said())
        return counts

    def end(self) -> None:
        self._process.kill()
        self._process.communicate()

    def _tell(self, words: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(f"{words}\n")
        self._process.stdin.flush()

    def _said(self) -> str:
        assert self._process.stdout is not None
        return self._process.stdout.readline().strip()
