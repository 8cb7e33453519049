"""One odometer alone: each cycle gets inputs chosen by the test, with numbers that suit hand
calculation."""

import math
from dataclasses import replace
from typing import Any

import pytest

from can_dbc.brake import BrakeStatus
from can_dbc.nodes import Direction
from can_dbc.odometer import ColdMovement, Doppler, Imu, Tacho
from firmware_py.trackdb import GradientSection, LineMap, SpeedSection, Station, TagSite
from hil_tests.unit.vobc.atp.heard_rig import SILENCE
from vobc.config import load_config
from vobc.odometry import Odometry
from vobc.vocabulary import (
    NEVER_S,
    Motion,
    OdometryRecord,
    PlaceProof,
    TachoSample,
    TagReading,
)

BASE = load_config("florence4")
PULSE_M = 0.01
CONFIG = replace(
    BASE.odometry,
    scale_error_low_ratio=0.0,
    scale_error_high_ratio=0.0,
    tag_bound_m=0.06,
    tag_stamp_s=0.006,
    tag_reach_m=0.5,
    tag_silence_s=0.5,
    localisation_limit_m=300.0,
    window_s=0.2,
    stamp_jitter_s=0.001,
    learn_s=0.0,
    max_accel_mps2=1.5,
    max_speed_mps=40.0,
    standing_s=0.5,
    silence_s=0.15,
    zero_speed_mps=0.25,
    zero_speed_s=2.0,
    doppler_error_mps=0.1,
    doppler_error_ratio=0.0,
    doppler_mean_mps=0.02,
    doppler_mean_ratio=0.0,
    doppler_blind_mps=5.0,
    doppler_age_s=0.15,
    imu_age_s=0.15,
    imu_error_mps2=0.25,
    unseen_slip_ratio=0.4,
    gentle_mps2=0.45,
    gentle_slip_ratio=0.08,
    ground_slack_m=0.03,
    slip_hold_s=1.0,
)
TRAIN = replace(
    BASE.train, wheel_diameter_m=2.56 / math.pi, pulses_per_turn=256, antenna_offset_m=2.0
)
TAGS = (TagSite(7, 60.0), TagSite(8, 90.0))


class Desk:
    """An odometer with its inputs. Clocks begin at 0; samples are 20 ms apart; the last one of a
    cycle is fresh."""

    def __init__(
        self,
        front_m: float = 10.0,
        *,
        proof: PlaceProof = PlaceProof.SET_UP,
        tags: tuple[TagSite, ...] = TAGS,
        climbs: tuple[GradientSection, ...] = (),
        start_s: float = 0.0,
        **changes: Any,
    ) -> None:
        line = LineMap(
            "desk", -100.0, 900.0, (Station("A", 0.0, -80.0, 5.0),),
            (SpeedSection(-100.0, 900.0, 20.0),), gradients=climbs, tags=tags,
        )  # fmt: skip
        record = OdometryRecord(front_m, 0.5, PULSE_M, proof)
        self.odometry = Odometry(replace(CONFIG, **changes), TRAIN, line, record)
        self.now_ns = round(start_s * 1e9)
        self.pulses_a = self.pulses_b = 0

    @property
    def now_s(self) -> float:
        """Time of the last cycle as odometry computes it, s."""
        return self.now_ns * 1e-9

    @property
    def where(self) -> Any:
        return self.odometry._where

    @property
    def ground(self) -> Any:
        return self.odometry._ground

    @property
    def track(self) -> Any:
        return self.odometry._track

    def hear(
        self,
        *steps: int,
        steps_b: tuple[int, ...] | None = None,
        dt_s: float = 0.04,
        cycle_s: float = 0.05,
        age_s: float = 0.0,
        apart_s: float = 0.02,
        ages_s: tuple[float, ...] = (),
        way: Direction | None = None,
        healthy: tuple[bool, bool] = (True, True),
        tacho_age_s: float | None = None,
        radar_mps: float | None = None,
        radar_age_s: float = 0.0,
        felt_mps2: float | None = None,
        imu_age_s: float = 0.0,
        imu_healthy: bool = True,
        tags: tuple[TagReading, ...] = (),
        tag_gap: bool = False,
        cold: ColdMovement | None = None,
        brake: BrakeStatus | None = None,
        brake_age_s: float = 0.0,
    ) -> Motion | None:
        """Run a cycle `dt_s` after the last one.

        Args: steps: pulses in each sample of tacho A, and of B unless `steps_b` says otherwise.
        age_s: age of the last sample. ages_s: ages of all samples, instead of `age_s`.
        """
        self.now_ns += round(dt_s * 1e9)
        samples = []
        for index, (step_a, step_b) in enumerate(zip(steps, steps_b or steps, strict=True)):
            self.pulses_a += step_a
            self.pulses_b += step_b
            ahead = way or (Direction.REVERSE if step_a < 0 else Direction.FORWARD)
            frame = Tacho(self.pulses_a % 65536, self.pulses_b % 1024, ahead, *healthy, 0.0)
            ago_s = ages_s[index] if ages_s else age_s + apart_s * (len(steps) - 1 - index)
            samples.append(TachoSample(frame, ago_s))
        if tacho_age_s is None:
            tacho_age_s = age_s
        return self.odometry.step(
            replace(
                SILENCE,
                now_ns=self.now_ns,
                dt_s=cycle_s,
                tacho=samples[-1].frame if samples else None,
                tacho_age_s=tacho_age_s,
                tacho_samples=tuple(samples),
                doppler=None if radar_mps is None else Doppler(radar_mps, 99.0, True),
                doppler_age_s=radar_age_s,
                imu=None if felt_mps2 is None else Imu(felt_mps2, imu_healthy),
                imu_age_s=imu_age_s,
                tags=tags,
                tag_gap=tag_gap,
                cold=cold,
                brake=brake,
                brake_age_s=NEVER_S if brake is None else brake_age_s,
                cold_age_s=NEVER_S if cold is None else 0.0,
            )
        )

    def cycle(self, *steps: int, **heard: Any) -> Motion:
        """Run a cycle and require that the odometer returns a motion."""
        motion = self.hear(*steps, **heard)
        assert motion is not None
        return motion

    def cycles(self, count: int, *steps: int, **heard: Any) -> Motion:
        for _ in range(count):
            motion = self.cycle(*steps, **heard)
        return motion

    def wheels(self) -> tuple[float, float, float]:
        """Lowest, likeliest and highest speed by the wheels at the last cycle."""
        told = self.odometry._wheel_speed(self.now_s)
        return told.low, told.best, told.high

    def over_ground(self, low_mps: float, high_mps: float) -> None:
        """Set the bounds of the speed over ground."""
        self.ground.low_mps, self.ground.high_mps = low_mps, high_mps

    def moved(self, *steps: int, **heard: Any) -> tuple[float, float]:
        """Least and greatest distance over ground in one more cycle."""
        where = self.where
        low_m, high_m = where.ground_low_m, where.ground_high_m
        self.cycle(*steps, **heard)
        return where.ground_low_m - low_m, where.ground_high_m - high_m


def near(*values: float) -> Any:
    """Approximate equality of several values, within rounding."""
    return pytest.approx(values, abs=1e-9)
