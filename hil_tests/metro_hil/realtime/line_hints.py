"""Hints for the operator of a train on a line that commands itself, shown beside its picture."""

import shlex
from collections.abc import Sequence
from typing import Final

from can_dbc.vobc import Missing, Supervision, VobcMode
from metro_hil.model.end_condition import centre_may_let_go
from metro_hil.realtime.live_display import BusPicture
from vobc.process.line_silence import silence_text

LOST_LOOKS: Final = 12
"""Number of looks in a row, three seconds, after which a train has lost its place. A train that has
just started finds it sooner."""
LOST: Final = (
    "has lost its place: at its desk (`plant desk`, with --desk external) reset (r), choose "
    "manual (m) and restricted (x), drive on sight over two tags, stop, and choose auto (a)"
)


class LineHints:
    """Names the supervision command that releases the train; the bench cannot release it itself."""

    def __init__(self, train: int, endpoint: str, where: Sequence[str] = ()) -> None:
        """`where` holds the options by which supervision finds the line; empty if it needs none."""
        self._endpoint = endpoint
        self._lost_looks = 0
        self._release = shlex.join(["vobc", "emergency-brake", f"T{train}", "--end", *where])

    def __call__(self, picture: BusPicture) -> list[str]:
        """Return whole sentences, the most urgent first."""
        return [*self._let_go(picture), *self._silent(picture), *self._lost(picture)]

    def _let_go(self, picture: BusPicture) -> list[str]:
        status, mode = picture.status, picture.latest.get(VobcMode)
        if status is None or status.supervision is not Supervision.EMERGENCY:
            return []
        if not isinstance(mode, VobcMode) or not centre_may_let_go(mode.cause):
            return []
        return [f"waits for the centre: `{self._release}` releases the train"]

    def _lost(self, picture: BusPicture) -> list[str]:
        status = picture.status
        # Without a tag reader or a train on the bus no place is expected.
        lost = status is not None and status.missing & ~Missing.AUTHORITY == Missing.LOCALISATION
        self._lost_looks = self._lost_looks + 1 if lost else 0
        return [LOST] if self._lost_looks >= LOST_LOOKS else []

    def _silent(self, picture: BusPicture) -> list[str]:
        if not picture.line_silent:
            return []
        return [silence_text(self._endpoint)]
