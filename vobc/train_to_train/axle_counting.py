"""The newest track status of an area as its master received it, with the time it is valid for."""

from collections.abc import Sequence
from typing import Final, NamedTuple

from firmware_py.trackdb.areas import AreaMap
from vobc.train_to_train.authority import Bar, BarredTrack, Counted, SeenSection, unexplained
from vobc.train_to_train.occupancy import UNBOUNDED_M, TrainRecord, cleared_to_m
from zenoh_config.messages import SpeedRestriction
from zenoh_config.t2t import SectionState, TrackStatus

SPEED_MAX_MPS = 40.0
"""Upper bound of any train's speed. It bounds where a train was when the wayside read the sections.
"""
S_PER_NS = 1e-9
EXCUSED_M: Final = 5.0
"""Distance behind the free track of the train ahead within which that train may itself explain an
occupied section.

A new train is placed at least 20 m from where others report that they may be. It may come back from
there by 7 m. Behind this distance an older track status says nothing about the present.
"""


class TrackView(NamedTuple):
    seen_ns: int
    """Time of the status by the master's clock. The sections were in this state at this time or
    later."""
    counted: tuple[Counted, ...]
    """Sections with their axle counts, in running order."""
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
    """Upper bound of the distance that a train covers in this time."""
    return max(0, duration_ns) * S_PER_NS * SPEED_MAX_MPS


def hidden_between(
    view: TrackView,
    *,
    beyond_m: float,
    before_m: float,
    ahead_ns: int,
    then_m: float = -UNBOUNDED_M,
) -> BarredTrack | None:
    """Find an occupied section that neither of two neighbouring trains can be in.

    Args:
        beyond_m: farthest place that the train behind has reached.
        before_m: protected rear of the train ahead, received at `ahead_ns`.
        then_m: the same rear as known when the wayside read the sections.
    """
    drift_m = way_m(ahead_ns - view.seen_ns)
    bar = Bar.SHUT
    found = unexplained(view.occupied, beyond_m=beyond_m, before_m=max(before_m - drift_m, then_m))
    if found is None:
        bar = Bar.UNSURE
        found = unexplained(view.occupied, beyond_m=beyond_m, before_m=before_m - EXCUSED_M)
    return None if found is None else BarredTrack(found.start_m, found.end_m, bar)


def moved_on_m(view: TrackView, record: TrainRecord, *, overhang_m: float) -> float:
    """Hindmost possible place of a silent train's rear, given the clear sections behind it."""
    return cleared_to_m(record.rear_m, view.states, overhang_m=overhang_m)


def restrictions_for(
    restrictions: Sequence[SpeedRestriction], *, rear_m: float, end_m: float
) -> tuple[SpeedRestriction, ...]:
    """Restrictions that a train meets up to the end of its authority."""
    return tuple([each for each in restrictions if each.end_m >= rear_m and each.start_m <= end_m])
