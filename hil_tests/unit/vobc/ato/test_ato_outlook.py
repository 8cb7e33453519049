"""The smoothed position and the ceiling forecast."""

import pytest

from vobc.ato.model.ceiling_forecast import CeilingOutlook, SmoothFront

DT_S = 0.05


def test_pulse_steps_are_smoothed() -> None:
    front = SmoothFront()
    front.step(100.0, moved_m=0.0, at_tag=False)
    for cycle in range(1, 200):
        true_m = 100.0 + 0.02 * cycle
        counted_m = 100.0 + int(0.02 * cycle / 0.0106) * 0.0106 + 0.0053
        front.step(counted_m, moved_m=0.02, at_tag=False)

    assert front.front_m == pytest.approx(true_m, abs=0.004)


@pytest.mark.parametrize(("jump_m", "at_tag"), [(0.04, True), (0.8, False)])
def test_a_tag_or_a_large_jump_takes_effect_at_once(jump_m: float, at_tag: bool) -> None:
    front = SmoothFront()
    front.step(100.0, moved_m=0.0, at_tag=False)

    front.step(100.0 + jump_m, moved_m=0.0, at_tag=at_tag)

    assert front.front_m == 100.0 + jump_m


def test_a_steadily_falling_ceiling_is_forecast_to_go_on_falling() -> None:
    ceiling = CeilingOutlook()
    for cycle in range(100):
        ceiling.step(18.0 - 0.8 * DT_S * cycle, DT_S)

    now_mps = 18.0 - 0.8 * DT_S * 99
    assert ceiling.in_mps(1.0) == pytest.approx(now_mps - 0.8, abs=0.01)


def test_a_step_of_the_ceiling_is_not_extrapolated() -> None:
    ceiling = CeilingOutlook()
    for _ in range(50):
        ceiling.step(18.0, DT_S)

    ceiling.step(11.0, DT_S)

    assert ceiling.in_mps(1.0) == pytest.approx(11.0)
