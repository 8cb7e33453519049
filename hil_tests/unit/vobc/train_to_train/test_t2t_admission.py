"""Who gets a place on the roster and where, and what trains mean to others that have none yet."""

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


def test_nobody_comes_nearer_to_it_than_to_a_train_that_may_set_back() -> None:
    standing = report(1500.0, 1585.0)

    assert kept_free([(standing, 7)], {1: 1, 2: 1}, CONFIG) == [
        BarredTrack(1493.0, 1585.0, Bar.CLOSING)
    ]


@pytest.mark.parametrize(
    ("told", "boots"),
    [(report(1500.0, 1585.0), {3: BOOT}), (report(0.0, 9.0, localised=False), {1: BOOT})],
)
def test_a_train_of_the_roster_or_a_lost_one_bars_nothing_by_its_report(
    told: TrainReport, boots: dict[int, int]
) -> None:
    assert kept_free([(told, 7)], boots, CONFIG) == []


def test_one_that_the_roster_keeps_in_another_life_is_kept_free_where_it_says_that_it_is() -> None:
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
def test_who_has_no_place_on_the_roster_explains_axles_from_outside_of_the_area_only(
    rear_m: float, front_m: float, explains: bool
) -> None:
    told = report(rear_m, front_m)
    roster = {each: TrainRecord(each, 0.0, 0, boot=BOOT) for each in (1, 2)}
    kept = {**roster, 3: TrainRecord(3, rear_m, 0, boot=BOOT)}

    assert may_explain(told, roster, AREA) is explains
    assert may_explain(told, kept, AREA)
    assert not may_explain(replace(told, localised=False), kept, AREA)


@pytest.mark.parametrize("boot", [0, BOOT + 1])
def test_in_another_life_than_that_of_its_place_it_has_none(boot: int) -> None:
    kept = {3: TrainRecord(3, 1500.0, 0, boot=boot)}

    assert not may_explain(report(1500.0, 1585.0), kept, AREA)
    assert may_explain(report(2000.0, 2085.0), kept, AREA)


def order_of(*trains: tuple[int, float]) -> Order:
    return tuple([RosterEntry(train, rear_m, True, 1) for train, rear_m in trains])


def scene_of(order: Order, reserved_m: dict[int, float] | None = None) -> AdmissionGuardInputs:
    """At the start of a line that counts no axles."""
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
def test_a_newcomer_joins_the_roster_where_it_stands_and_nobody_else_moves(
    rear_m: float, trains: list[int]
) -> None:
    told = report(rear_m, rear_m + 85.0)

    order = admit(THREE, told, scene_of(THREE, THREE_RESERVED_M))

    assert isinstance(order, tuple)
    assert [each.train for each in order if isinstance(each, RosterEntry)] == trains
    assert order[trains.index(3)] == RosterEntry(3, rear_m, True, 1)
    assert tuple(each for each in order if each != order[trains.index(3)]) == THREE


def test_the_first_train_of_an_area_meets_nobody_and_joins() -> None:
    assert admit((), report(1500.0, 1585.0), scene_of(())) == (RosterEntry(3, 1500.0, True, 1),)


@pytest.mark.parametrize("rear_m", [-300.0, 3.0, 7.5])
def test_whoever_has_nobody_behind_it_may_stand_wherever_a_line_begins(rear_m: float) -> None:
    order = order_of((1, 1700.0))

    result = admit(order, report(rear_m, rear_m + 85.0), scene_of(order))

    assert result == (*order, RosterEntry(3, rear_m, True, 1))


@pytest.mark.parametrize(("reserved_m", "joins"), [(1493.0, True), (1493.1, False)])
def test_the_train_behind_must_not_reach_where_a_newcomer_may_set_back_to(
    reserved_m: float, *, joins: bool
) -> None:
    order = order_of((1, 1700.0), (2, 1200.0))

    result = admit(order, report(1500.0, 1585.0), scene_of(order, {1: 1900.0, 2: reserved_m}))

    assert (result == Waiting(AdmissionState.UNPLACED, 2)) is not joins


def test_before_a_train_of_which_nobody_knows_what_it_holds_nobody_joins() -> None:
    order = order_of((1, 1700.0), (2, 1200.0))

    result = admit(order, report(1500.0, 1585.0), scene_of(order))

    assert result == Waiting(AdmissionState.UNPLACED, 2)


@pytest.mark.parametrize(("ahead_m", "joins"), [(1587.0, True), (1586.9, False)])
def test_a_newcomer_must_not_stand_where_the_train_ahead_may_roll_back_to(
    ahead_m: float, *, joins: bool
) -> None:
    order = order_of((6, 1900.0), (1, ahead_m))

    result = admit(order, report(1500.0, 1585.0), scene_of(order))

    assert (result == Waiting(AdmissionState.UNPLACED, 1)) is not joins


