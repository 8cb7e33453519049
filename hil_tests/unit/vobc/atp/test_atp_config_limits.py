"""Settings of protection at the edge of their valid range and beyond."""

from dataclasses import fields, replace

import pytest

from vobc.atp.config import AtpConfig, Timeouts
from vobc.config import load_config

CONFIG = load_config("florence4").atp
LEAST = 5e-324
"""The smallest positive float."""

POSITIVE = frozenset(
    {
        # With 0 a train never brakes, or no two values are ever told apart.
        "guaranteed_decel_mps2",
        "stop_decel_mps2",
        "interval_step_m",
        "replica_band_mps",
        # With 0 every input would be too old, too far or too fast in the first cycle.
        "authority_age_max_s",
        "orders_age_max_s",
        "restrictions_age_max_s",
        "clock_tolerance_s",
        "rollback_m",
        "held_movement_m",
        "overshoot_m",
        "door_window_m",
        # These are the speeds and distances of permitted movements.
        "restricted_mps",
        "creep_mps",
        "jog_mps",
        "jog_m",
    }
)
NOT_NEGATIVE = frozenset(
    {
        "runaway_mps2",
        "sensing_s",
        "traction_cut_s",
        "brake_build_up_s",
        "service_lead_s",
        "warning_lead_s",
        "permitted_lead_s",
        "takeover_margin_mps",
        "overruns_max",
        "replica_cycles_max",
        "brake_unit_s",
        "jog_attempts",
        "stop_patience_s",
    }
)
MARGINS = ("warning_margin_mps", "service_margin_mps", "emergency_margin_mps")
FLAT_MARGINS = tuple(f"flat_{name}" for name in MARGINS)
OTHERS = frozenset(
    {*MARGINS, *FLAT_MARGINS, "authority_service_ratio", "overshoot_mended_m", "timeouts"}
)
"""Settings that depend on each other or have a range."""


def with_one(name: str, value: float) -> AtpConfig:
    return replace(CONFIG, **{name: value})  # type: ignore[arg-type]


def test_each_setting_has_a_bound() -> None:
    groups = (POSITIVE, NOT_NEGATIVE, OTHERS)

    assert {field.name for field in fields(AtpConfig)} == POSITIVE | NOT_NEGATIVE | OTHERS
    assert sum(len(group) for group in groups) == len(fields(AtpConfig))


@pytest.mark.parametrize("name", sorted(POSITIVE))
def test_the_positive_settings_refuse_zero(name: str) -> None:
    with pytest.raises(ValueError, match=rf"^{name} 0\.0 is not positive$"):
        with_one(name, 0.0)
    assert getattr(with_one(name, LEAST), name) == LEAST


@pytest.mark.parametrize("name", sorted(NOT_NEGATIVE))
def test_the_settings_that_accept_zero_refuse_negative_values(name: str) -> None:
    with pytest.raises(ValueError, match=rf"^{name} -5e-324 is negative$"):
        with_one(name, -LEAST)
    assert getattr(with_one(name, 0.0), name) == 0.0


@pytest.mark.parametrize("name", [field.name for field in fields(Timeouts)])
def test_a_timeout_of_zero_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match=rf"^{name} 0\.0 is not positive$"):
        replace(CONFIG.timeouts, **{name: 0.0})
    assert getattr(replace(CONFIG.timeouts, **{name: LEAST}), name) == LEAST


@pytest.mark.parametrize("names", [MARGINS, FLAT_MARGINS])
@pytest.mark.parametrize(
    ("margins_mps", "fine"),
    [
        ((LEAST, 0.5, 1.0), True),
        ((0.0, 0.5, 1.0), False),
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
        words = rf"^0 < {names[0]} < {names[1]} < {names[2]} does not hold$"
        with pytest.raises(ValueError, match=words):
            replace(CONFIG, **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("ratio", "fine"), [(0.0, False), (LEAST, True), (1.0, True), (1.0000001, False)]
)
def test_the_service_brake_comes_within_the_age_of_an_authority_and_not_at_once(
    ratio: float, fine: bool
) -> None:
    """A ratio of 1 would apply service and emergency brake together."""
    if fine:
        assert with_one("authority_service_ratio", ratio).authority_service_ratio == ratio
    else:
        with pytest.raises(ValueError, match=rf"^authority_service_ratio {ratio} not in 0\.\.1$"):
            with_one("authority_service_ratio", ratio)


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
