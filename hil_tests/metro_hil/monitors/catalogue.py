"""The safety invariants: which are watched here and how, and why the others are not."""

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class Invariant:
    """One safety invariant, or a part of one that has a unit of its own."""

    number: int
    """The one of the requirement, `INV-04` for 4."""
    name: str
    """`inv-04-civil-limit`; for one that is not watched, `inv-10`."""
    text: str
    unit: str = ""
    margin: str = ""
    """What the margin is and when there is one."""
    why_not: str = ""
    """Why it is not watched; empty for one that is."""

    @property
    def requirement(self) -> str:
        return f"INV-{self.number:02d}"

    @property
    def watched(self) -> bool:
        return not self.why_not


def _watched(number: int, word: str, unit: str, text: str, margin: str) -> Invariant:
    return Invariant(number, f"inv-{number:02d}-{word}", text, unit, margin)


def _not(number: int, text: str, why_not: str) -> Invariant:
    return Invariant(number, f"inv-{number:02d}", text, why_not=why_not)


ONE_TRAIN: Final = "there is one train and one issuer of authorities, so it cannot be broken here"
NO_ENTRY: Final = "neither truth nor frames say it"

INVARIANTS: Final[tuple[Invariant, ...]] = (
    _watched(
        1,
        "stopping-distance",
        "m",
        "The true front and the true stopping distance stay inside the authority while the "
        "guaranteed emergency brake rate holds.",
        "End of authority less front less way to standstill, if the emergency brake were asked for "
        "now: traction gains what it gains now until it is cut after 0.30 s, the train rolls on "
        "its gradient for the declared dead time and lag of its emergency brake, then loses 1.0 "
        "m/s² over the true heights of the line. Of a brake that is asked for already, only what "
        "is left of these times counts. Judged while the train moves forwards, not on sight, and "
        "rail and brake give the guaranteed rate.",
    ),
    _watched(
        2,
        "authority-end",
        "m",
        "The true front never passes the end of authority.",
        "End of authority less true front, while the train moves and is not on sight.",
    ),
    _watched(
        3,
        "emergency-at-curve",
        "s",
        "At its own emergency curve the controller commands the emergency brake within one cycle.",
        "One cycle and the bus (0.02 s) less the time from a VOBC_MOTION to the command, once its "
        "speed and the reach in the VOBC_MODE of its cycle, less the 0.05 m/s that this is rounded "
        "up by, are over its emergency limit.",
    ),
    _watched(
        4,
        "civil-limit",
        "m/s",
        "True speed stays under civil limit, emergency margin and worst overshoot, for the whole "
        "train.",
        "Least limit under the train + 8 km/h + what a runaway of 1.0 m/s² and the steepest fall "
        "under the train add until traction is cut and the brake bites, less true speed.",
    ),
    _watched(
        5,
        "emergency-held",
        "1",
        "The emergency brake stays commanded until the train stands and a reset is given.",
        "1, or -1 when it is released while the train moves, or when the state EMERGENCY ends "
        "otherwise than at standstill within 5 s of a press of the reset or a release by the "
        "centre; an overshoot may release itself at standstill. One that the brake unit applies by "
        "itself counts as well, from 3 s after the last release on, when that has to be reported: "
        "while the train moves it may be off for 0.2 s at most, and 0.25 s more where frames may "
        "be held up, until the controller asks for it, too. A controller that was started again "
        "begins braked and knows neither its place nor what was latched. Whether the cause is gone "
        "is not on the bus.",
    ),
    _watched(
        6,
        "traction-off",
        "s",
        "The emergency brake takes tractive effort away within 0.30 s.",
        "0.30 s less the time for which effort acts after the brake unit wants the emergency "
        "brake. Exercised if effort acted when it began.",
    ),
    _watched(
        7,
        "demand-ignored",
        "1",
        "Under the emergency brake the train ignores what operation asks of traction.",
        "1, or -1 for effort at the rail more than 0.30 s after the emergency brake was wanted. "
        "Exercised while TRACTION_CMD permits and asks for effort.",
    ),
    _watched(
        8,
        "rollback",
        "m",
        "The train rolls back 2 m at most.",
        "2 m less the way back from the foremost place, from 2 cm on; a jog back does not count. "
        "The trip at 0.5 m by the "
        "controller's own measure is not on the bus.",
    ),
    _watched(
        9,
        "direction",
        "1",
        "Nothing drives the train against its authorised direction.",
        "1, or -1 for a TRACTION_CMD that asks for effort and not forwards; backwards is right in "
        "a "
        "jog, which VOBC_MODE has to say within 0.3 s. Exercised while effort is asked for. How "
        "far it rolls is invariant 8.",
    ),
    _watched(
        10,
        "jog-distance",
        "m",
        "A jog goes 5 m at most.",
        "5 m less the way from the standstill before it, while VOBC_MODE says that the train jogs "
        "and the emergency brake is off.",
    ),
    _watched(
        10,
        "jog-speed",
        "m/s",
        "A jog is slow.",
        "5 km/h + 5 km/h of margin + what a runaway adds, as in 4, less true speed. That a jog in "
        "order stays under 5 km/h is asked by its scenarios.",
    ),
    _watched(
        10,
        "jog-attempts",
        "1",
        "There are three jogs at a stop at most.",
        "3 less the jogs that set off within 20 m of the first of them.",
    ),
    _watched(
        10,
        "jog-covered",
        "m",
        "A jog back stays inside the authority.",
        "True rear less the rear end of the newest authority, while the train jogs back.",
    ),
    _watched(
        11,
        "mode-up",
        "1",
        "A higher mode takes what it rests on.",
        "1, or -1 when VOBC_MODE goes to authorised and the VOBC_STATUS after it misses place or "
        "authority, or there is none ahead of the train; or to creep without an order, or to "
        "restricted without order or request in the 5 s before it.",
    ),
    _watched(
        12,
        "restricted-speed",
        "m/s",
        "A train on sight runs at 25 km/h and margin at most.",
        "25 km/h + 5 km/h + what a runaway adds, as in 4, less true speed, while VOBC_MODE says "
        "restricted or creep.",
    ),
    _watched(
        13,
        "position-interval",
        "m",
        "The position interval holds the true front.",
        "The uncertainty of VOBC_POSITION less the distance of the true front from the claimed "
        "one. A claim speaks of the begin of its cycle or of one that was missed, so it may be so "
        "much and 0.02 s older than its frame. One that comes out of its rhythm may have waited "
        "for the bus; it and those of the 2 s after it are not judged.",
    ),
    _watched(
        14,
        "narrowed-by-tag",
        "1",
        "The position interval narrows only by a tag.",
        "1, or -1 when the claimed uncertainty falls by more than 0.2 m under the least of the "
        "five claims before and the reader has read no tag in the 2 s before the last of them, nor "
        "since. Claims made while "
        "TACHO is not heard, or out of their rhythm, are passed over.",
    ),
    _watched(
        15,
        "refused-tag",
        "1",
        "A tag outside its expectation narrows nothing.",
        "1, or -1 when in the 0.3 s after VOBC_EVENT says that a tag was refused, and none "
        "accepted, the claimed uncertainty falls by more than 0.2 m.",
    ),
    _watched(
        16,
        "localisation-limit",
        "m",
        "A train whose interval is too wide does not call itself localised.",
        "30 m less the claimed uncertainty, which is at most the width, while VOBC_STATUS says "
        "localised.",
    ),
    _watched(
        16,
        "missed-tags",
        "1",
        "Two expected tags missed in a row take the place away.",
        "1, or -1 when VOBC_STATUS says localised 0.3 s after the second VOBC_EVENT in a row that "
        "tells of a missed tag. Which tags were expected, only the controller says.",
    ),
    _watched(
        17,
        "zero-speed",
        "m/s",
        "Zero speed is declared only under 3 km/h.",
        "3 km/h less true speed, while a DOOR_CMD lets a side open, which takes zero speed. The "
        "bounds of speed are on no frame.",
    ),
    _watched(
        18,
        "wake-up",
        "1",
        "After wake-up the position holds only if the train was not moved, or after two tags.",
        "1, or -1 when VOBC_STATUS first says localised, the first COLD_MOVEMENT told of more than "
        "2 m or of a detector that slept, and fewer than two tags were read.",
    ),
    *(
        _not(number, text, ONE_TRAIN)
        for number, text in (
            (19, "One valid lease in an area, one issuer in a term."),
            (20, "The accepted term of a train never falls."),
            (21, "Authorities of two trains never overlap."),
            (22, "An authority ends behind the train ahead."),
            (23, "No authority leads over an unlocked switch."),
        )
    ),
    _watched(
        24,
        "authority-age",
        "s",
        "An authority that is too old makes the train brake.",
        "3 s, two cycles and 0.02 s less the time since the report that the newest authority "
        "answers, from 1 s on, while the train moves under an authority and no emergency brake is "
        "asked for. Only in virtual time are radio messages seen. That the train stays inside the "
        "last authority is 1 and 2.",
    ),
    *(
        _not(number, text, ONE_TRAIN)
        for number, text in (
            (25, "Nothing is issued close to the end of a lease."),
            (26, "A change of master is committed only when all are ready."),
            (27, "A border is crossed only with a permit."),
            (28, "A silent train keeps its reservation."),
        )
    ),
    _not(
        29,
        "Old, doubled or broken messages change nothing but counters.",
        "the radio's messages are not among the frames",
    ),
    _watched(
        30,
        "door-speed",
        "m/s",
        "Doors are open only under 3 km/h.",
        "3 km/h less true speed, while a side is not locked.",
    ),
    _watched(
        30,
        "door-place",
        "m",
        "Doors are open only at a stopping point.",
        "0.30 m less the distance of the true front from the nearest stopping point, while a side "
        "is not locked.",
    ),
    _watched(
        30,
        "door-side",
        "1",
        "Doors are open only at the platform.",
        "1, or -1 while the side away from the platform of the nearest station is not locked.",
    ),
    _watched(
        31,
        "door-enable",
        "1",
        "A side opens only by its own enable.",
        "1, or -1 when a side unlocks that the last valid DOOR_CMD did not enable.",
    ),
    _watched(
        32,
        "door-traction",
        "s",
        "A door that is not locked cuts traction.",
        "0.30 s less the time for which effort acts after a door was unlocked or its bypass ended: "
        "while DESK asks for one and VOBC_EVENT told that it was given, it may act.",
    ),
    _watched(
        32,
        "door-holding",
        "1",
        "An open train is held.",
        "1, or -1 while a side is not locked and neither holding nor emergency brake is on.",
    ),
    _watched(
        33,
        "departure-locked",
        "1",
        "The train departs with its doors locked.",
        "1, or -1 when it passes 0.1 m/s after a standstill with a door not locked, unless "
        "VOBC_EVENT told of a bypass that lasts.",
    ),
    _watched(
        33,
        "platform-doors",
        "1",
        "The train departs with the doors of its platform locked.",
        "The same of platform doors, where its platform has some.",
    ),
    _watched(
        34,
        "brake-silence",
        "s",
        "Without a valid BRAKE_CMD the emergency brake comes.",
        "Timeout and 0.02 s less the age of the last valid pair, while the brake unit wants no "
        "emergency brake.",
    ),
    _watched(
        34,
        "traction-silence",
        "s",
        "Without a valid TRACTION_CMD traction goes.",
        "Timeout, 0.30 s and 0.02 s less the age of the last valid pair, while effort acts.",
    ),
    _watched(
        34,
        "door-silence",
        "s",
        "Without a valid DOOR_CMD doors close.",
        "Timeout, closing time and 0.02 s less the age of the last valid pair, while a side is not "
        "locked.",
    ),
    _watched(
        34,
        "input-silence",
        "s",
        "A moving train that does not hear its vital inputs brakes.",
        "0.30 s, two cycles and 0.02 s less the age of the oldest of TACHO, BRAKE_STATUS, "
        "TRACTION_STATUS and DESK on the bus, while the train is faster than 0.5 m/s and no "
        "emergency brake is wanted. A frame lost between the bus and the controller is not seen.",
    ),
    _not(
        35,
        "No single corruption makes a restrictive frame permissive.",
        "what the sender meant is not seen on the bus; shown for every bit by the tests of the "
        "wire contract",
    ),
    _watched(
        36,
        "overrun",
        "1",
        "More than two missed cycles bring the emergency brake.",
        "1, or -1 when VOBC_STATUS counts more than two at once, the train moves and neither the "
        "command nor the brake unit wants the emergency brake. A controller that fell silent is "
        "34.",
    ),
    _not(37, "The same seed gives the same frame log.", "it takes two runs; `hil verify`"),
    _not(38, "The energy balance closes within 0.5 %.", "the truth has no energies; a measure"),
    _watched(
        39,
        "jerk",
        "m/s³",
        "Operation asks for 0.6 m/s³ at most.",
        "0.65 m/s³ less the change of the commanded acceleration from cycle to cycle. Judged while "
        "operation runs, approaches or stops and protection does not interfere.",
    ),
    _watched(
        39,
        "accel",
        "m/s²",
        "Operation asks for 0.8 m/s² at most.",
        "0.85 m/s² less the commanded acceleration, force over the true inertia less service "
        "deceleration. Judged as the jerk.",
    ),
    _not(40, "A train with a clear track gets an authority at last.", NO_ENTRY),
)
WATCHED: Final[tuple[Invariant, ...]] = tuple(each for each in INVARIANTS if each.watched)
