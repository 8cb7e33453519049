"""Campaigns generated from a seed for the tests of the report."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from metro_hil.model.case import (
    Case,
    CaseEvent,
    CaseResult,
    Host,
    MonitorResult,
    Setup,
    Verdict,
)
from metro_hil.report.campaign import CampaignInfo

ERRORS = (-0.01, 0.0, 0.01, 0.02, 0.03, 0.04, 0.05)
LOADS = (0.0, 0.5, 1.0)
STATIONS = ("I", "II", "III", "IV")
LIMIT_M = 0.10


@dataclass(frozen=True, slots=True)
class MadeUp:
    """A campaign in the form that `write_reports` expects."""

    info: CampaignInfo
    cases: list[Case]
    results: list[CaseResult]


def info_of(cases: list[Case], layout: str | None = None) -> CampaignInfo:
    return CampaignInfo(
        name="made-up",
        title="Stops on a made-up line",
        description="Every stop must be within 10 cm, whatever the odometer says.",
        bench="lockstep",
        controller="shipped controller",
        fingerprint="3f9a1c0d77e21b64",
        versions={"metro-vobc-bench": "0.1.0", "python": "3.11.2"},
        expected_cases=len(cases),
        layout=layout,
    )


def stop_case(index: int, scenario: str, *, error: float, load: float, seed: int) -> Case:
    return Case(
        id=f"{scenario}/{index:04d}",
        index=index,
        scenario=scenario,
        seed=seed,
        setup=Setup(load_ratio=load, odometer_error=error),
        factors={"train.odometer_error": error, "train.load_ratio": load},
        requirements=("ACC-02",),
    )


def stop_result(case: Case, errors_m: tuple[float, ...], worker: str = "a") -> CaseResult:
    """A result that passes when all stops are within the limit; a second monitor judges the
    speed."""
    worst_m = max(abs(error_m) for error_m in errors_m)
    margin_m = LIMIT_M - worst_m
    verdict = Verdict.PASS if margin_m >= 0.0 else Verdict.FAIL
    speed_margin_mps = 0.4 + 3.0 * abs(margin_m)
    return CaseResult(
        case_id=case.id,
        index=case.index,
        verdict=verdict,
        reason="" if verdict is Verdict.PASS else "stops within 10 cm: too far",
        exit_reason="arrived",
        sim_s=400.0 + case.index % 7,
        frames=280_000 + case.index,
        chain=f"{case.index:016x}",
        monitors=(
            MonitorResult(
                name="stops within 10 cm",
                verdict=verdict,
                margin=margin_m,
                unit="m",
                at_s=120.0 + case.index % 90,
                requirements=("ACC-02",),
            ),
            MonitorResult(
                name="below civil limit plus emergency margin",
                verdict=Verdict.PASS,
                margin=speed_margin_mps,
                unit="m/s",
                at_s=61.5,
                requirements=("INV-04",),
            ),
            MonitorResult(
                name="no rollback",
                verdict=Verdict.VACUOUS,
                margin=None,
                unit="m",
                detail="its premise never held",
                asked=False,
                requirements=("INV-08",),
            ),
        ),
        measures={
            **{
                f"stop_{station}_error_m": error_m
                for station, error_m in zip(STATIONS, errors_m, strict=True)
            },
            "stop_error_worst_m": worst_m,
            "run_time_s": 400.0 + 2.0 * case.setup.load_ratio if case.setup.load_ratio else 400.0,
        },
        events=(CaseEvent(0.15, "authority given"), CaseEvent(61.5, "warning: near the limit")),
        host=Host(wall_s=1.5 + case.index, worker=worker),
    )


def made_up(count: int, seed: int = 7, scenario_count: int = 3) -> MadeUp:
    """A campaign in which about one case in forty fails, more often with a large odometer error."""
    generator = np.random.default_rng(seed)
    cases, results = [], []
    for index in range(count):
        case = stop_case(
            index,
            ("table-8", "table-9", "night")[index * scenario_count // count],
            error=ERRORS[index % len(ERRORS)],
            load=LOADS[index // len(ERRORS) % len(LOADS)],
            seed=1 + index // 21,
        )
        spread_m = 0.025 + 0.4 * abs(case.factors["train.odometer_error"])
        errors_m = tuple(generator.normal(0.005, spread_m, 4).tolist())
        cases.append(case)
        results.append(stop_result(case, errors_m))
    return MadeUp(info_of(cases), cases, results)


@pytest.fixture
def campaign() -> Callable[..., MadeUp]:
    return made_up


@pytest.fixture
def case_of() -> Callable[..., Case]:
    return stop_case


@pytest.fixture
def result_of() -> Callable[..., CaseResult]:
    return stop_result


@pytest.fixture
def about() -> Callable[..., CampaignInfo]:
    return info_of


@pytest.fixture
def keep_logs() -> Callable[[Path, Case], None]:
    """A function that writes the logs of one run below a campaign's folder: it runs to 400 m and
    stops."""

    def keep(folder: Path, case: Case) -> None:
        run = folder.joinpath("cases", *case.id.split("/"))
        run.mkdir(parents=True)
        time_s = np.arange(0.0, 260.0, 0.5)
        speed_mps = np.clip(np.minimum(time_s * 0.8, (250.0 - time_s) * 0.8), 0.0, 16.0)
        front_m = np.cumsum(speed_mps) * 0.5
        rows = zip(time_s.tolist(), front_m.tolist(), speed_mps.tolist(), strict=True)
        lines = [f"{t:.3f},{x:.3f},{v:.3f}" for t, x, v in rows]
        (run / "truth.csv").write_text("\n".join(["t_s,front_m,speed_mps", *lines]) + "\n")
        places = zip(time_s.tolist(), front_m.tolist(), strict=True)
        lines = [f"{t:.3f},{x:.3f},19.4,20.8" for t, x in places]
        head = "t_s,front_m,permitted_mps,emergency_mps"
        (run / "cycles.csv").write_text("\n".join([head, *lines]) + "\n")
        stamps = [f"({number * 0.05:017.6f}) vcan0 101#00" for number in range(5200)]
        (run / "bus.log").write_text("\n".join(stamps) + "\n")

    return keep
