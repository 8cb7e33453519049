"""What a replay found, as a value that travels as JSON."""

import msgspec


class ReplaySignalDifference(msgspec.Struct, frozen=True):
    name: str
    recorded: str
    """Value and unit."""
    replayed: str


class HeardInput(msgspec.Struct, frozen=True):
    """Something that was handed to the controller."""

    at_s: float
    """When it came, since the start of the controller."""
    name: str
    meaning: str


class CycleInputs(msgspec.Struct, frozen=True):
    """All that one control cycle was fed with."""

    cycle: int
    at_s: float
    heard: tuple[HeardInput, ...]


class Divergence(msgspec.Struct, frozen=True, kw_only=True):
    """The first place where the controller said something else."""

    controller: int
    """0 for the first of the run; a fault may have started another."""
    cycle: int
    """Control cycles before it, that of the difference not counted: from 0."""
    at_s: float
    """Since the start of this controller."""
    task: str
    wire: str
    key: str
    name: str
    kind: str
    """changed, missing (recorded only) or extra (said this time only)."""
    recorded: str | None
    """Bytes in hexadecimal."""
    replayed: str | None
    signals: tuple[ReplaySignalDifference, ...]
    inputs: tuple[CycleInputs, ...]
    """Of the cycle of the difference, and of some before, oldest first."""


class KeyCounts(msgspec.Struct, frozen=True, kw_only=True):
    """Of one identifier over the whole recording."""

    wire: str
    key: str
    name: str
    same: int
    masked: int
    changed: int
    missing: int
    extra: int


class ReplayResult(msgspec.Struct, frozen=True, kw_only=True):
    recording: str
    identical: bool
    controllers: int
    cycles: int
    heard_frames: int
    heard_chunks: int
    heard_messages: int
    counts: tuple[KeyCounts, ...]
    first: Divergence | None
    notes: tuple[str, ...] = ()
    """What a reader has to know of how it was compared."""

    @property
    def compared(self) -> int:
        """Outputs that were recorded."""
        return sum(each.same + each.masked + each.changed + each.missing for each in self.counts)