def test_whose_front_touches_a_rear_stands_behind_it() -> None:
    order = order_of((1, 1585.0))
    rigid = T2tConfig(rollback_m=0.0, jog_m=5.0)

    result = admit(order, report(1500.0, 1585.0), scene_of(order), rigid)

    assert result == (*order, RosterEntry(3, 1500.0, True, 1))


def test_a_newcomer_stands_before_the_first_train_that_is_not_ahead_of_it() -> None:
    """The roster knows the order better than places do that are bounds only."""
    order = order_of((1, 1200.0), (2, 1900.0))

    result = admit(order, report(1500.0, 1585.0), scene_of(order, {1: 1300.0, 2: 1300.0}))

    assert result == (RosterEntry(3, 1500.0, True, 1), *order)


@pytest.mark.parametrize(("trains", "full"), [(127, False), (128, True), (129, True)])
def test_a_roster_of_128_trains_takes_nobody_any_more(trains: int, *, full: bool) -> None:
    order = order_of(*[(10 + at, 1990.0) for at in range(trains)])

    result = admit(order, report(1500.0, 1585.0), scene_of(order))

    assert (result == Waiting(AdmissionState.FULL, 0)) is full


@pytest.mark.parametrize(
    ("comes_from", "behind", "joins"),
    [(4, 0, True), (4, 1, True), (4, 6, False), (4, 2, False), (0, 0, False), (1, 1, False)],
)
def test_over_the_border_only_comes_who_is_commanded_there_behind_who_is_last_here(
    comes_from: int, behind: int, *, joins: bool
) -> None:
    order = order_of((6, 1800.0), (1, 1400.0), (2, 500.0))
    told = replace(report(915.0, 1000.0), comes_from=comes_from, behind=behind)
    scene = scene_of(order, {2: 600.0})._replace(before=BEFORE)

    result = admit(order, told, scene)

    came = (*order[:2], RosterEntry(3, 915.0, True, 1), order[2])
    assert result == (came if joins else Waiting(AdmissionState.WAITS, behind))


AXLES = (Counted(900.0, 1000.0, True, 16), Counted(1000.0, 1100.0, True, 16))
"""Of one train more than the newcomer."""


@pytest.mark.parametrize(
    ("front_m", "before", "sieved"),
    [(1000.0, BEFORE, True), (1000.1, BEFORE, False), (1000.0, None, False), (990.0, None, False)],
)
def test_whoever_is_commanded_up_to_the_border_needs_no_counting_and_all_others_do(
    front_m: float, before: Area | None, *, sieved: bool
) -> None:
    told = replace(report(915.0, front_m), comes_from=4)

    result = admit((), told, scene_of(())._replace(before=before, counted=AXLES))

    assert result == (RosterEntry(3, 915.0, sieved, 1),)


def test_within_an_area_nobody_needs_to_come_from_another() -> None:
    scene = scene_of(())._replace(before=BEFORE)

    assert admit((), replace(report(1500.0, 1585.0), behind=9), scene) == (
        RosterEntry(3, 1500.0, True, 1),
    )


def test_nothing_hides_near_a_train_that_stands_where_as_many_axles_are_as_it_has() -> None:
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


# A newcomer at 1300 m to 1385 m; sections of 100 m, the area ends at 2000 m.
NEWCOMER = report(1300.0, 1385.0)
AHEAD = StandingTrain(1410.0, 1490.0, 16)


def counted(from_m: float = 1000.0, to_m: float = 2200.0, **axles: int) -> tuple[Counted, ...]:
    """Sections of 100 m; `at_1300=16` for that from 1300 m on."""
    told = {int(name.removeprefix("at_")): count for name, count in axles.items()}
    starts = range(int(from_m), int(to_m), 100)
    return tuple([Counted(at, at + 100.0, at in told, told.get(at, 0)) for at in starts])


def near(*at_rest: StandingTrain, **axles: int) -> AdmissionGuardInputs:
    """Somebody moves who says that it is everywhere: of a whole run nothing is known."""
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
        # It looks ahead without a gap, and no farther than a gap.
        ((), {"at_1300": 16, "at_1400": 16}, False),
        ((AHEAD,), {"at_1300": 16, "at_1400": 16}, True),
        ((AHEAD,), {"at_1300": 16, "at_1400": 32}, False),
        ((AHEAD,), {"at_1300": 16, "at_1400": 16, "at_1500": 1}, False),
        ((), {"at_1300": 16, "at_1500": 32}, True),
        # Behind only as far as a coupler hangs over and the train may come back.
        ((), {"at_1300": 16, "at_1200": 4}, False),
        ((), {"at_1300": 16, "at_1100": 16}, True),
    ],
)
def test_near_a_train_all_axles_are_of_trains_at_rest(
    at_rest: tuple[StandingTrain, ...], axles: dict[str, int], *, shown: bool
) -> None:
    assert is_sieved(NEWCOMER, near(*at_rest, **axles), ROOM_M) is shown


