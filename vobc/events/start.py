"""Events of a controller outside of its cycles."""

from can_dbc.vobc import EventKind, Supervision
from vobc.vocabulary import Event


def memory_lost() -> Event:
    """The board's memory is unreadable: place, wheel and terms are lost."""
    words = "the memory of the board cannot be read: place, wheel and highest term are lost"
    return Event(EventKind.MEMORY_LOST, words)


def memory_foreign(why: str) -> Event:
    """The board's memory belongs to another line, survey, train or version."""
    words = f"the memory of the board is not used for place and wheel: {why}"
    return Event(EventKind.MEMORY_LOST, words)


def controller_ends() -> Event:
    words = "the controller ends with the safe output"
    return Event(EventKind.SUPERVISION, words, (), int(Supervision.EMERGENCY))
