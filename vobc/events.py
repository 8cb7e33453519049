"""What changed from one cycle to the next, told as events with their cause and their sources."""

from collections.abc import Sequence

from vobc.vocabulary import CycleInput, CycleOutput, Event


def events_between(
    before: CycleOutput | None, seen: CycleInput, output: CycleOutput
) -> Sequence[Event]:
    """Everything that the step from `before` to `output` decided, the weightiest first."""
    raise NotImplementedError
