"""Admission to the roster: where an applicant belongs, and that no shadow train is next to it."""

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
from zenoh_config.t2t import NO_TRAIN, ROSTER_MAX, AdmissionState, RosterEntry, TrainReport

APART_M: Final = 20.0
"""Distance behind an admitted train that must be free of shadow trains.

It covers 7 m that the train may move back, 7 m kept free behind it, and 5 m for an outdated track
status.
"""


class AdmissionGuardInputs(NamedTuple):
    """Inputs that decide on an admission."""

    area: Area
    before: Area | None
    """The area that ends where this one begins."""
    records: dict[int, TrainRecord]
    reserved_m: dict[int, float]
    """Farthest place that each train of the roster may reach by any authority."""
    counted: tuple[Counted, ...] | None
    """Sections as last counted. None: this line counts no axles."""
    stood: bool
    """The applicant already stood in its place when the axles were counted."""
    standing: tuple[StandingTrain, ...]
    """Trains that report their place, without the applicant. They are on the roster in this
    incarnation, or outside of the area. Any other train may be forgotten while it still stands in
    the way, so it accounts for no axles."""
    at_rest: tuple[StandingTrain, ...] = ()
    """Those of them that already stood in the same place when the axles were counted."""
    there: tuple[StandingTrain, ...] = ()
    """On request also other trains in the area. They account for axles now, whether or not they are
    forgotten later."""
    line_m: tuple[float, float] = (-UNBOUNDED_M, UNBOUNDED_M)
    """Start and end of the line. No shadow train is beyond."""


class Waiting(NamedTuple):
    state: AdmissionState
    waits_for: int = NO_TRAIN


def admitted(
    order: Order,
    report: TrainReport,
    scene: AdmissionGuardInputs,
    config: T2tConfig,
    guards: MasterGuards,
) -> Order | Waiting:
    """The order with the applicant inserted, or the reason why it waits."""
    if len(order) >= ROSTER_MAX:
        return Waiting(AdmissionState.FULL)
    at = sum(1 for _ in _ahead(order, report, scene))
    ahead = order[at - 1].train if at else NO_TRAIN
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
    """Trains in front of the applicant: the roster up to the first train that is not in front."""
    ahead = []
    for entry in order:
        if scene.records[entry.train].rear_m < report.front_max_m:
            break
        ahead.append(entry.train)
    return ahead


def is_over_border(report: TrainReport, scene: AdmissionGuardInputs) -> bool:
    """The applicant is still entirely in the preceding area and under its master's command."""
    return scene.before is not None and report.front_max_m <= scene.area.start_m


def line_of(report: TrainReport, scene: AdmissionGuardInputs, ahead: int) -> InLine:
    before = scene.before
    comes_from = before is not None and report.comes_from == before.number
    return InLine(is_over_border(report, scene), comes_from, report.behind, ahead)


def is_sieved(report: TrainReport, scene: AdmissionGuardInputs, room_m: float) -> bool:
    """Whether reporting trains account for all axles around a train at standstill.

    Args:
        room_m: track ahead of it that must be free of unknown axles.
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
    """Whether trains at rest account for all axles from the train's rear to the next gap.

    The search ends at the end of the area. Axles farther on may belong to trains that this master
    does not receive.
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
    """Whether all axles between two places are counted and belong to trains at rest.

    The applicant counts among these trains if it stands.
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
    """Places of trains that are not on the roster in their present incarnation. Other trains keep
    clear.

    Args:
        strangers: reports with their time of arrival.
        boots: registered incarnation of each train of the roster.
    """
    return [
        BarredTrack(each.rear_min_m - config.behind_rear_m, each.front_max_m, Bar.CLOSING)
        for each, _ in strangers
        if each.localised and boots.get(each.source) != each.boot
    ]


def may_explain(report: TrainReport, roster: Mapping[int, TrainRecord], area: Area) -> bool:
    """Whether the axles of a train may account for those counted near another train.

    A restarted train is registered in its former place until its entry is renewed. In any other
    place the master may forget it, like any train that is not on the roster.
    """
    known = roster.get(report.source)
    kept = known is not None and known.boot == report.boot
    outside = report.rear_min_m >= area.end_m or report.front_max_m <= area.start_m
    return report.localised and (kept or outside)


def standing_of(report: TrainReport) -> StandingTrain:
    return StandingTrain(report.rear_min_m, report.front_max_m, report.axles)


def foremost_first(item: tuple[int, tuple[TrainReport, int]]) -> tuple[float, int]:
    """Sort key of applicants for admission: the foremost first."""
    train, (report, _) = item
    return (-report.front_max_m, train)
