"""Puts what a controller said beside what was recorded, and finds where they part."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from metro_hil.replay.meaning import measured_only
from metro_hil.replay.recording import Output, RecordedStep


class Placed(NamedTuple):
    """An output with the step in which it was said."""

    step: int
    order: int
    """Within its step."""
    at_ns: int
    output: Output


@dataclass(slots=True)
class Counts:
    """Of one identifier."""

    same: int = 0
    masked: int = 0
    """The same but for what the host did to them."""
    changed: int = 0
    missing: int = 0
    """Recorded, and not said this time."""
    extra: int = 0
    """Said this time only."""

    @property
    def different(self) -> int:
        return self.changed + self.missing + self.extra


class ReplayDifference(NamedTuple):
    """One place where both part; one of them is None for what was missing or extra."""

    recorded: Placed | None
    replayed: Placed | None

    @property
    def place(self) -> tuple[int, int, int]:
        """Order in time. At one place what was recorded counts first."""
        at = self.recorded or self.replayed
        assert at is not None
        return at.at_ns, at.step, at.order


@dataclass(slots=True)
class ReplayComparison:
    counts: dict[tuple[str, str], Counts] = field(default_factory=dict)
    """By wire and key."""
    first: ReplayDifference | None = None

    @property
    def identical(self) -> bool:
        return self.first is None


def placed(steps: Sequence[RecordedStep], said: Iterable[Sequence[Output]]) -> list[Placed]:
    return [
        Placed(at, order, steps[at].begin_ns, output)
        for at, outputs in enumerate(said)
        for order, output in enumerate(outputs)
    ]


def compare(
    recorded: Sequence[Placed],
    replayed: Sequence[Placed],
    *,
    tolerance_ns: int = 0,
    mask: bool = False,
) -> ReplayComparison:
    """Aligned for each identifier by content and instant.

    Args:
        tolerance_ns: two payloads so far apart in time may be a pair.
        mask: what tells only of the host may differ.
    """
    result = ReplayComparison()
    mine, theirs = _by_key(recorded), _by_key(replayed)
    for key in sorted(mine.keys() | theirs.keys()):
        counts = result.counts[key] = Counts()
        for difference in _aligned(mine.get(key, []), theirs.get(key, []), tolerance_ns, counts):
            one, other = difference
            if one is not None and other is not None:
                if mask and measured_only(one.output, other.output):
                    counts.masked += 1
                    continue
                counts.changed += 1
            elif other is None:
                counts.missing += 1
            else:
                counts.extra += 1
            if result.first is None or difference.place < result.first.place:
                result.first = difference
    return result


def _by_key(outputs: Sequence[Placed]) -> dict[tuple[str, str], list[Placed]]:
    found: dict[tuple[str, str], list[Placed]] = {}
    for each in outputs:
        found.setdefault((each.output.wire, each.output.key), []).append(each)
    return found


def _aligned(
    mine: Sequence[Placed], theirs: Sequence[Placed], tolerance_ns: int, counts: Counts
) -> Iterable[ReplayDifference]:
    """Every pair that is not equal, and everything without a pair. Both are in order of time."""
    at = 0
    for one in mine:
        while at < len(theirs) and theirs[at].at_ns < one.at_ns - tolerance_ns:
            yield ReplayDifference(None, theirs[at])
            at += 1
        partner = _partner(one, theirs, at, tolerance_ns)
        if partner is None:
            yield ReplayDifference(one, None)
            continue
        for extra in theirs[at:partner]:
            yield ReplayDifference(None, extra)
        at = partner + 1
        if one.output.data == theirs[partner].output.data:
            counts.same += 1
        else:
            yield ReplayDifference(one, theirs[partner])
    for extra in theirs[at:]:
        yield ReplayDifference(None, extra)


def _partner(one: Placed, theirs: Sequence[Placed], first: int, tolerance_ns: int) -> int | None:
    """The equal one within the tolerance, counter included; else the nearest in time."""
    nearest: int | None = None
    for at in range(first, len(theirs)):
        other = theirs[at]
        if other.at_ns > one.at_ns + tolerance_ns:
            break
        if other.output.data == one.output.data:
            return at
        if nearest is None or abs(other.at_ns - one.at_ns) < abs(theirs[nearest].at_ns - one.at_ns):
            nearest = at
    return nearest
