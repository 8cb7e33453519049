"""Three scenarios as tests: a departure, an emergency button, and a monitor that fails."""

from metro_hil.campaign.builder import Scenario


def test_the_train_departs_on_time_without_a_fault(bench):
    run = bench.start(Scenario(train={"end": "I"}))

    run.run_until("speed_mps > 1", timeout_s=20.0)

    assert run.controller.emergency_released


def test_an_emergency_button_stops_the_train_between_stations(bench):
    run = bench.start(Scenario(train={"start": "II", "end": "III"}))
    run.run_until("speed_mps > 8", timeout_s=60.0)
    pressed_at_m = run.train.front_m
    run.plan_faults({"kind": "emergency_button"})

    run.run_until("speed_mps == 0", timeout_s=30.0)

    assert run.train.front_m - pressed_at_m < 50.0
    assert not run.controller.emergency_released


def test_a_monitor_that_is_expected_to_fail(bench):
    slow = {"name": "slow", "stl": "always(speed_mps < 5)", "unit": "m/s"}
    run = bench.start(Scenario(train={"end": "I"}, monitor=[slow]), expect="slow")

    run.run_until("speed_mps > 6", timeout_s=60.0)
