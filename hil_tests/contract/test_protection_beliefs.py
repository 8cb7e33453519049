"""The parameters of protection are never less conservative than their sources allow."""

import tomllib
from operator import attrgetter
from pathlib import Path
from typing import Any

import pytest

from can_dbc.agreement import Frame
from can_dbc.nodes import Direction
from can_dbc.odometer import ColdMovement, Doppler, Imu, Tacho
from can_dbc.packing import packer
from vobc.config import load_config

KMH = 1.0 / 3.6
CAMPAIGNS = Path(__file__).parents[1] / "metro_hil" / "campaign" / "shipped"

AT_MOST = {
    # [Allotta 2013]: warning at 3 km/h above the speed of the segment, emergency at 8 km/h.
    "atp.warning_margin_mps": 3.0 * KMH,
    "atp.emergency_margin_mps": 8.0 * KMH,
    # Guaranteed emergency brake rate; the nominal value in [Lin] is 1.2.
    "atp.guaranteed_decel_mps2": 1.0,
    "atp.rollback_m": 0.5,
    "atp.held_movement_m": 0.5,
    "atp.overruns_max": 2,
    "atp.authority_age_max_s": 3.0,
    "atp.authority_service_ratio": 1.0,
    "atp.restricted_mps": 25.0 * KMH,
    "atp.jog_mps": 5.0 * KMH,
    "atp.jog_m": 5.0,
    "atp.jog_attempts": 3,
    "atp.overshoot_m": 1.0,
    "atp.overshoot_mended_m": 5.0,
    "atp.door_window_m": 0.3,
    "atp.timeouts.tacho_s": 0.25,
    "atp.timeouts.brake_s": 0.25,
    "atp.timeouts.traction_s": 0.25,
    "atp.timeouts.doors_s": 0.3,
    "atp.timeouts.desk_s": 0.3,
    # [Allotta 2013]: the odometer counts between 1 % too little and 5 % too much.
    "odometry.scale_error_low_ratio": -0.01,
    "odometry.missed_tags_max": 2,
    # IEEE 1474.1: zero speed is below 1 km/h for 2 s.
    "odometry.zero_speed_mps": 1.0 * KMH,
    "odometry.cold_movement_m": 2.0,
}
AT_LEAST = {
    # The Chinese ATP vehicle interface: traction cut within 0.30 s, brake built up after 1.05 s.
    "atp.traction_cut_s": 0.3,
    "atp.brake_build_up_s": 1.05,
    # Full traction of the lightest train in a runaway.
    "atp.runaway_mps2": 1.0,
    "odometry.scale_error_high_ratio": 0.05,
    "odometry.zero_speed_s": 2.0,
    # docs/reference/serial_interface.md: the distance from a tag at which its reader may read it
    # again.
    "odometry.tag_reach_m": 0.5,
    "odometry.cold_movement_m": 2.0,
}


@pytest.mark.parametrize(("name", "most"), AT_MOST.items())
def test_no_limit_is_wider_than_its_source_allows(name: str, most: float) -> None:
    assert attrgetter(name)(load_config("florence4")) <= most * (1.0 + 1e-12 * (most > 0))


@pytest.mark.parametrize(("name", "least"), AT_LEAST.items())
def test_no_allowance_is_smaller_than_its_source_demands(name: str, least: float) -> None:
    assert attrgetter(name)(load_config("florence4")) >= least


def test_random_runs_repeat_tag_readings_up_to_the_assumed_reach() -> None:
    campaign = tomllib.loads((CAMPAIGNS / "protection.toml").read_text(encoding="utf-8"))
    drawn = [
        fault["gap_m"]
        for scenario in campaign["scenario"]
        for fault in scenario["sweep"]["fault"]
        if fault["kind"] == "tag_duplicate"
    ]

    reach_m = load_config("florence4").odometry.tag_reach_m
    assert drawn == [{"low": 0.0, "high": reach_m}] * len(campaign["scenario"])


@pytest.mark.parametrize(
    ("frame", "bits", "raw"),
    [
        (Doppler(1.0, 100.0, True), 16, 200),
        (Imu(0.5, True), 14, 500),
        (ColdMovement(1.0, True), 14, 100),
        (Tacho(1000, 0, Direction.FORWARD, True, True, 0.0), 16, 1000),
    ],
    ids=lambda value: type(value).__name__,
)
def test_the_motion_signals_have_the_resolution_of_the_sensors(
    frame: Any, bits: int, raw: int
) -> None:
    """The hand calculation assumes 5 mm/s, 1 mm/s², 1 cm and one pulse per bit."""
    kind: type[Frame] = type(frame)
    assert packer(kind)(frame) % (1 << bits) == raw
