"""Trains that supervision wants off the roster, as a person has seen that they are not there.

A train that falls silent stays on the roster, and those behind it wait until sections are clear
around where it was. What no counter can tell is left to a person: whether it stands behind the last
counter of the line, or was taken away past trains that stand there. What counters do tell stands
against any word.
"""

from collections.abc import Callable, Iterable
from typing import Final, NamedTuple

from vobc.t2t.authority import Counted, Standing, all_explained
from vobc.t2t.conclusions import Conclusions
from vobc.t2t.guards import MasterGuards, Vanished
from vobc.t2t.roster import Roster
from vobc.t2t.vocabulary import T2tConfig
from zenoh_config.t2t_supervision import Removal, RemovalState
from zenoh_config.timers import NS_PER_MS

GOOD_FOR_NS: Final = 3_000_000_000
"""So long what a person has seen counts."""
REMOVALS_MAX: Final = 16
"""Wanted at the same time; others are not answered."""


class Sight(NamedTuple):
    """What the area's track and trains tell."""

    counted: tuple[Counted, ...] | None
    """Sections as last counted; None: this line counts no axles."""
    seen_ns: int
    """Not before this they were so."""
    standing: tuple[Standing, ...]
    """Trains that are heard, and say that they stand."""
    heard: set[int]
    """Trains that were heard just now and are not on the roster in this incarnation."""


class Removals:
    """Of one master, under its own term."""

    def __init__(self, config: T2tConfig, guards: MasterGuards, known: Conclusions) -> None:
        self._config, self._guards, self._known = config, guards, known
        self._wanted: dict[int, int] = {}
        """By train: own stamp of the heartbeat that the newest removal answers."""
        self._late: set[int] = set()
        self._states: dict[int, RemovalState] = {}

    def hears(self, removal: Removal, now_ns: int) -> None:
        train = removal.train
        if removal.term != self._known.term:
            return
        if train not in self._wanted and len(self._wanted) >= REMOVALS_MAX:
            return
        if self._is_good(removal.echo_ns, now_ns):
            self._wanted[train] = max(removal.echo_ns, self._wanted.get(train, removal.echo_ns))
        elif len(self._late) < REMOVALS_MAX:
            self._late.add(train)

    @staticmethod
    def _is_good(echo_ns: int, now_ns: int) -> bool:
        return 0 <= now_ns - echo_ns <= GOOD_FOR_NS

    def gone(self, roster: Roster, look: Callable[[int], Sight], now_ns: int) -> set[int]:
        """Trains that are wanted off the roster and surely hold and occupy nothing."""
        self._wanted = {t: e for t, e in self._wanted.items() if self._is_good(e, now_ns)}
        if not self._wanted:
            return set()
        sight, on_roster = look(now_ns), {entry.train for entry in roster.proposed}
        reserved_m = self._known.reserved_m(roster.proposed)
        self._states = {
            train: self._judged(train, echo_ns, reserved_m[train], sight, now_ns)
            for train, echo_ns in self._wanted.items()
            if train in on_roster
        }
        return {t for t, state in self._states.items() if state is RemovalState.COMMITTING}

    def _judged(
        self, train: int, echo_ns: int, reserved_m: float, sight: Sight, now_ns: int
    ) -> RemovalState:
        record = self._known.records[train]
        silent_ns = 0 if train in sight.heard else now_ns - record.heard_ns
        age_max_ns = self._config.timers.authority_ms * NS_PER_MS
        explained = sight.counted is None or (
            sight.seen_ns >= echo_ns
            and all_explained(sight.counted, sight.standing, from_m=record.rear_m, to_m=reserved_m)
        )
        if self._guards.vanished(Vanished(silent_ns, age_max_ns, explained)):
            return RemovalState.COMMITTING
        return RemovalState.HEARD if silent_ns <= age_max_ns else RemovalState.AXLES

    def answers(self, roster: Roster) -> Iterable[tuple[int, RemovalState]]:
        """What to tell supervision, by train."""
        on_roster = {entry.train for entry in roster.proposed}
        kept = RemovalState.COMMITTING if roster.pending else RemovalState.GONE
        for train in self._wanted:
            # One that has only just come onto the roster was heard.
            judged = self._states.get(train, RemovalState.HEARD)
            yield train, judged if train in on_roster else kept
        for train in sorted(self._late):
            yield train, RemovalState.TOO_OLD
        self._late.clear()
