"""Health of the tag reader on the bus; the telegrams themselves come on its serial line."""

from dataclasses import dataclass

from can_dbc.binding import complete, frame


@frame("tags.dbc", "TAG_READER_HEALTH")
@dataclass(frozen=True, slots=True)
class TagReaderHealth:
    antenna_ok: bool
    telegrams_sent: int
    """Count modulo 65536, which reveals telegrams lost on the serial line."""
    self_test_age_ms: float


complete("tags.dbc")
