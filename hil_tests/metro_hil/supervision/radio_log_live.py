"""Listens to a line's radio, where `vobc line-log` otherwise reads a log."""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

from firmware_py.clock.clock import WallClock
from firmware_py.radio.credentials import load_credentials
from firmware_py.radio.zenoh_radio import SessionRole, open_radio
from firmware_py.trackdb.areas import load_areas
from metro_hil.supervision.radio_log import NS_PER_S, RadioEntry, entry_of
from zenoh_config import t2t_keys
from zenoh_config.codec import SafetyKey
from zenoh_config.secured import SUPERVISION_NAME

POLL_NS: Final = 50_000_000
INBOX_MESSAGES: Final = 1 << 16
PATIENCE_S: Final = 2.0
"""Time after which the user is informed that there is no session yet."""


class LiveLine:
    """Yields the messages that the radio carries from now on."""

    def __init__(self, line: str, endpoint: str, secure: Path | None, key: SafetyKey) -> None:
        self._line, self._endpoint, self._secure, self._key = line, endpoint, secure, key
        self.reached = False
        """Whether there was a session."""

    def entries(self, duration_s: float, asked: Callable[[], bool]) -> Iterator[RadioEntry]:
        """Yield messages for this duration, or until `asked`. Raises SettingsError, RadioError."""
        clock, secure, told = WallClock(), None, False
        if self._secure is not None:
            secure = load_credentials(self._secure, SUPERVISION_NAME, clock.epoch_ns())
        topics = t2t_keys.of_line(load_areas(self._line).name)
        with open_radio(
            *(SessionRole.TRAIN, self._endpoint, topics, clock),
            inbox_messages=INBOX_MESSAGES,
            secure=secure,
        ) as port:
            start_ns = clock.now_ns()
            while not asked():
                clock.wait_until(clock.now_ns() + POLL_NS)
                now_ns = clock.now_ns()
                self.reached = self.reached or port.connected
                for each in port.receive(now_ns):
                    yield entry_of(each.stamp_ns / NS_PER_S, each.key, each.payload, self._key)
                past_s = (now_ns - start_ns) / NS_PER_S
                if past_s >= duration_s:
                    return
                if past_s >= PATIENCE_S and not self.reached and not told:
                    told = True
                    self._tell_patience()

    def _tell_patience(self) -> None:
        also = "" if self._secure is None else ", with the same certificate authority"
        print(
            f"vobc: {self._endpoint}: no session yet; does a wayside run there{also}? Trying again",
            file=sys.stderr,
            flush=True,
        )
