"""Which of the inputs that protection needs are there, and fresh."""

from can_dbc.vobc import Missing
from vobc.atp.config import AtpConfig
from vobc.vocabulary import CycleInput, Motion

VITAL_IN_MOTION = Missing.BRAKE | Missing.TRACTION | Missing.ODOMETER | Missing.DESK
"""Whom a moving train must hear. Doors unheard count as unlocked and cut traction; a tag reader
that fell silent shows in the position interval; the authority has an age limit of its own."""

WORDS = {
    Missing.BRAKE: "brake unit",
    Missing.TRACTION: "traction unit",
    Missing.ODOMETER: "odometer",
    Missing.DOORS: "door unit",
    Missing.DESK: "desk",
    Missing.TAG_READER: "tag reader",
    Missing.AUTHORITY: "movement authority",
    Missing.LOCALISATION: "localisation",
}


def silent(seen: CycleInput, config: AtpConfig) -> Missing:
    """Nodes that were never heard or not for too long, and an authority that is none any more."""
    timeouts = config.timeouts
    gone = Missing.NOTHING
    if seen.brake_age_s > timeouts.brake_s:
        gone |= Missing.BRAKE
    if seen.traction_age_s > timeouts.traction_s:
        gone |= Missing.TRACTION
    if seen.tacho_age_s > timeouts.tacho_s:
        gone |= Missing.ODOMETER
    if seen.doors_age_s > timeouts.doors_s:
        gone |= Missing.DOORS
    if seen.desk_age_s > timeouts.desk_s:
        gone |= Missing.DESK
    if seen.tag_reader_age_s > timeouts.tag_reader_s:
        gone |= Missing.TAG_READER
    if seen.authority is None or seen.authority_age_s > config.authority_age_max_s:
        gone |= Missing.AUTHORITY
    return gone


def unready(seen: CycleInput, motion: Motion | None, *, odometer_usable: bool) -> Missing:
    """What is heard but says that it cannot do its work."""
    bad = Missing.NOTHING
    if seen.brake is None or not seen.brake.ready:
        bad |= Missing.BRAKE
    if seen.traction is None or not seen.traction.ready:
        bad |= Missing.TRACTION
    if seen.tag_reader is None or not seen.tag_reader.antenna_ok:
        bad |= Missing.TAG_READER
    if motion is None or not odometer_usable:
        bad |= Missing.ODOMETER
    if motion is None or not motion.localised:
        bad |= Missing.LOCALISATION
    return bad


def in_words(missing: Missing) -> str:
    """What is missing, in a fixed order, for the log and the person at the desk."""
    return ", ".join(words for flag, words in WORDS.items() if flag in missing)
