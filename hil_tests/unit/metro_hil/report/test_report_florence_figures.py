"""Figures of the Florence campaign from handmade logs."""

from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest

from metro_hil.model.case import Case
from metro_hil.report.layouts.florence_figures import florence_figures, wanted_cases

CYCLES = (
    "t_s,front_m,permitted_mps,target_mps,demand_mps2,phase\n",
    "{t},{x},19.4,{v},0.5,running\n",
)
TRUTH = "t_s,front_m,speed_mps,car_speeds_mps,emergency\n", "{t},{x},{v},{v} {v},0\n"
PNG = b"\x89PNG"


@pytest.fixture
def cases(case_of: Callable[..., Case]) -> list[Case]:
    """Two laws, each with the ideal run, the signalling scenario and a case of table 8."""
    made: list[Case] = []
    for law in ("predictive", "pid"):
        for name in ("table-7", "table-8", "signalling"):
            case = case_of(len(made), f"{name}-{law}", error=0.0, load=1.0, seed=1)
            setup = msgspec.structs.replace(case.setup, believed={"ato.strategy": law})
            made.append(msgspec.structs.replace(case, setup=setup))
    return made


def keep(folder: Path, case: Case) -> None:
    """The train accelerates for 20 s, cruises, and brakes for 20 s."""
    run = folder.joinpath("cases", *case.id.split("/"))
    run.mkdir(parents=True)
    times_s = np.arange(0.0, 80.0, 0.05)
    speeds_mps = np.clip(np.minimum(0.5 * times_s, 0.5 * (80.0 - times_s)), 0.0, 10.0)
    fronts_m = np.cumsum(speeds_mps) * 0.05
    rows = list(zip(times_s, fronts_m, speeds_mps, strict=True))
    for name, (head, row) in {"cycles.csv": CYCLES, "truth.csv": TRUTH}.items():
        lines = [row.format(t=f"{t:.2f}", x=f"{x:.3f}", v=f"{v:.3f}") for t, x, v in rows]
        (run / name).write_text("".join([head, *lines]), encoding="utf-8")


def test_the_logs_of_ideal_and_signalled_runs_of_every_law_are_requested(cases: list[Case]) -> None:
    wanted = wanted_cases(cases)

    assert {name.partition("/")[0] for name in wanted} == {
        *("table-7-predictive", "signalling-predictive", "table-7-pid", "signalling-pid"),
    }
    assert len(wanted) == 4


def test_three_figures_of_each_law_are_drawn_from_its_logs(
    tmp_path: Path, cases: list[Case]
) -> None:
    for case in cases:
        keep(tmp_path, case)

    figures = florence_figures(tmp_path, cases)

    assert [figure.path.name for figure in figures] == [
        f"figure-{number}-{law}.png" for law in ("predictive", "pid") for number in (5, 6, 7)
    ]
    assert all(figure.path.read_bytes().startswith(PNG) for figure in figures)
    assert figures[0].caption.startswith("As figure 5 of the paper. predictive: ")
    first = figures[1].path.read_bytes()
    assert florence_figures(tmp_path, cases)[1].path.read_bytes() == first


def test_a_case_without_logs_is_left_out(tmp_path: Path, cases: list[Case]) -> None:
    keep(tmp_path, cases[0])

    (figure,) = florence_figures(tmp_path, cases)

    assert figure.path.name == "figure-5-predictive.png"
    assert florence_figures(tmp_path / "elsewhere", cases) == []
