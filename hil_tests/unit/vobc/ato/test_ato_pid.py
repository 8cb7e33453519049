"""The PID: proportional, integral and derivative action, its bounds and its hand-over."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vobc.ato.motion.pid import Pid
from vobc.ato.motion.shaper import Shaper
from vobc.ato.settings.ato import Limits
from vobc.ato.settings.pid import PidGains

GAINS = PidGains(0.7, 0.2, 0.3)
WIDE = {"low_mps2": -100.0, "high_mps2": 100.0}


def test_the_three_actions_add_up() -> None:
    pid = Pid()

    first = pid.step(GAINS, 1.0, 0.1, **WIDE)
    second = pid.step(GAINS, 1.5, 0.1, **WIDE)

    assert first == pytest.approx(0.7 * 1.0 + 0.2 * 0.1)
    assert second == pytest.approx(0.7 * 1.5 + 0.2 * (0.1 + 0.15) + 0.3 * 0.5 / 0.1)


def test_the_integral_does_not_wind_up_at_a_bound() -> None:
    """After a long saturation the output leaves the bound as soon as the error turns."""
    gains = PidGains(0.5, 0.5, 0.0)
    pid = Pid()
    for _ in range(1000):
        assert pid.step(gains, 2.0, 0.05, low_mps2=-0.8, high_mps2=0.8) == 0.8

    turned = pid.step(gains, -0.1, 0.05, low_mps2=-0.8, high_mps2=0.8)

    assert turned < 0.75


@given(errors=st.lists(st.floats(-5.0, 5.0), min_size=1, max_size=60))
def test_the_output_never_leaves_its_bounds(errors: list[float]) -> None:
    pid = Pid()

    outputs = [pid.step(GAINS, error, 0.05, low_mps2=-0.8, high_mps2=0.6) for error in errors]

    assert all(-0.8 <= output <= 0.6 for output in outputs)


@given(error=st.floats(-3.0, 3.0), output=st.floats(-0.7, 0.7))
def test_taking_over_continues_the_output(error: float, output: float) -> None:
    pid = Pid()

    pid.take_over(GAINS, error=error, output_mps2=output)

    dt_s = 0.05
    given_back = pid.step(GAINS, error, dt_s, **WIDE)
    assert given_back == pytest.approx(output + GAINS.ki_per_s2 * error * dt_s)


@given(wanted=st.lists(st.floats(-5.0, 5.0), min_size=1, max_size=100), dt_s=st.floats(0.02, 0.2))
def test_no_demand_exceeds_acceleration_or_jerk(wanted: list[float], dt_s: float) -> None:
    shaper, before = Shaper(Limits()), 0.0

    for wish in wanted:
        demand = shaper.step(wish, dt_s)
        assert abs(demand) <= 0.8
        assert abs(demand - before) <= 0.6 * dt_s + 1e-12
        before = demand


def test_a_demand_within_the_limits_is_met_exactly() -> None:
    shaper = Shaper(Limits())

    for _ in range(40):
        shaper.step(-0.5, 0.05)

    assert shaper.demand_mps2 == -0.5


@pytest.mark.parametrize(
    ("lost_mps2", "most_mps2"), [(-0.3, 0.8), (0.0, 0.8), (0.1, 0.9), (0.2, 1.0), (0.5, 1.0)]
)
def test_the_brake_demand_may_also_hold_a_falling_gradient_up_to_its_maximum(
    lost_mps2: float, most_mps2: float
) -> None:
    shaper = Shaper(Limits())

    for _ in range(60):
        shaper.step(-5.0, 0.05, lost_mps2=lost_mps2)

    assert shaper.demand_mps2 == pytest.approx(-most_mps2)
    assert Limits().brake_most_mps2(lost_mps2) == pytest.approx(most_mps2)


def test_the_brake_demand_falls_at_the_jerk_limit_where_the_gradient_ends() -> None:
    shaper = Shaper(Limits())
    for _ in range(60):
        shaper.step(-5.0, 0.05, lost_mps2=0.2)

    assert shaper.step(-5.0, 0.05) == pytest.approx(-1.0 + 0.6 * 0.05)


def test_dropping_traction_leaves_the_brake_alone() -> None:
    shaper = Shaper(Limits())
    for _ in range(10):
        shaper.step(0.8, 0.05)
    assert shaper.drop_traction() == 0.0
    for _ in range(10):
        shaper.step(-0.8, 0.05)
    assert shaper.drop_traction() == pytest.approx(-0.3)


@pytest.mark.parametrize("gains", [(-0.1, 0.0, 0.0), (0.0, -0.1, 0.0), (0.0, 0.0, -0.1)])
def test_a_negative_gain_is_refused(gains: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match="negative"):
        PidGains(*gains)
