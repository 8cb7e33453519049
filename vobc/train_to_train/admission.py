"""Who comes onto the roster, and where: between whom a newcomer stands, and that nobody hides."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Final, NamedTuple

from firmware_py.trackdb.areas import Area
from vobc.train_to_train.authority import (
    Bar,
    BarredTrack,
    Counted,
    StandingTrain,
    all_explained,
    explained,
)
from vobc.train_to_train.guards import InLine, MasterGuards, Neighbours
from vobc.train_to_train.occupancy import UNBOUNDED_M, TrainRecord
from vobc.train_to_train.roster import Order, placed
from vobc.train_to_train.vocabulary import T2tConfig
from zenoh_config.t2t import NOBODY, ROSTER_MAX, AdmissionState, RosterEntry, TrainReport

APART_M: Final = 20.0
"""So far behind a train that is let go nobody may hide: it may come back, as much again is kept
free of it as its own, and an old look at the track excuses some more."""


class AdmissionGuardInputs(NamedTuple):
    """What an admission is decided on."""

    area: Area
    before: Area | None
    """The area that ends where this one begins."""
    records: dict[int, TrainRecord]
    reserved_m: dict[int, float]
    """By train of the roster: the farthest that it may have been granted."""
    counted: tuple[Counted, ...] | None
    """Sections as last counted; None: this line counts no axles."""
    stood: bool
    """The newcomer stood already where it is when they were counted."""
    standing: tuple[StandingTrain, ...]
    """Trains that say where they are, the newcomer not among them: of the roster, in the life that
    it is for, and outside of the area. Another may be forgotten while it stands in the way, and
    explains no axles."""
    at_rest: tuple[StandingTrain, ...] = ()
    """Those of them that stood already where they are when sections were counted."""
    there: tuple[StandingTrain, ...] = ()
    """Where it is asked for, others in the area, too: whose axles these are now, whoever is
    forgotten later."""
    line_m: tuple[float, float] = (-UNBOUNDED_M, UNBOUNDED_M)
    """Where the line begins and ends: nobody hides beyond."""


class Waiting(NamedTuple):
    state: AdmissionState
    waits_for: int = NOBODY


def admitted(
    order: Order,
    report: TrainReport,
    scene: AdmissionGuardInputs,
    config: T2tConfig,
    guards: MasterGuards,
) -> Order | Waiting:
    """The order with the newcomer in it, or why it is not."""
    if len(order) >= ROSTER_MAX:
        return Waiting(AdmissionState.FULL)
    at = sum(1 for _ in _ahead(order, report, scene))
    ahead = order[at - 1].train if at else NOBODY
    rear_m = report.rear_min_m - config.behind_rear_m
    place = Neighbours(
        behind_m=scene.reserved_m.get(order[at].train, UNBOUNDED_M) if at < len(order) else rear_m,
        rear_m=rear_m,
        front_m=report.front_max_m,
        ahead_m=scene.records[ahead].rear_m - config.rollback_m if ahead else report.front_max_m,
    )
    if not guards.placed_apart(place):
        return Waiting(AdmissionState.UNPLACED, order[at].train if at < len(order) else ahead)
    if not guards.comes_in_line(line_of(report, scene, ahead)):
        return Waiting(AdmissionState.WAITS, report.behind)
    sieved = is_over_border(report, scene) or is_sieved(report, scene, config.behind_axle_m)
    return placed(order, RosterEntry(report.source, report.rear_min_m, sieved, report.boot), at)


def _ahead(
    order: Sequence[RosterEntry], report: TrainReport, scene: AdmissionGuardInputs
) -> Sequence[int]:
    """Trains in front of the newcomer: the roster up to the first that is not."""
    ahead = []
    for entry in order:
        if scene.records[entry.train].rear_m < report.front_max_m:
            break
        ahead.append(entry.train)
    return ahead


def is_over_border(report: TrainReport, scene: AdmissionGuardInputs) -> bool:
    """It is still wholly in the area before, and commanded there."""
    return scene.before is not None and report.front_max_m <= scene.area.start_m


def line_of(report: TrainReport, scene: AdmissionGuardInputs, ahead: int) -> InLine:
    before = scene.before
    comes_from = before is not None and report.comes_from == before.number
    return InLine(is_over_border(report, scene), comes_from, report.behind, ahead)


def is_sieved(report: TrainReport, scene: AdmissionGuardInputs, room_m: float) -> bool:
    """All axles around a train that stands are those of trains that say that they are there.

    Args:
        room_m: kept free ahead of it of an axle that nobody explains.
    """
    if scene.counted is None:
        return True
    if not (report.standstill and scene.stood):
        return False
    if explained(scene.counted, standing_of(report), scene.standing):
        return True
    return _is_known_within(report, scene, scene.counted, room_m)


def _is_known_within(
    report: TrainReport, scene: AdmissionGuardInputs, counted: Sequence[Counted], room_m: float
) -> bool:
    """Whether all axles from the train's rear on, as far as there is no gap and to the end of the
    area, are of trains at rest. Those farther on may be of trains that this master does not hear.
    """
    front_m, border_m = max(report.front_max_m, report.latent_m), scene.area.end_m
    from_m, to_m = report.rear_min_m - APART_M, front_m + room_m
    for each in counted:
        if each.start_m >= max(border_m, front_m) or (each.end_m > front_m and not each.occupied):
            break
        to_m = max(to_m, each.end_m)
    beyond = report.rear_min_m >= scene.line_m[1]
    return not beyond and are_known(report, scene, counted, from_m=from_m, to_m=to_m)


def are_known(
    report: TrainReport,
    scene: AdmissionGuardInputs,
    counted: Sequence[Counted],
    *,
    from_m: float,
    to_m: float,
) -> bool:
    """Whether all axles between these two are counted, and of trains at rest: the newcomer, if it
    stands, and others.
    """
    start_m, end_m = scene.line_m
    from_m, to_m = max(from_m, start_m), min(to_m, end_m)
    if to_m <= from_m or not counted:
        return False
    if from_m < counted[0].start_m or to_m > counted[-1].end_m:
        return False
    stands = report.standstill and scene.stood
    at_rest = (standing_of(report), *scene.at_rest) if stands else scene.at_rest
    return all_explained(counted, at_rest, from_m=from_m, to_m=to_m)


def kept_free(
    strangers: Iterable[tuple[TrainReport, int]], boots: Mapping[int, int], config: T2tConfig
) -> list[BarredTrack]:
    """Where trains say that they are that are not on the roster, or not in this life: nobody comes
    any nearer.

    Args:
        strangers: each with the instant at which it was heard.
        boots: of those on the roster the life that it is for.
    """
    return [
        BarredTrack(each.rear_min_m - config.behind_rear_m, each.front_max_m, Bar.CLOSING)
        for each, _ in strangers
        if each.localised and boots.get(each.source) != each.boot
    ]


def may_explain(report: TrainReport, roster: Mapping[int, TrainRecord], area: Area) -> bool:
    """Whether a train's axles may account for those counted near another train.

    Until it is renewed, the place on the roster of one that began anew is that of its former life:
    elsewhere than there it may be forgotten like any other.
    """
    known = roster.get(report.source)
    kept = known is not None and known.boot == report.boot
    outside = report.rear_min_m >= area.end_m or report.front_max_m <= area.start_m
    return report.localised and (kept or outside)


def standing_of(report: TrainReport) -> StandingTrain:
    return StandingTrain(report.rear_min_m, report.front_max_m, report.axles)


def foremost_first(item: tuple[int, tuple[TrainReport, int]]) -> tuple[float, int]:
    """Sorts applicants, given by train with what they report and when, for their admission."""
    train, (report, _) = item
    return (-report.front_max_m, train)
