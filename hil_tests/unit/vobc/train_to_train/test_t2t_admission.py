"""Admission to the roster, and the effect of trains that are not registered yet on others."""

from dataclasses import replace

import pytest

from firmware_py.trackdb.areas import Area
from vobc.train_to_train.admission import (
    APART_M,
    AdmissionGuardInputs,
    Waiting,
    admitted,
    are_known,
    foremost_first,
    is_sieved,
    kept_free,
    may_explain,
    standing_of,
)
from vobc.train_to_train.authority import Bar, BarredTrack, Counted, StandingTrain
from vobc.train_to_train.axle_counting import EXCUSED_M
from vobc.train_to_train.guards import MasterGuards
from vobc.train_to_train.occupancy import TrainRecord
from vobc.train_to_train.roster import Order
from vobc.train_to_train.vocabulary import T2tConfig
from zenoh_config.t2t import AdmissionState, RosterEntry, TrainReport

AREA = Area(1, 1000.0, 2000.0)
BEFORE = Area(4, 0.0, 1000.0)
CONFIG = T2tConfig(rollback_m=2.0, jog_m=5.0)
ROOM_M = 11.0
BOOT = 1


def report(rear_m: float, front_m: float, *, train: int = 3, localised: bool = True) -> TrainReport:
    head = (train, 65_535, 1, 0, BOOT, 1, 0)
    place = (front_m - 1.0, front_m, rear_m, rear_m, 0.0)
    ends = (front_m, front_m, front_m, 0, 0)
    return TrainReport(*head, localised, *place, True, *ends, False, 0, 0, 16, False, 0, 0)


def test_others_keep_the_distance_to_a_newcomer_that_a_rollback_needs() -> None:
    standing = report(1500.0, 1585.0)

    assert kept_free([(standing, 7)], {1: 1, 2: 1}, CONFIG) == [
        BarredTrack(1493.0, 1585.0, Bar.CLOSING)
    ]


@pytest.mark.parametrize(
    ("told", "boots"),
    [(report(1500.0, 1585.0), {3: BOOT}), (report(0.0, 9.0, localised=False), {1: BOOT})],
)
def test_the_report_of_a_registered_or_lost_train_bars_no_track(
    told: TrainReport, boots: dict[int, int]
) -> None:
    assert kept_free([(told, 7)], boots, CONFIG) == []


def test_a_restarted_train_of_the_roster_is_protected_where_it_reports_itself() -> None:
    told = report(1500.0, 1585.0)

    assert kept_free([(told, 7)], {3: BOOT + 1}, CONFIG) == [
        BarredTrack(1493.0, 1585.0, Bar.CLOSING)
    ]


@pytest.mark.parametrize(
    ("rear_m", "front_m", "explains"),
    [
        (1500.0, 1585.0, False),
        (1999.9, 2085.0, False),
        (2000.0, 2085.0, True),
        (915.0, 1000.1, False),
        (915.0, 1000.0, True),
    ],
)
def test_an_unregistered_train_accounts_for_axles_only_from_outside_the_area(
    rear_m: float, front_m: float, explains: bool
) -> None:
    told = report(rear_m, front_m)
    roster = {each: TrainRecord(each, 0.0, 0, boot=BOOT) for each in (1, 2)}
    kept = {**roster, 3: TrainRecord(3, rear_m, 0, boot=BOOT)}

    assert may_explain(told, roster, AREA) is explains
    assert may_explain(told, kept, AREA)
    assert not may_explain(replace(told, localised=False), kept, AREA)


@pytest.mark.parametrize("boot", [0, BOOT + 1])
def test_a_restarted_train_has_no_place_on_the_roster(boot: int) -> None:
    kept = {3: TrainRecord(3, 1500.0, 0, boot=boot)}

    assert not may_explain(report(1500.0, 1585.0), kept, AREA)
    assert may_explain(report(2000.0, 2085.0), kept, AREA)


def order_of(*trains: tuple[int, float]) -> Order:
    return tuple([RosterEntry(train, rear_m, True, 1) for train, rear_m in trains])


def scene_of(order: Order, reserved_m: dict[int, float] | None = None) -> AdmissionGuardInputs:
    """Guard inputs at the start of a line without axle counters."""
    records = {each.train: TrainRecord(each.train, each.rear_m, 0, boot=1) for each in order}
    return AdmissionGuardInputs(AREA, None, records, reserved_m or {}, None, True, ())


def admit(
    order: Order, told: TrainReport, scene: AdmissionGuardInputs, config: T2tConfig = CONFIG
) -> Order | Waiting:
    return admitted(order, told, scene, config, MasterGuards())


THREE = order_of((7, 1800.0), (8, 1600.0), (9, 1400.0))
THREE_RESERVED_M = {7: 1810.0, 8: 1610.0, 9: 1410.0}


