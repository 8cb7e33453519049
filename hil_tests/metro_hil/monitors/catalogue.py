"""The safety invariants: how the monitors watch them, or why they do not."""

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class Invariant:
    """One safety invariant, or a part of one that has its own unit."""

    number: int
    """Number of the requirement: 4 for `INV-04`."""
    name: str
    """Name such as `inv-04-civil-limit`, or `inv-10` for an invariant that is not watched."""
    text: str
    unit: str = ""
    margin: str = ""
    """What the margin is, and when it is judged."""
    why_not: str = ""
    """Why the invariant is not watched; empty for a watched one."""

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


ONE_TRAIN: Final = "a run has one train and one issuer of authorities, so it cannot be violated"
NO_ENTRY: Final = "neither truth nor frames show it"

INVARIANTS: Final[tuple[Invariant, ...]] = (
    _watched(
        1,
        "stopping-distance",
        "m",
        "The true front and the true stopping distance stay inside the authority and the map "
        "while the guaranteed emergency brake rate holds.",
        "Distance from the true front to the end of authority or of the map, less the distance to "
        "standstill if the emergency brake were demanded now. Until traction is cut after 0.30 s "
        "the train keeps the acceleration that it has now. It coasts on its gradient for the "
        "declared dead time and lag of its emergency brake. Then it decelerates at 1.0 m/s² over "
        "the true heights of the line. Of a brake that is demanded already, only the rest of these "
        "times counts. Judged while the train moves forwards, is not on sight, and rail and brake "
        "give the guaranteed rate.",
    ),
    _watched(
        2,
        "authority-end",
        "m",
        "The true front never passes the end of authority, nor the end of the map.",
        "End of authority or of the map less true front. Judged while the train moves and is not "
        "on sight.",
    ),
    _watched(
        3,
        "emergency-at-curve",
        "s",
        "At its own emergency curve the controller commands the emergency brake within one cycle.",
        "One cycle and 0.02 s for the bus, less the time from a VOBC_MOTION above its emergency "
        "limit to the command. Its speed counts with the reach in the VOBC_MODE of the same cycle, "
        "less the 0.05 m/s by which the reach is rounded up, as long as the "
        "emergency brake is not commanded.",
    ),
    _watched(
        4,
        "civil-limit",
        "m/s",
        "The speed of the whole train stays below civil limit, emergency margin and worst "
        "overshoot together.",
        "Lowest limit under the train + 8 km/h + overshoot, less true speed. The overshoot is what "
        "a runaway of 1.0 m/s² and the steepest fall under the train add until traction is cut and "
        "the brake acts.",
    ),
    _watched(
        4,
        "restriction",
        "m/s",
        "The speed of the whole train stays below each temporary restriction that the train has "
        "received, with the same margins.",
        "Limit of the restriction + 8 km/h + overshoot, less true speed, while any part of the "
        "train is in it. Judged from the place on where the worst declared motion, from where the "
        "train received it, has come down to the limit; and until newer orders lift it, also "
        "after a restart. Not judged while rail or brake give less than the guaranteed rate. Radio "
        "messages are observed in virtual time only.",
    ),
    _watched(
        5,
        "emergency-held",
        "1",
        "The emergency brake stays commanded until the train stands and a reset is given.",
        "1, or -1 in two cases: the brake is released while the train moves, or the state "
        "EMERGENCY ends other than at standstill within 5 s of a press of the reset or a release "
        "by the centre. After an overshoot it may release itself at standstill. An emergency brake "
        "that the brake unit applies by itself counts from 3 s after the last release on, when the "
        "unit has to report it. While the train moves it may be off for at most 0.2 s until the "
        "controller commands it, too; 0.25 s more where faults may delay frames. A restarted "
        "controller begins braked and knows neither its position nor earlier emergencies. Whether "
        "the cause has gone is not on the bus.",
    ),
    _watched(
        6,
        "traction-off",
        "s",
        "The emergency brake ends tractive effort within 0.30 s.",
        "0.30 s less the time for which effort acts after the brake unit demands the emergency "
        "brake. Exercised if effort acted when the demand began.",
    ),
    _watched(
        7,
        "demand-ignored",
        "1",
        "Under the emergency brake the train ignores the traction demand of ATO.",
        "1, or -1 for effort at the rail more than 0.30 s after the demand for the emergency "
        "brake. Exercised while TRACTION_CMD permits and demands effort.",
    ),
    _watched(
        8,
        "rollback",
        "m",
        "The train rolls back at most by the limit of the line, 2 m.",
        "The limit less the distance back from the foremost position, from 2 cm on; a jog back "
        "does not count. The controller's own trip is not on the bus.",
    ),
    _watched(
        9,
        "direction",
        "1",
        "No tractive effort acts against the authorised direction.",
        "1, or -1 for a TRACTION_CMD that demands effort in another direction than forwards. "
        "Backwards is correct in a jog, which VOBC_MODE has to report within 0.3 s. Exercised "
        "while effort is demanded. Invariant 8 judges how far the train rolls.",
    ),
    _watched(
        10,
        "jog-distance",
        "m",
        "A jog is at most 5 m long.",
        "5 m less the distance from the standstill before the jog, while VOBC_MODE reports a jog "
        "and the emergency brake is off.",
    ),
    _watched(
        10,
        "jog-speed",
        "m/s",
        "A jog is slow.",
        "5 km/h + 5 km/h of margin + the speed gained in a runaway, as in 4, less true speed. "
        "Scenarios check that a regular jog stays below 5 km/h.",
    ),
    _watched(
        10,
        "jog-attempts",
        "1",
        "There are at most three jogs at a stop.",
        "3 less the number of jogs that begin within 20 m of the first one.",
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
        "The controller enters a higher mode only when its conditions hold.",
        "1, or -1 in two cases. VOBC_MODE changes to authorised, and in the next VOBC_STATUS "
        "position or authority is missing or no authority lies ahead of the train. Or VOBC_MODE "
        "changes to creep without an order, or to restricted without an order or a request, in the "
        "5 s before.",
    ),
    _watched(
        12,
        "restricted-speed",
        "m/s",
        "A train on sight runs at 25 km/h plus margin at most.",
        "25 km/h + 5 km/h + the speed gained in a runaway, as in 4, less true speed, while "
        "VOBC_MODE reports restricted or creep.",
    ),
    _watched(
        13,
        "position-interval",
        "m",
        "The position interval contains the true front.",
        "The uncertainty of VOBC_POSITION less the distance of the true front from the claimed "
        "one. A claim is valid at the start of its cycle or of a missed one, so it may be that "
        "much and 0.02 s older than its frame. A claim off its period may have waited for the bus. "
        "Such a claim and those of the 2 s after it are not judged.",
    ),
    _watched(
        14,
        "narrowed-by-tag",
        "1",
        "The position interval narrows only by a tag.",
        "1, or -1 when the claimed uncertainty falls more than 0.2 m below the least of the five "
        "claims before it without a tag. The reader must have read one since 2 s before the last "
        "of these claims. Claims off their period, or made while TACHO is missing, are ignored.",
    ),
    _watched(
        15,
        "refused-tag",
        "1",
        "A tag outside its expectation does not narrow the position interval.",
        "1, or -1 when the claimed uncertainty falls by more than 0.2 m in the 0.3 s after a "
        "VOBC_EVENT that reports a rejected tag, unless a tag was accepted.",
    ),
    _watched(
        16,
        "localisation-limit",
        "m",
        "A train whose position interval is too wide does not report itself localised.",
        "30 m less the claimed uncertainty, which is at most the width of the interval, while "
        "VOBC_STATUS reports localised.",
    ),
    _watched(
        16,
        "missed-tags",
        "1",
        "Two expected tags missed in a row end the localisation.",
        "1, or -1 when VOBC_STATUS reports localised 0.3 s after the second VOBC_EVENT in a row "
        "that reports a missed tag. Only the controller reports which tags it expected.",
    ),
    _watched(
        17,
        "zero-speed",
        "m/s",
        "Zero speed is declared only below 3 km/h.",
        "3 km/h less true speed, while a DOOR_CMD enables a side, which requires zero speed. No "
        "frame holds the bounds of the speed.",
    ),
    _watched(
        18,
        "wake-up",
        "1",
        "After wake-up the position is valid only if the train was not moved, or after two tags.",
        "1, or -1 when VOBC_STATUS first reports localised although fewer than two tags were read "
        "and the first COLD_MOVEMENT reported more than 2 m or an unmonitored time.",
    ),
    *(
        _not(number, text, ONE_TRAIN)
        for number, text in (
            (19, "An area has one valid lease, and a term has one issuer."),
            (20, "The accepted term of a train never falls."),
            (21, "Authorities of two trains never overlap."),
            (22, "An authority ends behind the train ahead."),
        )
    ),
    _watched(
        23,
        "switch-locked",
        "m",
        "No authority leads over a switch that is not locked as the path needs it.",
        "Place of the first switch on the path that is not locked and detected in the end position "
        "that the path needs, less the end of each authority that the wayside sent 0.2 s or more "
        "after that. Judged in networks with switches. Radio messages are observed in virtual time "
        "only.",
    ),
    _watched(
        23,
        "switch-brake",
        "s",
        "A train whose authority falls behind its front for a switch brakes.",
        "0.3 s and two cycles less the time for which a moving train is beyond the end of its "
        "newest authority without a demand for the emergency brake. Judged while a switch ahead or "
        "below is not locked and the train is not on sight.",
    ),
    _watched(
        24,
        "authority-age",
        "s",
        "A train brakes when its authority is too old.",
        "3 s, two cycles and 0.02 s less the age of the report that the newest authority answers. "
        "Judged from an age of 1 s on, while the train moves under an authority and no emergency "
        "brake is demanded. Radio messages are observed in virtual time only. Invariants 1 and 2 "
        "judge that the train stays inside the last authority.",
    ),
    *(
        _not(number, text, ONE_TRAIN)
        for number, text in (
            (25, "No authority is issued close to the end of a lease."),
            (26, "A planned change of master is committed only when all trains are ready."),
            (27, "A train crosses a border only with an authority beyond it."),
            (28, "The track of a non-communicating train stays reserved."),
        )
    ),
    _not(
        29,
        "Old, duplicated or damaged messages change only counters.",
        "the radio's messages are not among the frames",
    ),
    _watched(
        30,
        "door-speed",
        "m/s",
        "Doors are open only below 3 km/h.",
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
        "door-platform",
        "m",
        "Doors are open only beside the platform.",
        "Least distance of the outer ends of all cars with an open door from the ends of the "
        "platform of the nearest station, negative outside of it. A train that opens all its doors "
        "is judged by its front and its rear.",
    ),
    _watched(
        30,
        "door-side",
        "1",
        "Doors are open only on the platform side.",
        "1, or -1 while a side without platform at the nearest station is not locked.",
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
        "0.30 s less the time for which effort acts after a door was unlocked or its bypass ended. "
        "Effort may act while DESK requests a bypass and VOBC_EVENT has reported that it was "
        "given.",
    ),
    _watched(
        32,
        "door-holding",
        "1",
        "A train with open doors is held.",
        "1, or -1 while a side is not locked and neither holding nor emergency brake is applied.",
    ),
    _watched(
        33,
        "departure-locked",
        "1",
        "The train departs with its doors locked.",
        "1, or -1 when the train passes 0.1 m/s after a standstill with a door not locked, unless "
        "VOBC_EVENT has reported a bypass that is still given.",
    ),
    _watched(
        33,
        "platform-doors",
        "1",
        "The train departs with the doors of its platform locked.",
        "The same for platform doors, if its platform has any.",
    ),
    _watched(
        34,
        "brake-silence",
        "s",
        "Without a valid BRAKE_CMD the brake unit applies the emergency brake.",
        "Timeout and 0.02 s less the age of the last valid pair, while the brake unit does not "
        "demand the emergency brake.",
    ),
    _watched(
        34,
        "traction-silence",
        "s",
        "Without a valid TRACTION_CMD traction ends.",
        "Timeout, 0.30 s and 0.02 s less the age of the last valid pair, while effort acts.",
    ),
    _watched(
        34,
        "door-silence",
        "s",
        "Without a valid DOOR_CMD the doors close.",
        "Timeout, closing time and 0.02 s less the age of the last valid pair, while a side is not "
        "locked.",
    ),
    _watched(
        34,
        "input-silence",
        "s",
        "A moving train that does not receive its vital inputs brakes.",
        "0.30 s, two cycles and 0.02 s less the age of the oldest of TACHO, BRAKE_STATUS, "
        "TRACTION_STATUS and DESK on the bus. Judged while the train is faster than 0.5 m/s and no "
        "emergency brake is demanded. A frame that is lost between bus and controller is not "
        "detected.",
    ),
    _not(
        35,
        "No single corruption makes a restrictive frame permissive.",
        "the bus does not show what the sender meant; the tests of the wire contract show it for "
        "every bit",
    ),
    _watched(
        36,
        "overrun",
        "1",
        "After more than two missed cycles the emergency brake is applied.",
        "1, or -1 when VOBC_STATUS counts more than two at once while the train moves and neither "
        "the command nor the brake unit demands the emergency brake. Invariant 34 judges a silent "
        "controller.",
    ),
    _not(
        37,
        "The same seed gives the same frame log.",
        "it needs two runs; `hil verify` compares them",
    ),
    _not(38, "The energy balance closes within 0.5 %.", "the truth holds no energies"),
    _watched(
        39,
        "jerk",
        "m/s³",
        "ATO demands a jerk of at most 0.6 m/s³.",
        "0.65 m/s³ less the change of the commanded acceleration from cycle to cycle. Judged while "
        "ATO runs, approaches or stops and ATP does not intervene.",
    ),
    _watched(
        39,
        "accel",
        "m/s²",
        "ATO demands an acceleration of at most 0.8 m/s². It demands more brake only to hold a "
        "falling gradient, or where the train still decelerates by at most that.",
        "0.85 m/s² less the commanded acceleration: force over the true inertia less service "
        "deceleration. This counts without what gravity adds on falling track, and by at most the "
        "true deceleration. Judged in the same states as the jerk.",
    ),
    _not(40, "A train with clear track ahead gets an authority in the end.", NO_ENTRY),
    _watched(
        41,
        "neutral-section",
        "1",
        "The controller demands no traction in a neutral section.",
        "1, or -1 for a TRACTION_CMD that permits and demands effort while any part of the train "
        "is in a neutral section of the line.",
    ),
    _watched(
        42,
        "no-stop-zone",
        "m",
        "ATO enters a zone without stops only with an authority past it for the whole train.",
        "Farthest end of all authorities, less the end of the zone and the length of the train, "
        "when the front enters a no-stop zone or a neutral section in automatic running.",
    ),
    _watched(
        43,
        "evacuation-stop",
        "m",
        "A train that is held for long stands at an evacuation stop, if it could reach one.",
        "5 m less the distance of the front from the far end of the nearest evacuation stop. "
        "Judged at each standstill in automatic running with an authority that has been the same "
        "for 47 s and does not reach the next stop. It counts if the train could still reach one "
        "then, with 0.5 m/s² after 5 s.",
    ),
)
WATCHED: Final[tuple[Invariant, ...]] = tuple(each for each in INVARIANTS if each.watched)
