"""What a controller says of itself, outside of its cycles."""

from can_dbc.vobc import EventKind, Supervision
from vobc.vocabulary import Event


def memory_lost() -> Event:
    """The board's memory cannot be trusted: what it knew of place, wheel and terms is gone."""
    words = "the memory of the board cannot be read: place, wheel and highest term are forgotten"
    return Event(EventKind.MEMORY_LOST, words)


def controller_ends() -> Event:
    words = "the controller ends: the safe output was its last word"
    return Event(EventKind.SUPERVISION, words, (), int(Supervision.EMERGENCY))