@pytest.mark.parametrize(
    ("rear_m", "trains"),
    [
        (1850.0, [3, 7, 8, 9]),
        (1650.0, [7, 3, 8, 9]),
        (1450.0, [7, 8, 3, 9]),
        (1200.0, [7, 8, 9, 3]),
    ],
)
def test_a_newcomer_joins_the_roster_where_it_stands_and_the_others_keep_their_places(
    rear_m: float, trains: list[int]
) -> None:
    told = report(rear_m, rear_m + 85.0)

    order = admit(THREE, told, scene_of(THREE, THREE_RESERVED_M))

    assert isinstance(order, tuple)
    assert [each.train for each in order if isinstance(each, RosterEntry)] == trains
    assert order[trains.index(3)] == RosterEntry(3, rear_m, True, 1)
    assert tuple(each for each in order if each != order[trains.index(3)]) == THREE


def test_the_first_train_of_an_area_joins() -> None:
    assert admit((), report(1500.0, 1585.0), scene_of(())) == (RosterEntry(3, 1500.0, True, 1),)


@pytest.mark.parametrize("rear_m", [-300.0, 3.0, 7.5])
def test_a_newcomer_without_a_train_behind_it_may_stand_anywhere_at_the_start_of_a_line(
    rear_m: float,
) -> None:
    order = order_of((1, 1700.0))

    result = admit(order, report(rear_m, rear_m + 85.0), scene_of(order))

    assert result == (*order, RosterEntry(3, rear_m, True, 1))


@pytest.mark.parametrize(("reserved_m", "joins"), [(1493.0, True), (1493.1, False)])
def test_a_newcomer_waits_while_the_train_behind_may_reach_its_rollback_distance(
    reserved_m: float, *, joins: bool
) -> None:
    order = order_of((1, 1700.0), (2, 1200.0))

    result = admit(order, report(1500.0, 1585.0), scene_of(order, {1: 1900.0, 2: reserved_m}))

    assert (result == Waiting(AdmissionState.UNPLACED, 2)) is not joins


def test_a_newcomer_waits_before_a_train_with_an_unknown_authority() -> None:
    order = order_of((1, 1700.0), (2, 1200.0))

    result = admit(order, report(1500.0, 1585.0), scene_of(order))

    assert result == Waiting(AdmissionState.UNPLACED, 2)


@pytest.mark.parametrize(("ahead_m", "joins"), [(1587.0, True), (1586.9, False)])
def test_a_newcomer_waits_where_the_train_ahead_may_roll_back_to(
    ahead_m: float, *, joins: bool
) -> None:
    order = order_of((6, 1900.0), (1, ahead_m))

    result = admit(order, report(1500.0, 1585.0), scene_of(order))

    assert (result == Waiting(AdmissionState.UNPLACED, 1)) is not joins


def test_a_train_whose_front_touches_a_rear_stands_behind_it() -> None:
    order = order_of((1, 1585.0))
    rigid = T2tConfig(rollback_m=0.0, jog_m=5.0)

    result = admit(order, report(1500.0, 1585.0), scene_of(order), rigid)

    assert result == (*order, RosterEntry(3, 1500.0, True, 1))


def test_a_newcomer_stands_before_the_first_train_that_is_not_ahead_of_it() -> None:
    """The roster knows the order better than positions do, which are only bounds."""
    order = order_of((1, 1200.0), (2, 1900.0))

    result = admit(order, report(1500.0, 1585.0), scene_of(order, {1: 1300.0, 2: 1300.0}))

    assert result == (RosterEntry(3, 1500.0, True, 1), *order)


@pytest.mark.parametrize(("trains", "full"), [(127, False), (128, True), (129, True)])
def test_a_roster_of_128_trains_admits_no_other(trains: int, *, full: bool) -> None:
    order = order_of(*[(10 + at, 1990.0) for at in range(trains)])

    result = admit(order, report(1500.0, 1585.0), scene_of(order))

    assert (result == Waiting(AdmissionState.FULL, 0)) is full


@pytest.mark.parametrize(
    ("comes_from", "behind", "joins"),
    [(4, 0, True), (4, 1, True), (4, 6, False), (4, 2, False), (0, 0, False), (1, 1, False)],
)
def test_a_train_crosses_the_border_only_with_an_authority_behind_the_last_train_here(
    comes_from: int, behind: int, *, joins: bool
) -> None:
    order = order_of((6, 1800.0), (1, 1400.0), (2, 500.0))
    told = replace(report(915.0, 1000.0), comes_from=comes_from, behind=behind)
    scene = scene_of(order, {2: 600.0})._replace(before=BEFORE)

    result = admit(order, told, scene)

    came = (*order[:2], RosterEntry(3, 915.0, True, 1), order[2])
    assert result == (came if joins else Waiting(AdmissionState.WAITS, behind))


