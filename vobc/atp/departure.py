"""The departure interlock: everything that keeps a standing train from setting off, by name."""

from collections.abc import Mapping
from typing import Final, NamedTuple

from can_dbc.vobc import Inhibit


class DepartureTerms(NamedTuple):
    """All that has to be true before a train sets off, each by itself."""

    doors_locked: bool
    """Every door of the train, or the bypass stands in for the proof."""
    platform_doors_locked: bool
    """The centre says so, or is silent while no platform is near, or the bypass stands in for the
    proof."""
    authority_ahead: bool
    """Some room to the end of a fresh authority."""
    not_held: bool
    """No order to stay at this platform."""
    no_passenger_alarm: bool
    """None that has to be answered at this platform."""
    no_fire: bool
    no_obstacle: bool
    """The deflector is heard and was not touched."""
    awake: bool
    no_emergency: bool
    """None is latched, and the centre orders none."""
    centre_heard: bool


INHIBIT_WITHOUT: Final[Mapping[str, Inhibit]] = {
    "doors_locked": Inhibit.DOORS,
    "platform_doors_locked": Inhibit.PLATFORM_DOORS,
    "authority_ahead": Inhibit.AUTHORITY,
    "not_held": Inhibit.HOLD,
    "no_passenger_alarm": Inhibit.PASSENGER_ALARM,
    "no_fire": Inhibit.FIRE,
    "no_obstacle": Inhibit.OBSTACLE,
    "awake": Inhibit.ASLEEP,
    "no_emergency": Inhibit.EMERGENCY,
    "centre_heard": Inhibit.CENTRE_SILENT,
}
"""What is said of a term that is not true."""

# Plain numbers: operators on an IntFlag cost a microsecond each, every cycle.
_WITHOUT: Final = tuple(int(INHIBIT_WITHOUT[term]) for term in DepartureTerms._fields)
_FLAGS: Final = tuple(Inhibit(number) for number in range(sum(_WITHOUT) + 1))

NOT_AGAINST_JOG: Final = Inhibit.HOLD | Inhibit.AUTHORITY
"""A train that is told to stay may move up to where its doors can open; how far it may go for
that, ahead and back, the jog has rules of its own."""


def inhibits(terms: DepartureTerms) -> Inhibit:
    """What stands against setting off; NONE only if every single term is true."""
    number = 0
    for term, flag in zip(terms, _WITHOUT, strict=True):
        if not term:
            number |= flag
    return _FLAGS[number]
