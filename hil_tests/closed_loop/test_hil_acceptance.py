"""The acceptance campaign: its claims, and evidence from its quickest scenarios."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest

from can_dbc.doors import DoorState
from metro_hil.campaign import Campaign, ScenarioPlan, plan_cases, read_campaign
from metro_hil.metrics.case import motion_measures
from metro_hil.model.case import Case, as_expected
from metro_hil.model.log_columns import Columns
from metro_hil.model.requirements import shipped_requirements
from metro_hil.run.dispatch import run_case
from plant_emulator.process import TRUTH_COLUMNS

LEAST_SCENARIOS = 60
ROWS = {f"{row:02d}" for row in (*range(1, 15), *range(25, 30))}
NOT_MET = {"felt-jerk-2hz", "signalled-stop-gap"}
"""Scenarios that the product fails today; the tests notice when one joins or leaves them."""
PHASES = 10
CYCLE_S = 0.05


@pytest.fixture(scope="module")
def campaign() -> Campaign:
    return read_campaign("acceptance")


@pytest.fixture(scope="module")
def cases(campaign: Campaign) -> Mapping[str, Case]:
    return {case.id: case for case in plan_cases(campaign)}


@pytest.fixture(scope="module")
def files(campaign: Campaign, tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Path]:
    folder = tmp_path_factory.mktemp("files")
    for name, content in campaign.files.items():
        (folder / name).write_text(content, encoding="utf-8")
    return {name: folder / name for name in campaign.files}


def scenario(campaign: Campaign, name: str) -> ScenarioPlan:
    return next(plan for plan in campaign.scenarios if plan.name == name)


def rows_of(plan: ScenarioPlan) -> set[str]:
    return {name.removeprefix("ACC-") for name in plan.requirements if name.startswith("ACC-")}


def test_every_scenario_has_a_descriptive_name_and_names_its_row(campaign: Campaign) -> None:
    for plan in campaign.scenarios:
        assert re.fullmatch(r"[a-z]+(-[a-z0-9]+)*", plan.name), plan.name
        assert not plan.name.startswith("acc-"), plan.name
        assert rows_of(plan), plan.name
        assert plan.title, plan.name


def test_all_rows_that_the_product_can_run_are_there(campaign: Campaign) -> None:
    assert len(campaign.scenarios) >= LEAST_SCENARIOS
    assert set().union(*map(rows_of, campaign.scenarios)) == ROWS


def test_every_requirement_that_is_named_exists(cases: Mapping[str, Case]) -> None:
    known = shipped_requirements()
    named = {name for case in cases.values() for name in case.requirements}

    assert named <= set(known)


def test_every_scenario_has_its_own_criteria(cases: Mapping[str, Case]) -> None:
    assert [case.id for case in cases.values() if not case.monitors] == []


def test_scenarios_that_are_not_met_are_listed_by_name(campaign: Campaign) -> None:
    assert {plan.name for plan in campaign.scenarios if plan.expected} == NOT_MET
    assert all(each.margin_min for plan in campaign.scenarios for each in plan.expected)


def test_fixed_brake_delay_takes_the_21_runs_of_its_row(cases: Mapping[str, Case]) -> None:
    setups = [
        case.setup for case in cases.values() if case.scenario == "odometer-error-fixed-delay"
    ]

    assert {(each.load_ratio, each.odometer_error) for each in setups} == {
        (load, percent / 100.0) for load in (0.0, 0.5, 1.0) for percent in range(-1, 6)
    }
    assert len(setups) == 21


def test_every_run_with_random_brake_delays_has_its_own_seed(cases: Mapping[str, Case]) -> None:
    seeds = [case.seed for case in cases.values() if case.scenario == "odometer-error-random-delay"]

    assert len(seeds) == len(set(seeds)) == 20


@pytest.mark.parametrize(
    "name",
    [
        "bus-brake-command-dropped",
        "bus-traction-command-dropped",
        "bus-status-dropped",
        "bus-one-bit-flipped",
        "bus-replay",
        "bus-babbling",
    ],
)
def test_bus_faults_begin_in_every_phase_of_the_cycle(
    campaign: Campaign, cases: Mapping[str, Case], name: str
) -> None:
    assert not scenario(campaign, name).expected
    starts_s = [case.faults[0]["start_s"] for case in cases.values() if case.scenario == name]

    phases = sorted(round(start_s % CYCLE_S / CYCLE_S * PHASES) % PHASES for start_s in starts_s)

    assert phases == list(range(PHASES))


@pytest.mark.parametrize(
    "case_id",
    [
        "overspeed-runaway/0001-s1",
        "false-tag/s1",
        "undershoot-jog/s1",
        "overshoot-jog/s1",
        "slip-setting-off/0000-s1",
        "doors-lock-lost/s1",
        "doors-lock-lost-at-platform/s1",
        "bus-brake-command-dropped/0003-s1",
        "bus-emergency-brake-held/s1",
        "bus-one-bit-flipped/0007-s1",
        "passenger-alarm-leaving/s1",
        "voltage-0/0000-s1",
        "voltage-920-late-friction/s1",
    ],
)
def test_the_quickest_come_out_as_the_campaign_says(
    cases: Mapping[str, Case], files: Mapping[str, Path], case_id: str
) -> None:
    result = run_case(cases[case_id], files=files)

    assert as_expected(cases[case_id], result), result.reason


# The measures of the criteria, on rows written by hand.

LOCKED = int(DoorState.LOCKED)


def rows(
    *,
    front_m: Sequence[float],
    speed_mps: Sequence[float],
    emergency: Sequence[bool] | None = None,
    door_right: Sequence[int] | None = None,
) -> Columns:
    """A truth log with a row each second. Missing columns are zero, and doors are locked."""
    count = len(front_m)
    given: dict[str, Sequence[object]] = {
        "t_s": range(count),
        "front_m": front_m,
        "speed_mps": speed_mps,
        "emergency": emergency or [False] * count,
        "door_left": [LOCKED] * count,
        "door_right": door_right or [LOCKED] * count,
    }
    columns = [given.get(name, [0.0] * count) for name in TRUTH_COLUMNS]
    return Columns.of_rows("truth", TRUTH_COLUMNS, list(zip(*columns, strict=True)))


def test_the_emergency_distance_counts_from_the_row_before_the_brake_to_standstill() -> None:
    measures = motion_measures(
        rows(
            front_m=[0.0, 10.0, 20.0, 28.0, 30.0, 30.0],
            speed_mps=[10.0, 10.0, 9.0, 4.0, 0.0, 0.0],
            emergency=[False, False, True, True, True, True],
        ),
        (),
    )

    assert measures["emergency_distance_m"] == 20.0
    assert measures["emergency_speed_mps"] == 9.0


def test_of_several_emergencies_the_longest_distance_and_the_highest_speed_count() -> None:
    measures = motion_measures(
        rows(
            front_m=[0.0, 5.0, 8.0, 8.0, 9.0, 19.0, 40.0],
            speed_mps=[5.0, 5.0, 0.0, 0.0, 3.0, 12.0, 0.0],
            emergency=[False, True, True, False, False, True, True],
        ),
        (),
    )

    assert measures["emergency_distance_m"] == 31.0
    assert measures["emergency_speed_mps"] == 12.0


def test_a_train_that_never_came_to_rest_has_no_emergency_distance() -> None:
    measures = motion_measures(
        rows(
            front_m=[0.0, 10.0, 19.0],
            speed_mps=[10.0, 10.0, 8.0],
            emergency=[False, True, True],
        ),
        (),
    )

    assert measures["emergency_distance_m"] is None
    assert measures["emergency_speed_mps"] == 10.0


def test_an_emergency_at_standstill_has_neither_distance_nor_speed() -> None:
    measures = motion_measures(
        rows(front_m=[0.0, 0.0], speed_mps=[0.0, 0.0], emergency=[False, True]), ()
    )

    assert measures["emergency_distance_m"] is None
    assert measures["emergency_speed_mps"] is None
    assert measures["emergency_count"] == 1.0


def test_rollback_counts_from_the_foremost_position() -> None:
    measures = motion_measures(
        rows(front_m=[0.0, 1.0, 0.75, 3.0, 2.5], speed_mps=[1.0, 1.0, -0.5, 2.0, -0.5]), ()
    )

    assert measures["rollback_m"] == 0.5


def test_speed_with_open_doors_is_the_highest_in_either_direction() -> None:
    opening = int(DoorState.OPENING)

    measures = motion_measures(
        rows(
            front_m=[0.0, 0.0, -0.5, 3.0],
            speed_mps=[0.0, 0.25, -0.5, 9.0],
            door_right=[LOCKED, opening, opening, LOCKED],
        ),
        (),
    )

    assert measures["door_open_speed_max_mps"] == 0.5


def test_doors_that_never_opened_have_no_speed() -> None:
    measures = motion_measures(rows(front_m=[0.0, 9.0], speed_mps=[9.0, 9.0]), ())

    assert measures["door_open_speed_max_mps"] is None
