"""Result of a replay, as a value that is sent as JSON."""

import msgspec


class ReplaySignalDifference(msgspec.Struct, frozen=True):
    name: str
    recorded: str
    """Value and unit."""
    replayed: str


class HeardInput(msgspec.Struct, frozen=True):
    """One input of the controller."""

    at_s: float
    """Time since the start of the controller, s."""
    name: str
    meaning: str


class CycleInputs(msgspec.Struct, frozen=True):
    """All inputs of one control cycle."""

    cycle: int
    at_s: float
    heard: tuple[HeardInput, ...]


class Divergence(msgspec.Struct, frozen=True, kw_only=True):
    """The first difference from the recorded outputs."""

    controller: int
    """Number of the controller, from 0; a fault may have started another one."""
    cycle: int
    """Number of control cycles before that of the difference."""
    at_s: float
    """Time since the start of this controller, s."""
    task: str
    wire: str
    key: str
    name: str
    kind: str
    """changed, missing (recorded only) or extra (sent this time only)."""
    recorded: str | None
    """Bytes in hexadecimal."""
    replayed: str | None
    signals: tuple[ReplaySignalDifference, ...]
    inputs: tuple[CycleInputs, ...]
    """Inputs of the cycle of the difference and of some before it, the oldest first."""


class KeyCounts(msgspec.Struct, frozen=True, kw_only=True):
    """Results for one identifier over the whole recording."""

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
    """Remarks about how the outputs were compared."""

    @property
    def compared(self) -> int:
        """Number of recorded outputs."""
        return sum(each.same + each.masked + each.changed + each.missing for each in self.counts)
