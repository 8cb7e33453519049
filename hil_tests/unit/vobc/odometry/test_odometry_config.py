"""Settings of odometry at both sides of each limit."""

import math
from dataclasses import fields, replace

import pytest

from vobc.config import load_config
from vobc.odometry.config import RANGES, OdometryConfig

CONFIG = load_config("florence4").odometry


def with_one(name: str, value: float) -> OdometryConfig:
    return replace(CONFIG, **{name: value})  # type: ignore[arg-type]


def test_each_setting_has_a_range() -> None:
    scale = {"scale_error_low_ratio", "scale_error_high_ratio"}

    assert {field.name for field in fields(OdometryConfig)} - scale == RANGES.keys()


@pytest.mark.parametrize("name", sorted(RANGES))
def test_a_setting_is_valid_up_to_both_ends_of_its_range_and_not_beyond(name: str) -> None:
    least, most = RANGES[name]

    for value in (least, most):
        assert getattr(with_one(name, value), name) == value
    for value in (math.nextafter(least, -1e9), math.nextafter(most, 1e9), math.nan):
        with pytest.raises(ValueError, match=rf"^{name} .* is not in "):
            with_one(name, value)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("zero_speed_mps", 100.0),
        ("doppler_error_ratio", -0.012),
        ("scale_margin_ratio", -0.002),
        ("imu_error_mps2", -0.15),
        ("tag_stamp_s", -0.006),
        ("max_accel_mps2", 17.0),
    ],
)
def test_a_slip_of_the_pen_is_refused_with_its_name_and_value(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"^{name} {value} is not in "):
        with_one(name, value)


@pytest.mark.parametrize(
    ("low", "high", "taken"),
    [
        (0.0, 0.0, True),
        (-0.19, 0.19, True),
        (-0.2, 0.1, False),
        (-0.1, 0.2, False),
        (-0.1, -0.05, False),
        (0.05, 0.1, False),
    ],
)
def test_the_error_of_the_scale_encloses_zero_and_stays_within_a_fifth(
    low: float, high: float, *, taken: bool
) -> None:
    if taken:
        made = replace(CONFIG, scale_error_low_ratio=low, scale_error_high_ratio=high)
        assert (made.scale_error_low_ratio, made.scale_error_high_ratio) == (low, high)
        return
    words = (
        f"^scale_error_low_ratio {low} and scale_error_high_ratio {high} must enclose 0 within ±0.2"
    )
    with pytest.raises(ValueError, match=words):
        replace(CONFIG, scale_error_low_ratio=low, scale_error_high_ratio=high)
