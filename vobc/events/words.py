"""Names, flags and places in plain words."""

import enum

from vobc.vocabulary import CycleOutput


def name_words(value: enum.Enum) -> str:
    return value.name.replace("_", " ").lower()


def flag_words(flags: enum.IntFlag) -> str:
    """Each flag that is set, in the order of their numbers."""
    return ", ".join(name_words(flag) for flag in type(flags) if flag and flag in flags)


def place_words(output: CycleOutput) -> str:
    """Where, and how fast; empty while nothing is known of either."""
    motion = output.motion
    if motion is None:
        return ""
    speed_mps, front = motion.speed_mps.best, motion.front_m
    speed = "at standstill" if motion.standstill else f"at {speed_mps:.2f} m/s"
    if not motion.localised:
        return f", {speed}, place unknown"
    return f", {speed}, front between {front.low:.2f} m and {front.high:.2f} m"
