"""The desk on the page of a run: keys of the viewer who holds it go to the file of `plant desk`."""

from pathlib import Path

from plant_emulator.cli.by_hand import DESK_KEYS
from plant_emulator.desk.hands import KEYS

LET_GO = "space"
"""Key that is pressed when the viewer who held the desk is gone: the lever goes to 0."""
LEAVE = "q"
"""The key that ends `plant desk`, which brakes the train; the page does not have it."""


class DeskKeys:
    """Appends the names of keys to the file that the desk process reads."""

    keys = tuple((key, text) for key, text, _ in KEYS if key != LEAVE)

    def __init__(self, folder: Path) -> None:
        """Open the file. Raises OSError."""
        self._file = (folder / DESK_KEYS).open("a", buffering=1, encoding="ascii")

    def press(self, key: str) -> None:
        self._file.write(f"{key}\n")

    def let_go(self) -> None:
        self.press(LET_GO)

    def close(self) -> None:
        self._file.close()