def test_behind_a_train_a_section_that_it_keeps_clear_of_may_be_occupied() -> None:
    axles = {"at_1300": 16, "at_1200": 16}

    assert is_sieved(report(1319.9, 1390.0), near(**axles), ROOM_M) is False
    assert is_sieved(report(1320.0, 1389.0), near(**axles), ROOM_M) is True


def test_nobody_hides_so_near_behind_a_train_that_an_old_look_could_take_it_for_that_one() -> None:
    """Also after it has rolled and jogged back, when a new master first hears of it."""
    assert 2.0 * T2tConfig().behind_rear_m + EXCUSED_M <= APART_M


def test_where_it_may_still_come_counts_as_where_it_stands() -> None:
    latent = replace(report(1310.0, 1385.0), latent_m=1450.0)
    behind_a_gap = {"at_1300": 16, "at_1500": 16}

    assert is_sieved(latent, near(**behind_a_gap), ROOM_M) is True
    assert is_sieved(replace(latent, latent_m=1489.1), near(**behind_a_gap), ROOM_M) is False


def test_a_clear_piece_that_ends_where_it_stands_is_no_gap_ahead_of_it() -> None:
    pieces = ((1200.0, 1298.0, 16), (1298.0, 1300.0, 0), (1300.0, 1400.0, 1))
    told = tuple([Counted(start_m, end_m, n > 0, n) for start_m, end_m, n in pieces])
    scene = near()._replace(counted=told, standing=(StandingTrain(1240.0, 1260.0, 1),))

    assert is_sieved(report(1220.0, 1300.0), scene, 0.0) is False
    assert is_sieved(report(1220.0, 1299.9), scene, 0.0) is True


def test_whoever_stands_beyond_the_area_need_not_be_heard() -> None:
    """Its master commands nobody there; that it can look so far it owes to a gap that is not."""
    beyond = {"at_1900": 16, "at_2000": 16, "at_2100": 16}
    told = report(1900.0, 1985.0)

    assert is_sieved(told, near(**beyond), ROOM_M) is True
    assert is_sieved(told, near(**{**beyond, "at_1900": 32}), ROOM_M) is False
    # It hangs over the border.
    assert is_sieved(report(1911.0, 1995.0), near(**beyond), ROOM_M) is False
    # And as far as the whole area is occupied without a gap.
    whole = {f"at_{at}": 16 for at in range(1800, 2200, 100)}
    back = report(1800.0, 1885.0)
    assert is_sieved(back, near(StandingTrain(1905.0, 1985.0, 16), **whole), ROOM_M) is True
    assert is_sieved(back, near(**whole), ROOM_M) is False


def test_of_sections_that_were_not_told_nothing_is_known() -> None:
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
    # Beyond the ends of the line nobody is.
    line = told._replace(line_m=(1305.0, 1400.0))
    assert is_sieved(report(1310.0, 1395.0), line, ROOM_M) is True
    assert (
        is_sieved(report(1400.0, 1485.0), line._replace(counted=counted(at_1900=1)), 1.0) is False
    )


@pytest.mark.parametrize(
    ("from_m", "to_m", "known"),
    [(1100.0, 1200.0, True), (1150.0, 1150.0, False), (1160.0, 1150.0, False)],
)
def test_between_two_places_that_are_none_nothing_is_known(
    from_m: float, to_m: float, *, known: bool
) -> None:
    for scene in (near(), scene_of(())):
        assert are_known(NEWCOMER, scene, counted(), from_m=from_m, to_m=to_m) is known


@pytest.mark.parametrize(
    ("standstill", "stood", "known"),
    [(True, True, True), (True, False, False), (False, True, False), (False, False, False)],
)
def test_a_newcomer_explains_axles_if_it_stood_there_when_they_were_counted(
    *, standstill: bool, stood: bool, known: bool
) -> None:
    told = replace(NEWCOMER, standstill=standstill)
    scene = near(at_1300=16)._replace(stood=stood)

    found = are_known(told, scene, counted(at_1300=16), from_m=1310.0, to_m=1350.0)
    assert found is known


def test_on_a_line_that_counts_no_axles_everybody_is_believed() -> None:
    assert (
        is_sieved(replace(report(1005.0, 1090.0), standstill=False), scene_of(()), ROOM_M) is True
    )


def test_a_newcomer_stands_with_all_its_axles_between_its_bounds() -> None:
    assert standing_of(report(1500.0, 1585.0)) == StandingTrain(1500.0, 1585.0, 16)


def test_applicants_are_taken_from_the_foremost_back_and_side_by_side_by_their_number() -> None:
    told = {train: (report(0.0, at_m), 7) for train, at_m in ((1, 900.0), (9, 950.0), (4, 950.0))}

    assert [train for train, _ in sorted(told.items(), key=foremost_first)] == [4, 9, 1]
