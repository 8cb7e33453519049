"""Compares a controller's outputs with the recorded ones and finds the first difference."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from metro_hil.replay.meaning import measured_only
from metro_hil.replay.recording import Output, RecordedStep


class Placed(NamedTuple):
    """An output with the step in which the controller sent it."""

    step: int
    order: int
    """Place within its step."""
    at_ns: int
    output: Output


@dataclass(slots=True)
class Counts:
    """Results of the comparison for one identifier."""

    same: int = 0
    masked: int = 0
    """Outputs that differ only in what the host's timing determines."""
    changed: int = 0
    missing: int = 0
    """Outputs that were recorded but not sent this time."""
    extra: int = 0
    """Outputs that were only sent this time."""

    @property
    def different(self) -> int:
        return self.changed + self.missing + self.extra


class ReplayDifference(NamedTuple):
    """One difference; one side is None if an output is missing or extra."""

    recorded: Placed | None
    replayed: Placed | None

    @property
    def place(self) -> tuple[int, int, int]:
        """Key for the order in time; at equal times the recorded output comes first."""
        at = self.recorded or self.replayed
        assert at is not None
        return at.at_ns, at.step, at.order


@dataclass(slots=True)
class ReplayComparison:
    counts: dict[tuple[str, str], Counts] = field(default_factory=dict)
    """Results by wire and key."""
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
    """Compare the outputs of each identifier, aligned by content and time.

    Args:
        tolerance_ns: greatest time difference of a pair.
        mask: whether signals that depend only on the host may differ.
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
    """Every unequal pair, and every output without a pair. Both inputs are in order of time."""
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
    """Index of an equal output within the tolerance, including its counter; else the nearest."""
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
