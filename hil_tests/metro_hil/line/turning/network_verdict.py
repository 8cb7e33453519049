"""The verdict on trains of a network in real time: what must hold, and what faults explain."""

from collections.abc import Mapping, Sequence
from math import isfinite
from typing import Any, Final

from can_dbc.vobc import Cause
from metro_hil.line.turning.network_events import NetworkEvents
from metro_hil.model.run_folder import plain
from vobc.atp.emergencies import RULE_OF

OLD_TEXT: Final = RULE_OF[Cause.AUTHORITY_OLD].words
"""Cause in the results of a train whose authority became too old."""


def is_explained(
    brake: Mapping[str, Any], struck_s: Mapping[int, float], *, crashed_s: float | None
) -> bool:
    """Whether faults explain a brake by protection.

    They explain every later one of a train that was struck, and every later service brake of
    another train: as on a line in one direction, only an emergency brake is a failure then. That
    is explained, too, if the wayside was killed and the authority became old.

    Args:
        brake: as in the results of a train.
        struck_s: when each train was struck first, in the time of the network.
        crashed_s: when the wayside was killed first; None: it was not.
    """
    at_s, train = brake["at_s"], brake["train"]
    if train in struck_s and at_s >= struck_s[train]:
        return True
    crashed = crashed_s is not None and at_s >= crashed_s
    if brake["kind"] == "service":
        return crashed or any(at_s >= each for each in struck_s.values())
    return crashed and brake["cause"] == OLD_TEXT


def document_of(
    events: NetworkEvents,
    found: Sequence[Mapping[str, Any]],
    *,
    network: str,
    trains: int,
    exit_reason: str,
    dropped: int,
    crashed_s: float | None,
    missed: Sequence[str],
) -> dict[str, Any]:
    """All results, for JSON.

    Args:
        found: results of the trains.
        dropped: number of messages that the observer lost.
        missed: texts of the faults that did not begin.
    """
    witness, struck_s = events.witness, dict[int, float]()
    for each in events.strikes:
        struck_s.setdefault(each.train, each.at_s)
    brakes = [
        {**brake, "is_explained": is_explained(brake, struck_s, crashed_s=crashed_s)}
        for each in found
        for brake in each["protection_brakes"]
    ]
    gap_m = witness.least_gap_m
    return {
        "network": network,
        "trains": trains,
        "exit_reason": exit_reason,
        "checked_count": witness.checked_count,
        "skewed_count": witness.skewed_count,
        "least_gap_m": gap_m if isfinite(gap_m) else None,
        "violations": [plain(each) for each in witness.violations],
        "protection_brakes": brakes,
        "strikes": [plain(each) for each in events.strikes],
        "takeovers": [plain(each) for each in events.takeovers()],
        "authority_oldest_s": events.authority_oldest_s(),
        "late_s": max((each["late_s"] for each in found), default=None),
        "trips": [trip for each in found for trip in each["trips"]],
        "doubts": [
            *_doubts(events, dropped=dropped, missing=trains - len(found), trains=trains),
            *missed,
            *events.doubts(),
        ],
    }


def _doubts(events: NetworkEvents, *, dropped: int, missing: int, trains: int) -> list[str]:
    witness = events.witness
    return [
        text
        for is_so, text in (
            (dropped > 0, f"the observer lost {dropped} messages"),
            (missing > 0, f"trains without results: {missing} of {trains}"),
            (
                trains > 1 and witness.checked_count == 0,
                "no two trains were on the network together",
            ),
            (
                witness.skewed_count > witness.checked_count,
                f"{witness.skewed_count} pairs of places were of different instants",
            ),
        )
        if is_so
    ]


def failed(document: Mapping[str, Any]) -> bool:
    """Whether two trains came too near, or protection braked one without a fault."""
    brakes = document["protection_brakes"]
    return bool(document["violations"]) or not all(each["is_explained"] for each in brakes)


def show(document: dict[str, Any]) -> None:
    """Print the verdict and what it rests on."""
    trips = document["trips"]
    # What never happened is left out of the results.
    done = [trip for trip in trips if "ended_s" in trip]
    errors_m = [
        abs(stop["error_m"]) for trip in done for stop in trip["stops"] if "error_m" in stop
    ]
    worst = f", worst stop error {100.0 * max(errors_m):.1f} cm" if errors_m else ""
    turns, gap_m = sum(trip["turned"] for trip in trips), document["least_gap_m"]
    gap = "" if gap_m is None else f", least gap {gap_m:.0f} m"
    print(f"{document['exit_reason']}: {len(done)} trips, {turns} changes of ends{worst}{gap}")
    print(
        f"{document['checked_count']} checks of two trains, {len(document['violations'])} "
        f"violations, {len(document['protection_brakes'])} brakes by protection"
    )
    for each in document["violations"]:
        print(f"at {each['at_s']:.2f} s, {' and '.join(each['trains'])}: {each['kind']}")
    for brake in document["protection_brakes"]:
        text = f"at {brake['at_s']:.2f} s, train {brake['train']}: {brake['kind']} brake"
        why = ", explained by a fault" if brake["is_explained"] else ""
        print(f"{text}, {brake['cause']}{why}".replace("_", " "))
    for each in document["takeovers"]:
        what = "no other train commanded"
        if "train" in each:
            what = f"train {each['train']} commanded {each['after_s']:.2f} s"
        print(
            f"{each['path']}, area {each['area']}: {what} after train {each['struck']} was struck"
        )
    if document["takeovers"] and document["authority_oldest_s"] > 0.0:
        print(f"oldest authority of other trains: {document['authority_oldest_s']:.2f} s")
    for text in document["doubts"]:
        print(f"invalid: {text}")
