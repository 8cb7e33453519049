"""Removal of trains from the roster after an operator has seen that they are gone.

A train that falls silent stays on the roster. Trains behind it wait until the sections around its
last place are clear. Axle counters cannot tell two things: whether the train stands behind the last
counter of the line, and whether it was taken away past standing trains. An operator decides these.
What the counters do show overrides the operator.
"""

from collections.abc import Callable, Iterable
from typing import Final, NamedTuple

from vobc.train_to_train.authority import StandingTrain, all_explained
from vobc.train_to_train.axle_counting import TrackView
from vobc.train_to_train.guards import MasterGuards, Vanished
from vobc.train_to_train.inference import Conclusions
from vobc.train_to_train.roster import Roster
from vobc.train_to_train.vocabulary import T2tConfig
from zenoh_config.t2t_supervision import Removal, RemovalState
from zenoh_config.timers import NS_PER_MS

GOOD_FOR_NS: Final = 3_000_000_000
"""How long an operator's observation is valid."""
REMOVALS_MAX: Final = 16
"""Greatest number of open removals. Further ones get no answer."""


class TrackObservation(NamedTuple):
    """What the track and the trains of the area show."""

    counts: bool
    """Whether this line counts axles."""
    track: TrackView | None
    standing: tuple[StandingTrain, ...]
    """Trains that report and are at standstill."""
    heard: set[int]
    """Trains that reported recently and are not on the roster in this incarnation."""
    end_m: float
    """End of the area."""


class WantedRemoval(NamedTuple):
    """A removal that supervision requests, and its state."""

    echo_ns: int
    """Own time stamp of the heartbeat that the newest removal request answers."""
    state: RemovalState = RemovalState.HEARD


class Removals:
    """Removals of one master, under its own term."""

    def __init__(self, config: T2tConfig, guards: MasterGuards, known: Conclusions) -> None:
        self._config, self._guards, self._known = config, guards, known
        self._wanted: dict[int, WantedRemoval] = {}
        """Requested removals by train."""
        self._late: set[int] = set()

    def on_message(self, removal: Removal, now_ns: int) -> None:
        train = removal.train
        if removal.term != self._known.term:
            return
        if train not in self._wanted and len(self._wanted) >= REMOVALS_MAX:
            return
        if _is_good(removal.echo_ns, now_ns):
            known = self._wanted.get(train, WantedRemoval(removal.echo_ns))
            self._wanted[train] = known._replace(echo_ns=max(removal.echo_ns, known.echo_ns))
        elif len(self._late) < REMOVALS_MAX:
            self._late.add(train)

    def gone(
        self, roster: Roster, look: Callable[[int], TrackObservation], now_ns: int
    ) -> set[int]:
        """Trains to be removed that certainly hold no authority and occupy no track."""
        wanted = {t: e for t, e in self._wanted.items() if _is_good(e.echo_ns, now_ns)}
        self._wanted = wanted
        concerned = wanted.keys() & roster.boots().keys()
        if not concerned:
            return set()
        sight, reserved_m = look(now_ns), self._known.reserved_m(roster.proposed)
        to_m = sight.end_m
        for entry in roster.proposed:
            train = entry.train
            if train in concerned:
                # A person may have driven it by hand beyond its authority, up to the train ahead.
                reach_m = max(reserved_m[train], to_m)
                state = self._judged(train, wanted[train].echo_ns, reach_m, sight, now_ns)
                wanted[train] = wanted[train]._replace(state=state)
            to_m = self._known.records[train].rear_m
        return {train for train in concerned if wanted[train].state is RemovalState.COMMITTING}

    def _judged(
        self, train: int, echo_ns: int, reach_m: float, sight: TrackObservation, now_ns: int
    ) -> RemovalState:
        record, track = self._known.records[train], sight.track
        age_max_ns = self._config.timers.authority_ms * NS_PER_MS
        from_m = record.rear_m - self._config.behind_rear_m
        silent = train not in sight.heard and now_ns - record.received_at_ns > age_max_ns
        # Reports of another incarnation may come from elsewhere, so they do not bound this place.
        to_m = max(reach_m, record.rear_m + self._config.overhang_m)
        explained = not sight.counts or (
            track is not None
            and track.seen_ns >= echo_ns
            and all_explained(track.counted, sight.standing, from_m=from_m, to_m=to_m)
        )
        if self._guards.vanished(Vanished(silent, explained)):
            return RemovalState.COMMITTING
        return RemovalState.AXLES if silent else RemovalState.HEARD

    def answers(self, roster: Roster) -> Iterable[tuple[int, RemovalState]]:
        """Answers to supervision, by train."""
        on_roster = roster.boots()
        for train, wanted in self._wanted.items():
            if roster.pending:
                yield train, RemovalState.COMMITTING
            else:
                yield train, wanted.state if train in on_roster else RemovalState.GONE
        for train in sorted(self._late):
            yield train, RemovalState.TOO_OLD
        self._late.clear()


def _is_good(echo_ns: int, now_ns: int) -> bool:
    return 0 <= now_ns - echo_ns <= GOOD_FOR_NS