AXLES = (Counted(900.0, 1000.0, True, 16), Counted(1000.0, 1100.0, True, 16))
"""The axles of one train more than the newcomer."""


@pytest.mark.parametrize(
    ("front_m", "before", "sieved"),
    [(1000.0, BEFORE, True), (1000.1, BEFORE, False), (1000.0, None, False), (990.0, None, False)],
)
def test_only_a_train_commanded_up_to_the_border_needs_no_axle_count(
    front_m: float, before: Area | None, *, sieved: bool
) -> None:
    told = replace(report(915.0, front_m), comes_from=4)

    result = admit((), told, scene_of(())._replace(before=before, counted=AXLES))

    assert result == (RosterEntry(3, 915.0, sieved, 1),)


def test_a_train_inside_an_area_needs_no_former_area() -> None:
    scene = scene_of(())._replace(before=BEFORE)

    assert admit((), replace(report(1500.0, 1585.0), behind=9), scene) == (
        RosterEntry(3, 1500.0, True, 1),
    )


def test_a_train_alone_among_its_own_axles_is_sieved() -> None:
    told = report(1005.0, 1090.0)
    alone = scene_of(())._replace(counted=(Counted(1000.0, 1100.0, True, 16),))
    crowded = alone._replace(counted=(Counted(1000.0, 1100.0, True, 32),))

    assert is_sieved(told, alone, ROOM_M) is True
    assert is_sieved(told, crowded, ROOM_M) is False
    assert (
        is_sieved(told, crowded._replace(standing=(StandingTrain(1010.0, 1080.0, 16),)), ROOM_M)
        is True
    )
    assert is_sieved(told, alone._replace(counted=()), ROOM_M) is False
    assert is_sieved(replace(told, standstill=False), alone, ROOM_M) is False
    assert is_sieved(told, alone._replace(stood=False), ROOM_M) is False


# A newcomer stands from 1300 m to 1385 m. Sections have 100 m; the area ends at 2000 m.
NEWCOMER = report(1300.0, 1385.0)
AHEAD = StandingTrain(1410.0, 1490.0, 16)


def counted(from_m: float = 1000.0, to_m: float = 2200.0, **axles: int) -> tuple[Counted, ...]:
    """Sections of 100 m; `at_1300=16` sets the axles of the one that starts at 1300 m."""
    told = {int(name.removeprefix("at_")): count for name, count in axles.items()}
    starts = range(int(from_m), int(to_m), 100)
    return tuple([Counted(at, at + 100.0, at in told, told.get(at, 0)) for at in starts])


def near(*at_rest: StandingTrain, **axles: int) -> AdmissionGuardInputs:
    """Guard inputs with moving trains whose possible positions cover the line, so no series of
    sections is known to be complete."""
    return scene_of(())._replace(
        counted=counted(**axles),
        standing=(StandingTrain(1000.0, 1700.0, 1), StandingTrain(1600.0, 2300.0, 1)),
        at_rest=at_rest,
        line_m=(0.0, 4000.0),
    )


@pytest.mark.parametrize(
    ("at_rest", "axles", "shown"),
    [
        ((), {"at_1300": 16}, True),
        ((), {"at_1300": 32}, False),
        # Ahead, all sections up to the first clear one count.
        ((), {"at_1300": 16, "at_1400": 16}, False),
        ((AHEAD,), {"at_1300": 16, "at_1400": 16}, True),
        ((AHEAD,), {"at_1300": 16, "at_1400": 32}, False),
        ((AHEAD,), {"at_1300": 16, "at_1400": 16, "at_1500": 1}, False),
        ((), {"at_1300": 16, "at_1500": 32}, True),
        # Behind, only the overhang of a coupler and the possible rollback count.
        ((), {"at_1300": 16, "at_1200": 4}, False),
        ((), {"at_1300": 16, "at_1100": 16}, True),
    ],
)
def test_a_train_is_sieved_when_all_axles_near_it_belong_to_trains_at_rest(
    at_rest: tuple[StandingTrain, ...], axles: dict[str, int], *, shown: bool
) -> None:
    assert is_sieved(NEWCOMER, near(*at_rest, **axles), ROOM_M) is shown


def test_behind_a_train_a_section_that_it_keeps_clear_of_may_be_occupied() -> None:
    axles = {"at_1300": 16, "at_1200": 16}

    assert is_sieved(report(1319.9, 1390.0), near(**axles), ROOM_M) is False
    assert is_sieved(report(1320.0, 1389.0), near(**axles), ROOM_M) is True


def test_the_distance_between_trains_exceeds_what_an_old_axle_count_can_confuse() -> None:
    """This also holds after rollback and jog, when a new master first receives a report of the
    train."""
    assert 2.0 * T2tConfig().behind_rear_m + EXCUSED_M <= APART_M


