"""The plot of a case: for any existing log, and with the restrictions of the case."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest

from firmware_py.settings import SettingsError
from firmware_py.trackdb import load_line
from metro_hil.model.log_columns import Columns
from metro_hil.report.case_plot import RestrictionSpan, draw_case, stretches_of
from plant_emulator.process import TRUTH_COLUMNS
from vobc.process import CYCLE_COLUMNS

LINE = load_line("florence")
PNG = b"\x89PNG\r\n\x1a\n"
LIMIT_MPS = 8.25

RUN: Sequence[Mapping[str, object]] = tuple(
    {
        "t_s": float(second),
        "front_m": 3000.0 + 10.0 * second,
        "front_low_m": 2999.0 + 10.0 * second,
        "front_high_m": 3001.0 + 10.0 * second,
        "speed_mps": 10.0 if second < 4 else 0.0,
        "emergency_mps": 21.0,
        "service_mps": 20.5,
        "warning_mps": 20.0,
        "permitted_mps": 19.0,
        "distance_to_authority_m": 100.0,
        "emergency": False,
        "mode": "authorised",
        "supervision": "nominal",
        "phase": "running",
        "door_left": "locked",
        "door_right": "locked",
    }
    for second in range(6)
)


def log(columns: Sequence[str], rows: Sequence[Mapping[str, object]]) -> Columns:
    """Missing values of a row are empty, as where the controller knows no value."""
    table = [[row.get(name, "") for name in columns] for row in rows]
    return Columns.of_rows("log", columns, table)


def drawn(
    tmp_path: Path,
    cycles: Sequence[Mapping[str, object]] = RUN,
    truth: Sequence[Mapping[str, object]] = RUN,
    restrictions: Sequence[RestrictionSpan] = (),
) -> bytes | None:
    """The PNG, or None when there is nothing to plot."""
    path = tmp_path / "case.png"
    logs = log(CYCLE_COLUMNS, cycles), log(TRUTH_COLUMNS, truth)
    return path.read_bytes() if draw_case(path, "a case", LINE, *logs, restrictions) else None


def test_a_run_becomes_a_picture(tmp_path: Path) -> None:
    picture = drawn(tmp_path)

    assert picture is not None
    assert picture.startswith(PNG)


def test_without_rows_nothing_is_drawn(tmp_path: Path) -> None:
    assert drawn(tmp_path, cycles=()) is None
    assert drawn(tmp_path, truth=()) is None
    assert drawn(tmp_path, truth=RUN[:1]) is None
    assert not (tmp_path / "case.png").exists()


def test_a_controller_that_never_had_a_position_is_plotted_too(tmp_path: Path) -> None:
    unknown = [{"t_s": row["t_s"], "mode": "standby", "phase": "off"} for row in RUN]

    assert drawn(tmp_path, cycles=unknown) is not None


def test_a_train_that_never_moved_and_one_that_reversed_are_drawn(tmp_path: Path) -> None:
    still = [{**row, "front_m": 3000.0, "speed_mps": 0.0} for row in RUN]
    back = [{**row, "speed_mps": -0.5} for row in RUN]

    assert drawn(tmp_path, still, still) is not None
    assert drawn(tmp_path, back, back) is not None


def test_a_restriction_is_in_the_picture(tmp_path: Path) -> None:
    plain = drawn(tmp_path)

    assert drawn(tmp_path, restrictions=[RestrictionSpan(3010.0, 3030.0, LIMIT_MPS)]) != plain


def test_restrictions_are_those_among_the_faults_of_a_case() -> None:
    faults: list[dict[str, object]] = [
        {"kind": "ats_hold", "start_s": 1.0},
        {"kind": "temporary_restriction", "start_m": 3300, "end_m": 3400, "limit_mps": LIMIT_MPS},
        {"kind": "temporary_restriction"},
    ]

    given, by_default = stretches_of(faults)

    assert given == RestrictionSpan(3300.0, 3400.0, LIMIT_MPS)
    assert (by_default.start_m, by_default.end_m) == (3200.0, 3300.0)
    assert by_default.limit_mps == pytest.approx(30.0 / 3.6)
    assert stretches_of(()) == ()


def test_an_invalid_fault_is_refused() -> None:
    with pytest.raises(SettingsError):
        stretches_of([{"kind": "no such fault"}])
