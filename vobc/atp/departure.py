"""The departure interlock: the conditions for a standing train to depart."""

from collections.abc import Mapping
from typing import Final, NamedTuple

from can_dbc.vobc import Inhibit


class DepartureTerms(NamedTuple):
    """Conditions for departure. Each of them must be true."""

    doors_locked: bool
    """Every door of the train is proven locked, or the bypass replaces the proof."""
    platform_doors_locked: bool
    """The centre reports them locked, or the bypass replaces the proof. Away from platforms the
    centre may also be silent."""
    authority_ahead: bool
    """There is distance left to the end of a fresh authority."""
    not_held: bool
    """There is no order to stay at this platform."""
    no_passenger_alarm: bool
    """No passenger alarm requires the train to stay at this platform."""
    no_fire: bool
    no_obstacle: bool
    """The obstacle deflector reports that it was not touched."""
    awake: bool
    no_emergency: bool
    """No emergency is latched, and the centre orders none."""
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
"""Inhibit that is reported for each condition that is false."""

# Plain numbers: operators on an IntFlag cost a microsecond each, every cycle.
_WITHOUT: Final = tuple(int(INHIBIT_WITHOUT[term]) for term in DepartureTerms._fields)
_FLAGS: Final = tuple(Inhibit(number) for number in range(sum(_WITHOUT) + 1))

NOT_AGAINST_JOG: Final = Inhibit.HOLD | Inhibit.AUTHORITY
"""Inhibits that do not prevent a jog. A held train may move to where its doors can open. Separate
rules limit the distance of a jog."""


def inhibits(terms: DepartureTerms) -> Inhibit:
    """Inhibits against departure. NONE only if every condition is true."""
    number = 0
    for term, flag in zip(terms, _WITHOUT, strict=True):
        if not term:
            number |= flag
    return _FLAGS[number]
