"""Events of odometry: tags, slip, wheel calibration, and localisation."""

from collections.abc import Iterator, Sequence
from typing import Final

from can_dbc.vobc import EventKind
from vobc.vocabulary import Event, Motion, Source

WHEEL_STEP_M: Final = 1e-4
"""Change of the wheel diameter below which a calibration is not reported."""
MM_PER_M: Final = 1000.0


def motion_changed(before: Motion | None, motion: Motion) -> Sequence[Event]:
    """Events of a changed motion. The check is cheap, because it runs in every cycle."""
    if (
        before is not None
        and motion.localised is before.localised
        and motion.slip is before.slip
        and not motion.accepted_tag_ids
        and not motion.refused_tags
        and motion.missed_tags <= before.missed_tags
        and abs(motion.wheel_diameter_m - before.wheel_diameter_m) < WHEEL_STEP_M
    ):
        return ()
    return (*_place(before, motion), *_tags(before, motion), *_wheels(before, motion))


def _place(before: Motion | None, motion: Motion) -> Iterator[Event]:
    was = before is not None and before.localised
    front = motion.front_m
    if motion.localised and not was:
        words = f"the train is localised: front between {front.low:.2f} m and {front.high:.2f}"
        # Without a tag the sources are the board's memory and the cold-movement detector.
        source = Source.TAG if motion.accepted_tag_ids else Source.COLD
        yield Event(EventKind.LOCALISATION_FOUND, f"{words} m", (source, Source.TACHO))
    elif was and not motion.localised:
        words = f"the train has lost its position: {motion.lost_cause or 'cause unknown'}"
        yield Event(EventKind.LOCALISATION_LOST, words, (Source.TACHO, Source.TAG))


def _tags(before: Motion | None, motion: Motion) -> Iterator[Event]:
    front = motion.front_m
    for tag_id in motion.accepted_tag_ids:
        words = f"tag {tag_id} corrects the position: front now between {front.low:.2f} m and"
        yield Event(
            EventKind.TAG_ACCEPTED,
            f"{words} {front.high:.2f} m",
            (Source.TAG, Source.TACHO),
            tag_id,
        )
    for refused in motion.refused_tags:
        words = f"tag {refused.tag_id} refused: {refused.reason.value}"
        if refused.off_m:
            words += f", off by {refused.off_m:+.2f} m"
        yield Event(EventKind.TAG_REJECTED, words, (Source.TAG, Source.TACHO), refused.tag_id)
    missed = 0 if before is None else before.missed_tags
    if motion.missed_tags > missed:
        words = f"an expected tag was not read; {motion.missed_tags} missed in a row"
        yield Event(
            EventKind.TAG_MISSED, words, (Source.TACHO, Source.TAG_READER), motion.missed_tags
        )


def _wheels(before: Motion | None, motion: Motion) -> Iterator[Event]:
    sources = (Source.TACHO, Source.DOPPLER, Source.IMU)
    slipped = before is not None and before.slip
    speed = motion.speed_mps
    if motion.slip and not slipped:
        words = f"wheels slip or slide: speed between {speed.low:.2f} m/s and {speed.high:.2f} m/s"
        yield Event(EventKind.SLIP_BEGAN, words, sources)
    elif slipped and not motion.slip:
        words = f"wheels roll again: speed between {speed.low:.2f} m/s and {speed.high:.2f} m/s"
        yield Event(EventKind.SLIP_ENDED, words, sources)
    if before is None or before.wheel_diameter_m <= 0.0:
        return
    if abs(motion.wheel_diameter_m - before.wheel_diameter_m) >= WHEEL_STEP_M:
        words = (
            f"wheel calibrated to {motion.wheel_diameter_m * MM_PER_M:.1f} mm, it was"
            f" {before.wheel_diameter_m * MM_PER_M:.1f} mm"
        )
        yield Event(EventKind.WHEEL_CALIBRATED, words, (Source.TAG, Source.TACHO))
