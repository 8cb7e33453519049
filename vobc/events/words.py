"""Text of names, flags and places."""

import enum

from vobc.vocabulary import CycleOutput


def name_words(value: enum.Enum) -> str:
    return value.name.replace("_", " ").lower()


def flag_words(flags: enum.IntFlag) -> str:
    """The set flags, in the order of their numbers."""
    return ", ".join(name_words(flag) for flag in type(flags) if flag and flag in flags)


def place_words(output: CycleOutput) -> str:
    """Text of place and speed. Empty while both are unknown."""
    motion = output.motion
    if motion is None:
        return ""
    speed_mps, front = motion.speed_mps.best, motion.front_m
    speed = "at standstill" if motion.standstill else f"at {speed_mps:.2f} m/s"
    if not motion.localised:
        return f", {speed}, place unknown"
    return f", {speed}, front between {front.low:.2f} m and {front.high:.2f} m"
