"""Monitors in real runs: they pass a correct run and detect violations."""

from typing import Any

import pytest

from metro_hil.model.case import Case, CaseResult, MonitorResult, Setup, Verdict
from metro_hil.monitors.catalogue import WATCHED
from metro_hil.run.dispatch import run_case

HOP = Setup(start="II", end="III", duration_s=120.0)


def run(setup: Setup = HOP, seed: int = 1, **more: Any) -> CaseResult:
    return run_case(Case(id="case", index=0, scenario="case", seed=seed, setup=setup, **more))


def shown(result: CaseResult) -> dict[str, MonitorResult]:
    """The monitors whose premise held."""
    return {each.name: each for each in result.monitors if each.verdict is not Verdict.VACUOUS}


@pytest.mark.parametrize(
    ("odometer_error", "load_ratio", "seed"), [(0.05, 1.0, 1), (-0.01, 0.0, 2)]
)
def test_a_correct_run_violates_no_monitor(
    odometer_error: float, load_ratio: float, seed: int
) -> None:
    setup = Setup(start="II", end="III", odometer_error=odometer_error, load_ratio=load_ratio)
    result = run(setup, seed)

    assert {each.verdict for each in shown(result).values()} == {Verdict.PASS}
    # No fault occurs, so no reaction to a fault can be shown.
    silent = {each.name for each in WATCHED} - set(shown(result))
    assert silent == {
        "inv-03-emergency-at-curve",
        "inv-04-restriction",
        "inv-05-emergency-held",
        "inv-06-traction-off",
        "inv-07-demand-ignored",
        "inv-08-rollback",
        "inv-10-jog-attempts",
        "inv-10-jog-covered",
        "inv-10-jog-distance",
        "inv-10-jog-speed",
        "inv-12-restricted-speed",
        "inv-15-refused-tag",
        "inv-16-missed-tags",
        "inv-23-switch-brake",
        "inv-23-switch-locked",
        "inv-24-authority-age",
        "inv-36-overrun",
        "inv-41-neutral-section",
        "inv-42-no-stop-zone",
        "inv-43-evacuation-stop",
    }


@pytest.mark.parametrize("cycle_ms", [100.0, 200.0])
def test_a_controller_with_a_long_cycle_keeps_its_position_and_arrives(cycle_ms: float) -> None:
    result = run(Setup(start="II", end="III", cycle_ms=cycle_ms, duration_s=90.0))

    assert {each.verdict for each in shown(result).values()} == {Verdict.PASS}
    assert result.measures["arrived_count"] == 1.0


def test_a_runaway_exercises_the_emergency_brake_monitors() -> None:
    """The published worst case: traction pushes with 1 m/s² until it is cut."""
    fault = {"kind": "traction_runaway", "when": "speed_mps > 12", "accel_mps2": 1.0}
    stl = "always(emergency and speed_mps > 1 -> eventually[0:0.3](drive_n <= 0))"
    result = run(faults=(fault,), monitors=({"stl": stl, "name": "cut", "unit": "N"},))

    seen = shown(result)
    assert result.verdict is Verdict.PASS, result.reason
    assert {"inv-05-emergency-held", "inv-06-traction-off", "cut"} <= set(seen)
    margin_s = seen["inv-06-traction-off"].margin
    assert margin_s is not None
    assert 0.0 <= margin_s < 0.3
    # The margin is smaller than in a correct run, where the authority reaches 60 m past the stop.
    margin_m = seen["inv-01-stopping-distance"].margin
    assert margin_m is not None
    assert 0.0 < margin_m < 60.0


def test_the_run_ends_at_the_first_violation() -> None:
    result = run(monitors=({"stl": "always(speed_mps <= 10)", "name": "slow", "unit": "m/s"},))

    slow = next(each for each in result.monitors if each.name == "slow")
    assert result.verdict is slow.verdict is Verdict.FAIL
    assert slow.margin is not None
    assert -0.02 < slow.margin < 0.0
    assert slow.at_s == pytest.approx(result.sim_s, abs=0.1)


def test_a_wheel_beyond_its_declared_error_puts_the_front_outside_its_interval() -> None:
    """Pulses come 20 % too rarely; the declared range is 1 % too rarely to 5 % too often.

    The radar has the same error, because otherwise it alone would keep the position correct.
    """
    result = run(
        Setup(start="II", end="III", odometer_error=-0.2, duration_s=60.0),
        faults=({"kind": "doppler_wrong", "error_ratio": -0.2, "start_s": 0.0},),
        invariants=("inv-13",),
    )

    (interval,) = result.monitors
    assert interval.verdict is Verdict.FAIL
    assert interval.requirements == ("INV-13",)
