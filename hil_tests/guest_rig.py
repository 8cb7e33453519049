"""Commands that tests run in a guest with a real vcan."""

import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parent.parent
GUEST_TIMEOUT_S: Final = 300
HANG_MARGIN_S: Final = 120


class Guest:
    """Runs commands on a Linux that has SocketCAN and an interface vcan0."""

    def run(
        self, *command: str | Path, timeout_s: int = GUEST_TIMEOUT_S, options: Sequence[str] = ()
    ) -> subprocess.CompletedProcess[str]:
        """Run a command in the checkout and return its status and output.

        Args: command: unchanged arguments. timeout_s: timeout of the command, in addition to the
        guest's boot. options: options of `vcan-guest`.
        """
        launcher = [str(ROOT / "tools/vcan-guest"), "--timeout", str(timeout_s), *options, "--"]
        return subprocess.run(
            [*launcher, *(str(word) for word in command)],
            cwd=ROOT,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=timeout_s + HANG_MARGIN_S,
            check=False,
        )
