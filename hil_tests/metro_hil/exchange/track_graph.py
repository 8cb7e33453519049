"""Finds the path of a train through track sections that switches connect."""

import heapq
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple


@dataclass(frozen=True, slots=True)
class PlaceOnTrack:
    """A place on a track section, from its begin."""

    track: str
    position_m: float


class PathState(NamedTuple):
    """How far the search for a path has come."""

    reached: int
    """Number of stops on the way."""
    track: str
    forward: bool
    offset_m: float


@dataclass(frozen=True, slots=True)
class PathPiece:
    """A part of the path on one track section; offsets count from where the train enters it."""

    track: str
    forward: bool
    """Whether the train runs from the begin of the section to its end."""
    length_m: float
    """Length of the whole section."""
    from_m: float
    to_m: float
    chainage_m: float
    """Chainage of the path at `from_m`."""

    @property
    def run_m(self) -> float:
        """How far the path runs on the section."""
        return self.to_m - self.from_m

    def moved(self, shift_m: float) -> "PathPiece":
        """The piece with other chainages."""
        return replace(self, chainage_m=self.chainage_m + shift_m)

    def extended(self, to_begin: bool, to_end: bool) -> "PathPiece":
        """The piece up to one or both ends of its section."""
        back_m = self.from_m if to_begin else 0.0
        return replace(
            self,
            from_m=self.from_m - back_m,
            chainage_m=self.chainage_m - back_m,
            to_m=self.length_m if to_end else self.to_m,
        )

    def at_m(self, position_m: float) -> float:
        """Chainage of a position on the section."""
        return self.offset_m(position_m) + self.chainage_m - self.from_m

    def offset_m(self, position_m: float) -> float:
        """The offset of a position on the section."""
        return position_m if self.forward else self.length_m - position_m

    def chainages_m(self, begin_m: float, end_m: float) -> tuple[float, float]:
        """The part of a range of the section that lies on the path; empty if start >= end."""
        ends_m = sorted(self.offset_m(at_m) for at_m in (begin_m, end_m))
        start_m, finish_m = max(ends_m[0], self.from_m), min(ends_m[1], self.to_m)
        shift_m = self.chainage_m - self.from_m
        return start_m + shift_m, finish_m + shift_m


@dataclass(frozen=True, slots=True)
class TrackGraph:
    """Track sections and the ends at which they meet; an end is a section and true at its end."""

    lengths_m: Mapping[str, float]
    links: Mapping[tuple[str, bool], Sequence[tuple[str, bool]]]

    def next_of(self, track: str, forward: bool) -> list[tuple[str, bool]]:
        """The sections that a train may enter next, and whether it then runs forward."""
        return [(other, not at_end) for other, at_end in self.links.get((track, forward), ())]

    def single_run(self) -> list[PathPiece] | None:
        """All sections in a row, from the end that the file names first; None if there is none."""
        ends = [(track, at_end) for track in self.lengths_m for at_end in (False, True)]
        open_ends = [end for end in ends if not self.links.get(end)]
        if len(open_ends) != 2 or any(len(there) > 1 for there in self.links.values()):
            return None
        track, at_end = open_ends[0]
        run, state = [], [(track, not at_end)]
        while state:
            track, forward = state[0]
            length_m = self.lengths_m[track]
            run.append(PathPiece(track, forward, length_m, 0.0, length_m, 0.0))
            state = self.next_of(track, forward)
        return run if len(run) == len(self.lengths_m) else None


def shortest_path(
    graph: TrackGraph, stops: Sequence[Sequence[PlaceOnTrack]]
) -> tuple[list[PathPiece], list[float]] | None:
    """The shortest path through all stops in order, and their chainages; None if there is none.

    Each stop may lie on several tracks. The train never turns round. Dijkstra's algorithm; a state
    is the number of stops reached, a section, a direction and an offset.
    """
    count = itertools.count()
    queue: list[tuple[float, int, PathState, PathState | None]] = []
    for place in stops[0]:
        for forward in (True, False):
            length_m = graph.lengths_m[place.track]
            offset_m = place.position_m if forward else length_m - place.position_m
            heapq.heappush(
                queue, (0.0, next(count), PathState(1, place.track, forward, offset_m), None)
            )
    before: dict[PathState, PathState | None] = {}
    cost_of: dict[PathState, float] = {}
    while queue:
        cost_m, _, state, parent = heapq.heappop(queue)
        if state in before:
            continue
        before[state], cost_of[state] = parent, cost_m
        reached, track, forward, at_m = state
        if reached == len(stops):
            return _unwound(graph, state, before, cost_of)
        length_m = graph.lengths_m[track]
        for place in stops[reached]:
            offset_m = place.position_m if forward else length_m - place.position_m
            if place.track == track and offset_m >= at_m:
                after = PathState(reached + 1, track, forward, offset_m)
                heapq.heappush(queue, (cost_m + offset_m - at_m, next(count), after, state))
        for other, onward in graph.next_of(track, forward):
            after = PathState(reached, other, onward, 0.0)
            heapq.heappush(queue, (cost_m + length_m - at_m, next(count), after, state))
    return None


def _unwound(
    graph: TrackGraph,
    last: PathState,
    before: Mapping[PathState, PathState | None],
    cost_of: Mapping[PathState, float],
) -> tuple[list[PathPiece], list[float]]:
    """Trace the path back from its last state; return its pieces and the places of its stops."""
    states = [last]
    while (parent := before[states[-1]]) is not None:
        states.append(parent)
    states.reverse()
    stops_m = [cost_of[states[0]]]
    pieces: list[PathPiece] = []
    first = states[0]
    for here, there in itertools.pairwise(states):
        if there.reached != here.reached:
            stops_m.append(cost_of[there])
            continue
        pieces.append(_piece(graph, first, graph.lengths_m[first.track], cost_of[first]))
        first = there
    pieces.append(_piece(graph, first, last.offset_m, cost_of[first]))
    return pieces, stops_m


def _piece(graph: TrackGraph, first: PathState, to_m: float, chainage_m: float) -> PathPiece:
    _, track, forward, from_m = first
    return PathPiece(track, forward, graph.lengths_m[track], from_m, to_m, chainage_m)
