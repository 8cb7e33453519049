"""Which monitors can judge a train without known truth."""

import pytest

from metro_hil.model.case import MonitorResult, Verdict
from metro_hil.monitors import read_monitors
from metro_hil.realtime.without_truth import needs_truth, with_unjudged


@pytest.mark.parametrize(
    ("table", "needed"),
    [
        ({"stl": "always(ceiling_mps <= 30.0)"}, False),
        ({"stl": "always(t_s < 5 or status_age_s < 0.2)"}, False),
        ({"stl": "always(claimed_speed_mps <= speed_mps + 1)"}, True),
        ({"stl": "always(to_authority_m >= 0)"}, True),
        ({"invariant": "INV-13"}, True),
        ({"measure": "stop_error_worst_m", "max": 0.1}, False),
    ],
)
def test_a_monitor_with_signals_that_are_not_on_the_bus_needs_the_truth(
    table: dict[str, object], needed: bool
) -> None:
    (plan,) = read_monitors([{"name": "m", **table}], "case", "none")

    assert needs_truth(plan) is needed


def test_unjudged_monitors_are_inconclusive_and_keep_their_place() -> None:
    tables = [
        {"name": "first", "stl": "always(speed_mps <= 30)"},
        {"name": "second", "stl": "always(ceiling_mps <= 30)"},
    ]
    plans = read_monitors(tables, "case", "none")
    judged = MonitorResult(name="second", verdict=Verdict.PASS, margin=1.0, unit="")

    results = with_unjudged(plans, [judged])

    assert [result.verdict for result in results] == [Verdict.INCONCLUSIVE, Verdict.PASS]
