"""What the wayside last told a master of its area's track, with the instant that it is true for."""

from collections.abc import Sequence
from typing import Final, NamedTuple

from firmware_py.trackdb.areas import AreaMap
from vobc.train_to_train.authority import Bar, BarredTrack, Counted, SeenSection, unexplained
from vobc.train_to_train.occupancy import UNBOUNDED_M, TrainRecord, cleared_to_m
from zenoh_config.messages import SpeedRestriction
from zenoh_config.t2t import SectionState, TrackStatus

SPEED_MAX_MPS = 40.0
"""No train is faster; bounds where one was when the sections were seen."""
S_PER_NS = 1e-9
EXCUSED_M: Final = 5.0
"""So far behind what is kept free of the train ahead, at most, it may have been itself in a section
when that was seen. Nobody is set within 20 m of where it says that it may be, whence it may come
back by 7 m. An older view of the track says no more of what is behind it now."""


class TrackView(NamedTuple):
    seen_ns: int
    """By the master's clock; not before this the sections were as told."""
    counted: tuple[Counted, ...]
    """In running order."""
    occupied: tuple[SeenSection, ...]
    states: tuple[tuple[float, float, SectionState], ...]
    restrictions: tuple[SpeedRestriction, ...]
    closed: tuple[BarredTrack, ...]


def view_of(status: TrackStatus, line: AreaMap) -> TrackView:
    told = {each.section: each for each in status.sections}
    states = [(s.start_m, s.end_m, told[s.number]) for s in line.sections if s.number in told]
    return TrackView(
        status.echo_ns,
        tuple([Counted(start_m, end_m, s.occupied, s.axles) for start_m, end_m, s in states]),
        tuple([SeenSection(start_m, end_m) for start_m, end_m, s in states if s.occupied]),
        tuple(states),
        status.restrictions,
        tuple([BarredTrack(each.start_m, each.end_m, Bar.SHUT) for each in status.closed]),
    )


def way_m(duration_ns: int) -> float:
    """No train comes farther meanwhile."""
    return max(0, duration_ns) * S_PER_NS * SPEED_MAX_MPS


def hidden_between(
    view: TrackView,
    *,
    beyond_m: float,
    before_m: float,
    ahead_ns: int,
    then_m: float = -UNBOUNDED_M,
) -> BarredTrack | None:
    """An occupied section between two neighbours that neither of them is in.

    Args:
        beyond_m: the one behind has come no farther.
        before_m: protected rear of the one ahead, heard at `ahead_ns`.
        then_m: the same as it had been heard already when sections were seen.
    """
    drift_m = way_m(ahead_ns - view.seen_ns)
    bar = Bar.SHUT
    found = unexplained(view.occupied, beyond_m=beyond_m, before_m=max(before_m - drift_m, then_m))
    if found is None:
        bar = Bar.UNSURE
        found = unexplained(view.occupied, beyond_m=beyond_m, before_m=before_m - EXCUSED_M)
    return None if found is None else BarredTrack(found.start_m, found.end_m, bar)


def moved_on_m(view: TrackView, record: TrainRecord, *, overhang_m: float) -> float:
    """Where the rear of a silent train surely is by the sections that are clear behind it."""
    return cleared_to_m(record.rear_m, view.states, overhang_m=overhang_m)


def restrictions_for(
    restrictions: Sequence[SpeedRestriction], *, rear_m: float, end_m: float
) -> tuple[SpeedRestriction, ...]:
    """Those that a train meets on the way to the end of its authority."""
    return tuple([each for each in restrictions if each.end_m >= rear_m and each.start_m <= end_m])
