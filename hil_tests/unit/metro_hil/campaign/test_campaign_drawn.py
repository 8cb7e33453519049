"""Cases generated from their seed: reproducible one by one, within bounds, with every fault of
the pool."""

import tomllib
from collections import Counter
from typing import Any

import pytest

from metro_hil.campaign import Campaign, CampaignError, define, plan_cases
from metro_hil.model.case import Case

DRAWN = """
seeds = {seeds}
[train]
start = "I"
end = "II"
[[fault]]
kind = "desk_reset"
start_s = 50.0
[sweep]
design = "drawn"
faults_min = {least}
faults_max = {most}
[sweep.window]
start_s = {{ low = 2.0, high = 40.0 }}
duration_s = 5.0
[[sweep.fault]]
kind = "wheel_slip"
slip_ratio = {{ low = 0.05, high = 0.2 }}
axle = ["a", "b", "both"]
[[sweep.fault]]
kind = "passenger_alarm"
duration_s = {{ low = 1.0, high = 2.0 }}
[[sweep.fault]]
kind = "frame_drop"
frames = "BRAKE_CMD*"
[sweep.factors]
"train.load_ratio" = {{ low = 0.25, high = 0.75 }}
"""


def campaign_of(text: str) -> Campaign:
    return define(tomllib.loads(text), source="x.toml", name="x").campaign


def cases_of(*, seeds: object = 200, least: int = 0, most: int = 2) -> tuple[Case, ...]:
    return plan_cases(campaign_of(DRAWN.format(seeds=seeds, least=least, most=most)))


def pool_of(case: Case) -> tuple[dict[str, Any], ...]:
    assert case.faults[0]["kind"] == "desk_reset"
    return case.faults[1:]


def test_every_seed_is_one_case_named_after_it() -> None:
    cases = cases_of(seeds=50)

    assert [case.id for case in cases] == [f"x/s{seed}" for seed in range(1, 51)]
    assert [case.seed for case in cases] == list(range(1, 51))


def test_one_seed_alone_is_the_case_of_the_whole_campaign() -> None:
    whole = {case.id: case for case in cases_of(seeds=50)}

    (alone,) = cases_of(seeds=[37])

    there = whole["x/s37"]
    assert (alone.id, alone.seed) == (there.id, there.seed)
    assert (alone.setup, alone.faults, alone.factors) == (there.setup, there.faults, there.factors)


def test_each_case_has_an_allowed_number_of_different_faults() -> None:
    counts = Counter(len(pool_of(case)) for case in cases_of(least=1, most=3))

    assert set(counts) == {1, 2, 3}
    for case in cases_of(least=1, most=3):
        kinds = [fault["kind"] for fault in pool_of(case)]
        assert len(kinds) == len(set(kinds))


def test_sampled_values_stay_within_bounds_and_reach_all_levels() -> None:
    cases = cases_of(seeds=400)
    slips = [f for case in cases for f in pool_of(case) if f["kind"] == "wheel_slip"]

    assert all(0.25 <= (case.setup.load_ratio or 0.0) <= 0.75 for case in cases)
    assert all(0.05 <= slip["slip_ratio"] <= 0.2 for slip in slips)
    assert all(2.0 <= slip["start_s"] <= 40.0 for slip in slips)
    assert {slip["axle"] for slip in slips} == {"a", "b", "both"}


def test_a_fault_of_the_pool_has_the_common_window_unless_it_has_its_own() -> None:
    faults = [fault for case in cases_of() for fault in pool_of(case)]

    assert {f["duration_s"] for f in faults if f["kind"] == "frame_drop"} == {5.0}
    alarms = [fault for fault in faults if fault["kind"] == "passenger_alarm"]
    assert all(1.0 <= alarm["duration_s"] <= 2.0 for alarm in alarms)


def test_the_sampled_kinds_are_a_factor_of_the_case() -> None:
    for case in cases_of():
        kinds = sorted(fault["kind"] for fault in pool_of(case))
        assert case.factors["fault"] == (" + ".join(kinds) or "none")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (DRAWN.format(seeds=2, least=2, most=1), r"sweep.faults_max: 1 is not within"),
        (DRAWN.format(seeds=2, least=0, most=4), r"sweep.faults_max: 4 is not within"),
        (DRAWN.format(seeds=[1, 2], least=0, most=1), r"seeds: with design 'drawn'"),
        (
            DRAWN.format(seeds=2, least=0, most=3).replace("slip_ratio", "slip"),
            r"fault\[\d\].slip.*unknown",
        ),
        (
            '[sweep]\ndesign = "random"\ncount = 2\nfaults_max = 2\n'
            '[sweep.factors]\n"train.load_ratio" = [0.0, 1.0]',
            r"faults_max.* is for design drawn alone",
        ),
        (
            '[sweep]\n[sweep.factors]\n"train.load_ratio" = [0.0, 1.0]\n'
            '[[sweep.fault]]\nkind = "wheel_slip"',
            r"sweep.fault: is for design 'drawn' alone",
        ),
    ],
)
def test_an_error_of_a_pool_is_reported_with_its_key(text: str, words: str) -> None:
    with pytest.raises(CampaignError, match=words):
        campaign_of(text)
