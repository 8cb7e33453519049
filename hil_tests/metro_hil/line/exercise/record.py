"""The files of a line's run: the log of its radio and its event log."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Final

from firmware_py.ports import RadioMessage
from firmware_py.storage.recorder import LineFile, RadioLog, SerialDirection

LINE_LOG: Final = "line.log"
STORY: Final = "story.txt"
NS_PER_S: Final = 1e9


class LineRunFiles:
    """Writes the files.

    Seconds count from the first message of `line.log`, as in `vobc line-log`.
    """

    def __init__(self, folder: Path, say: Callable[[float, str], None]) -> None:
        """Open the files. Raises RecorderError."""
        # Stamps use the clock that messages echo, so that latencies can be read from the log.
        self._log = RadioLog(folder / LINE_LOG)
        self._story = LineFile(folder / STORY)
        self._say = say
        self.zero_ns: int | None = None
        """Instant of second 0; that of the first message unless it is set before."""

    @property
    def lost_lines(self) -> int:
        """Number of lines that the disk did not take."""
        return self._log.lost_lines + self._story.lost_lines

    def on_message(self, messages: Iterable[RadioMessage]) -> None:
        for each in messages:
            self.zero_ns = each.stamp_ns if self.zero_ns is None else self.zero_ns
            self._log.message(each.stamp_ns, SerialDirection.RX, each.key, each.payload)
        # A page may follow the log.
        self._log.flush()

    def second_of(self, at_ns: int) -> float:
        return 0.0 if self.zero_ns is None else (at_ns - self.zero_ns) / NS_PER_S

    def tell(self, now_ns: int, words: str) -> None:
        at_s = self.second_of(now_ns)
        self._story.write([told(at_s, words) + "\n"])
        self._say(at_s, words)

    def close(self) -> None:
        self._log.close()
        self._story.close()


def told(at_s: float, words: str) -> str:
    """Return a line of the event log."""
    return f"{at_s:8.2f} s  {words}"
