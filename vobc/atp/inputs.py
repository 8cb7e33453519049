"""Presence and age of the inputs that protection needs."""

from typing import Final

from can_dbc.vobc import Missing
from vobc.atp.config import AtpConfig
from vobc.vocabulary import CycleInput, Motion

# Plain numbers in here: operators on an IntFlag cost a microsecond each, every cycle.
BRAKE: Final = int(Missing.BRAKE)
TRACTION: Final = int(Missing.TRACTION)
ODOMETER: Final = int(Missing.ODOMETER)
DOORS: Final = int(Missing.DOORS)
DESK: Final = int(Missing.DESK)
TAG_READER: Final = int(Missing.TAG_READER)
AUTHORITY: Final = int(Missing.AUTHORITY)
LOCALISATION: Final = int(Missing.LOCALISATION)
ALARMS: Final = int(Missing.ALARMS)

VITAL_IN_MOTION: Final = BRAKE | TRACTION | ODOMETER | DESK
"""Inputs without which a moving train brakes by emergency.

A silent door unit counts as unlocked and cuts traction. A silent tag reader widens the position
interval. An authority has its own age limit. Without obstacle and fire detectors the train stays at
the next station.
"""

FLAGS: Final = tuple(Missing(number) for number in range(2 * ALARMS))
"""Flag sets by number."""

WORDS: Final = {
    Missing.BRAKE: "brake unit",
    Missing.TRACTION: "traction unit",
    Missing.ODOMETER: "odometer",
    Missing.DOORS: "door unit",
    Missing.DESK: "desk",
    Missing.TAG_READER: "tag reader",
    Missing.AUTHORITY: "movement authority",
    Missing.LOCALISATION: "localisation",
    Missing.ALARMS: "obstacle and fire detection",
}


def silent(inputs: CycleInput, config: AtpConfig, *, odometer_usable: bool) -> int:
    """Flags of `Missing` for silent nodes and for an expired authority.

    An authority without the restrictions that belong to it is none. They come with the orders. An
    implausible odometer counts as silent, and a NaN age as too old.
    """
    timeouts = config.timeouts
    gone = 0
    if not inputs.brake_age_s <= timeouts.brake_s:
        gone |= BRAKE
    if not inputs.traction_age_s <= timeouts.traction_s:
        gone |= TRACTION
    if not inputs.tacho_age_s <= timeouts.tacho_s or not odometer_usable:
        gone |= ODOMETER
    if not inputs.doors_age_s <= timeouts.doors_s:
        gone |= DOORS
    if not inputs.desk_age_s <= timeouts.desk_s:
        gone |= DESK
    if not inputs.tag_reader_age_s <= timeouts.tag_reader_s:
        gone |= TAG_READER
    if not inputs.alarms_age_s <= timeouts.alarms_s:
        gone |= ALARMS
    if inputs.authority is None or not inputs.authority_age_s <= config.authority_age_max_s:
        gone |= AUTHORITY
    if inputs.orders is None or not inputs.orders_age_s <= config.restrictions_age_max_s:
        gone |= AUTHORITY
    return gone


def unready(inputs: CycleInput, motion: Motion | None) -> int:
    """Flags of `Missing` for nodes that report that they are not ready."""
    bad = 0
    if inputs.brake is None or not inputs.brake.ready:
        bad |= BRAKE
    if inputs.traction is None or not inputs.traction.ready:
        bad |= TRACTION
    if inputs.tag_reader is None or not inputs.tag_reader.antenna_ok:
        bad |= TAG_READER
    if motion is None or not motion.localised:
        bad |= LOCALISATION
    return bad


def in_words(missing: Missing) -> str:
    """Text of the missing inputs in a fixed order, for the log and the driver's desk."""
    return ", ".join(words for flag, words in WORDS.items() if flag in missing)