def test_the_track_that_a_train_may_still_reach_counts_as_its_own() -> None:
    latent = replace(report(1310.0, 1385.0), latent_m=1450.0)
    behind_a_gap = {"at_1300": 16, "at_1500": 16}

    assert is_sieved(latent, near(**behind_a_gap), ROOM_M) is True
    assert is_sieved(replace(latent, latent_m=1489.1), near(**behind_a_gap), ROOM_M) is False


def test_a_clear_section_that_ends_under_the_train_does_not_count_as_a_gap_ahead_of_it() -> None:
    pieces = ((1200.0, 1298.0, 16), (1298.0, 1300.0, 0), (1300.0, 1400.0, 1))
    told = tuple([Counted(start_m, end_m, n > 0, n) for start_m, end_m, n in pieces])
    scene = near()._replace(counted=told, standing=(StandingTrain(1240.0, 1260.0, 1),))

    assert is_sieved(report(1220.0, 1300.0), scene, 0.0) is False
    assert is_sieved(report(1220.0, 1299.9), scene, 0.0) is True


def test_trains_beyond_the_area_need_no_report() -> None:
    """The master commands no train there; it looks that far only because no section between is
    clear."""
    beyond = {"at_1900": 16, "at_2000": 16, "at_2100": 16}
    told = report(1900.0, 1985.0)

    assert is_sieved(told, near(**beyond), ROOM_M) is True
    assert is_sieved(told, near(**{**beyond, "at_1900": 32}), ROOM_M) is False
    # The newcomer extends over the border.
    assert is_sieved(report(1911.0, 1995.0), near(**beyond), ROOM_M) is False
    # The check also covers a whole area without a clear section.
    whole = {f"at_{at}": 16 for at in range(1800, 2200, 100)}
    back = report(1800.0, 1885.0)
    assert is_sieved(back, near(StandingTrain(1905.0, 1985.0, 16), **whole), ROOM_M) is True
    assert is_sieved(back, near(**whole), ROOM_M) is False


def test_unreported_sections_prove_nothing() -> None:
    alone = near(at_1300=16)
    for first_m, rear_m, known in (
        (1200.0, 1300.0, True),
        (1300.0, 1300.0, False),
        (1300.0, 1320.0, True),
        (1300.0, 1319.9, False),
    ):
        told = alone._replace(counted=counted(first_m, 1500.0, at_1300=16))
        assert is_sieved(report(rear_m, 1385.0), told, ROOM_M) is known
    told = alone._replace(counted=counted(1200.0, 1400.0, at_1300=16))
    assert is_sieved(report(1320.0, 1389.0), told, ROOM_M) is True
    assert is_sieved(report(1320.0, 1389.1), told, ROOM_M) is False
    # No vehicle stands beyond the ends of the line.
    line = told._replace(line_m=(1305.0, 1400.0))
    assert is_sieved(report(1310.0, 1395.0), line, ROOM_M) is True
    assert (
        is_sieved(report(1400.0, 1485.0), line._replace(counted=counted(at_1900=1)), 1.0) is False
    )


@pytest.mark.parametrize(
    ("from_m", "to_m", "known"),
    [(1100.0, 1200.0, True), (1150.0, 1150.0, False), (1160.0, 1150.0, False)],
)
def test_an_empty_stretch_proves_nothing(from_m: float, to_m: float, *, known: bool) -> None:
    for scene in (near(), scene_of(())):
        assert are_known(NEWCOMER, scene, counted(), from_m=from_m, to_m=to_m) is known


@pytest.mark.parametrize(
    ("standstill", "stood", "known"),
    [(True, True, True), (True, False, False), (False, True, False), (False, False, False)],
)
def test_a_newcomer_accounts_for_axles_if_it_stood_there_during_the_count(
    *, standstill: bool, stood: bool, known: bool
) -> None:
    told = replace(NEWCOMER, standstill=standstill)
    scene = near(at_1300=16)._replace(stood=stood)

    found = are_known(told, scene, counted(at_1300=16), from_m=1310.0, to_m=1350.0)
    assert found is known


def test_on_a_line_without_axle_counters_every_report_counts() -> None:
    assert (
        is_sieved(replace(report(1005.0, 1090.0), standstill=False), scene_of(()), ROOM_M) is True
    )


def test_all_axles_of_a_newcomer_lie_between_its_bounds() -> None:
    assert standing_of(report(1500.0, 1585.0)) == StandingTrain(1500.0, 1585.0, 16)


def test_applicants_are_admitted_foremost_first_and_then_by_number() -> None:
    told = {train: (report(0.0, at_m), 7) for train, at_m in ((1, 900.0), (9, 950.0), (4, 950.0))}

    assert [train for train, _ in sorted(told.items(), key=foremost_first)] == [4, 9, 1]
