"""Settings of odometry at both sides of each limit."""

from dataclasses import replace

import pytest

from vobc.config import load_config

CONFIG = load_config("florence4").odometry


@pytest.mark.parametrize(
    "name",
    [
        "scale_sigma_ratio", "scale_base_m", "start_bound_m", "tag_bound_m", "tag_sigma_m",
        "tag_reach_m", "missed_tags_max", "localisation_limit_m", "tracking_rad_s", "window_s",
        "max_accel_mps2", "max_speed_mps", "standing_s", "silence_s", "zero_speed_mps",
        "zero_speed_s", "doppler_error_mps", "imu_error_mps2", "unseen_slip_ratio", "slip_hold_s",
    ],
)  # fmt: skip
def test_what_must_be_positive_is_refused_at_zero_and_below(name: str) -> None:
    for value in (0, -1):
        with pytest.raises(ValueError, match=f"^{name} {value} is not positive$"):
            replace(CONFIG, **{name: value})
    assert getattr(replace(CONFIG, **{name: 1}), name) == 1


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
