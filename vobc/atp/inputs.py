"""Which of the inputs that protection needs are there, and fresh."""

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
"""Whom a moving train must hear. Doors unheard count as unlocked and cut traction; a tag reader
that fell silent shows in the position interval; the authority has an age limit of its own; without
the detectors of obstacle and fire the train stays at the next station."""

FLAGS: Final = tuple(Missing(number) for number in range(2 * ALARMS))
"""From plain numbers back to flags."""

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


def silent(seen: CycleInput, config: AtpConfig, *, odometer_usable: bool) -> int:
    """Nodes that were never heard or not for too long, and an authority that is none any more.

    An odometer that cannot be right is no better than a silent one, an age that is no number no
    better than one that is too high. Flags of `Missing`.
    """
    timeouts = config.timeouts
    gone = 0
    if not seen.brake_age_s <= timeouts.brake_s:
        gone |= BRAKE
    if not seen.traction_age_s <= timeouts.traction_s:
        gone |= TRACTION
    if not seen.tacho_age_s <= timeouts.tacho_s or not odometer_usable:
        gone |= ODOMETER
    if not seen.doors_age_s <= timeouts.doors_s:
        gone |= DOORS
    if not seen.desk_age_s <= timeouts.desk_s:
        gone |= DESK
    if not seen.tag_reader_age_s <= timeouts.tag_reader_s:
        gone |= TAG_READER
    if not seen.alarms_age_s <= timeouts.alarms_s:
        gone |= ALARMS
    if seen.authority is None or not seen.authority_age_s <= config.authority_age_max_s:
        gone |= AUTHORITY
    return gone


def unready(seen: CycleInput, motion: Motion | None) -> int:
    """What is heard but says that it cannot do its work. Flags of `Missing`."""
    bad = 0
    if seen.brake is None or not seen.brake.ready:
        bad |= BRAKE
    if seen.traction is None or not seen.traction.ready:
        bad |= TRACTION
    if seen.tag_reader is None or not seen.tag_reader.antenna_ok:
        bad |= TAG_READER
    if motion is None or not motion.localised:
        bad |= LOCALISATION
    return bad


def in_words(missing: Missing) -> str:
    """What is missing, in a fixed order, for the log and the person at the desk."""
    return ", ".join(words for flag, words in WORDS.items() if flag in missing)
