"""Settings of protection at the edge of their valid range and beyond."""

import math
from dataclasses import fields, replace

import pytest

from vobc.atp.config import RANGES, TIMEOUT_S, AtpConfig, Timeouts
from vobc.config import load_config

CONFIG = load_config("florence4").atp
MARGINS = ("warning_margin_mps", "service_margin_mps", "emergency_margin_mps")
FLAT_MARGINS = tuple(f"flat_{name}" for name in MARGINS)


def with_one(name: str, value: float) -> AtpConfig:
    return replace(CONFIG, **{name: value})  # type: ignore[arg-type]


def refused_for_its_range(name: str, value: float) -> bool:
    """Another order or relation may refuse the value, too; only its own range counts."""
    try:
        with_one(name, value)
    except ValueError as error:
        return str(error).startswith(f"{name} ") and " is not in " in str(error)
    return False


def test_each_setting_has_a_range() -> None:
    assert {field.name for field in fields(AtpConfig)} - {"timeouts"} == RANGES.keys()


@pytest.mark.parametrize("name", sorted(RANGES))
def test_a_setting_is_valid_up_to_both_ends_of_its_range_and_not_beyond(name: str) -> None:
    least, most = RANGES[name]

    for value in (least, most):
        assert not refused_for_its_range(name, value)
    for value in (math.nextafter(least, -1e9), math.nextafter(most, 1e9), math.nan, math.inf):
        assert refused_for_its_range(name, value)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("guaranteed_decel_mps2", 50.0),
        ("guaranteed_decel_mps2", 0.1),
        ("door_window_m", 1e9),
        ("overruns_max", 1000),
        ("authority_age_max_s", 3600.0),
        ("brake_build_up_s", -1.05),
    ],
)
def test_a_slip_of_the_pen_is_refused_with_its_name_and_range(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=rf"^{name} {value} is not in .*\.\."):
        with_one(name, value)


@pytest.mark.parametrize("name", [field.name for field in fields(Timeouts)])
def test_a_timeout_has_a_range(name: str) -> None:
    for value in TIMEOUT_S:
        assert getattr(replace(CONFIG.timeouts, **{name: value}), name) == value
    for value in (0.0, 60.0, math.nan):
        with pytest.raises(ValueError, match=rf"^{name} {value} is not in 0\.02\.\.5$"):
            replace(CONFIG.timeouts, **{name: value})


@pytest.mark.parametrize("names", [MARGINS, FLAT_MARGINS])
@pytest.mark.parametrize(
    ("margins_mps", "fine"),
    [
        ((0.1, 0.5, 1.0), True),
        ((0.5, 0.6, 1.0), True),
        ((0.5, 0.5, 1.0), False),
        ((0.5, 0.9, 1.0), True),
        ((0.5, 1.0, 1.0), False),
    ],
)
def test_warning_comes_before_service_brake_and_that_before_emergency_brake(
    names: tuple[str, str, str], margins_mps: tuple[float, float, float], fine: bool
) -> None:
    changes = dict(zip(names, margins_mps, strict=True))

    if fine:
        replace(CONFIG, **changes)  # type: ignore[arg-type]
    else:
        words = rf"^{names[0]} < {names[1]} < {names[2]} does not hold$"
        with pytest.raises(ValueError, match=words):
            replace(CONFIG, **changes)  # type: ignore[arg-type]


def test_a_jog_corrects_at_least_the_overshoot_that_brakes() -> None:
    mended_m = CONFIG.overshoot_mended_m

    assert with_one("overshoot_m", mended_m).overshoot_m == mended_m
    words = r"^overshoot_m 5\.000001 is more than overshoot_mended_m 5\.0$"
    with pytest.raises(ValueError, match=words):
        with_one("overshoot_m", mended_m + 1e-6)


@pytest.mark.parametrize(
    ("cycle_s", "overruns_max", "runaway_s"),
    [(0.05, 2, 0.48), (0.05, 0, 0.38), (0.05, 1, 0.43), (0.1, 2, 0.63), (0.02, 4, 0.43)],
)
def test_the_runaway_time_is_sensing_missed_cycles_one_cycle_and_the_cut(
    cycle_s: float, overruns_max: int, runaway_s: float
) -> None:
    """The times are 0.03 s of sensing, 0.3 s until the cut, and as many cycles as may be missed."""
    config = replace(CONFIG, overruns_max=overruns_max)

    assert config.runaway_s(cycle_s) == pytest.approx(runaway_s, abs=1e-12)
