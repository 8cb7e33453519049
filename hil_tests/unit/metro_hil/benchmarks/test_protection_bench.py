"""The benchmark of protection: its figures are correct. The tests do not judge the cost of a
cycle."""

from pathlib import Path

import pytest

from can_dbc.brake import BrakeCommand
from can_dbc.codec import Encoder
from firmware_py.storage.recorder import CandumpWriter
from metro_hil.benchmarks import protection
from metro_hil.benchmarks.curve_crossings import Crossing, crossing_of
from metro_hil.metrics import worst_motion
from metro_hil.metrics.worst_motion import (
    CONFIG,
    LINE_END_M,
    WorstCase,
    limits,
    line_of,
    sections,
    worst_stop_m,
)
from metro_hil.model.run_folder import RunFolder


def test_the_permitted_speed_is_not_needlessly_low() -> None:
    (figure,) = protection.laziness()

    assert figure.met
    assert figure.value.startswith("0.0"), figure.value


def test_distances_meet_their_limit_and_a_wrong_brake_rate_does_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(protection, "LINES", 30)
    (right,) = protection.error_of_distances()

    monkeypatch.setattr(
        protection, "worst_stop_m", lambda *args, **more: 1.02 * worst_stop_m(*args, **more)
    )
    (wrong,) = protection.error_of_distances()

    assert right.met
    assert "never shorter" in right.value
    assert not wrong.met


def test_a_distance_a_millionth_too_short_misses_the_limit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(protection, "LINES", 30)
    monkeypatch.setattr(
        protection,
        "worst_stop_m",
        lambda *args, **more: 1.000001 * worst_stop_m(*args, **more),
    )
    (short,) = protection.error_of_distances()

    assert not short.met
    assert "never" not in short.value


@pytest.mark.parametrize("speed_mps", [0.5, 7.3, 24.0])
def test_the_step_length_does_not_affect_the_integration(
    monkeypatch: pytest.MonkeyPatch, speed_mps: float
) -> None:
    """Half the step length gives the same distance on a line whose gradient changes every 30 m."""
    line = line_of(sections((3.0, 30.0, (-35.0, 20.0, -10.0)[at % 3]) for at in range(60)))
    whole_m = worst_stop_m(line, WorstCase.of(CONFIG), 301.7, speed_mps, reach_m=68.59)

    monkeypatch.setattr(worst_motion, "STEP_S", 0.5 * worst_motion.STEP_S)
    half_m = worst_stop_m(line, WorstCase.of(CONFIG), 301.7, speed_mps, reach_m=68.59)

    assert half_m == pytest.approx(whole_m, rel=protection.ROUNDING_RATIO)


def test_random_sections_stay_on_the_line() -> None:
    """Sections beyond the line are left out, and limits cover the line without a gap."""
    pieces = [(10.0, 3000.0, -5.0), (0.0, 2990.0, 7.0), (0.0, 1.0, 9.0)]

    assert sections(pieces) == ((10.0, 3010.0, -5.0), (3010.0, LINE_END_M, 7.0))
    assert limits(20.0, [(500.0, 10.0), (300.0, 15.0), (LINE_END_M, 1.0)]) == (
        (0.0, 300.0, 20.0),
        (300.0, 500.0, 15.0),
        (500.0, LINE_END_M, 10.0),
    )


CYCLES = """\
t_s,speed_high_mps,emergency_mps
0.95,,
1.0,19.9,20.0
1.05,20.0,20.0
1.1,20.4,20.1
"""
TRUTH = """\
t_s,speed_mps
0.9,25.0
1.05,19.2
1.15,20.1
"""


def write_logs(folder: RunFolder, braked_from_s: float) -> None:
    """Logs of a train whose speed may have reached its limit in the cycle at 1.05 s."""
    folder.cycle_log.write_text(CYCLES, encoding="utf-8")
    (folder.path / "truth.csv").write_text(TRUTH, encoding="utf-8")
    bus, encoder = CandumpWriter(folder.bus_log, "vcan0"), Encoder()
    for cycle in range(20, 24):
        at_ns = cycle * 50_000_000 + 1_000_000
        released = at_ns / 1e9 < braked_from_s
        for identifier, data in encoder.encode(BrakeCommand(0.0, released, True)):
            bus.frame(at_ns, identifier, data)
            at_ns += 500_000
    bus.close()


@pytest.mark.parametrize(
    ("braked_from_s", "commanded_s"), [(1.0, 1.0515), (1.06, 1.1015), (9.0, float("inf"))]
)
def test_the_command_delay_counts_from_the_cycle_that_reached_the_curve(
    tmp_path: Path, braked_from_s: float, commanded_s: float
) -> None:
    write_logs(RunFolder(tmp_path), braked_from_s)

    assert list(crossing_of("a", RunFolder(tmp_path))) == [Crossing("a", 1.05, commanded_s, 1.15)]


def test_a_command_in_the_next_cycle_misses_its_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    found = [Crossing("a", 1.05, 1.0515, 1.15), Crossing("b", 1.05, 1.1015, 1.1)]
    monkeypatch.setattr(protection, "crossings", lambda: iter(found))
    (late,) = protection.delay_of_the_command()
    found.pop()
    (prompt,) = protection.delay_of_the_command()

    assert not late.met
    assert prompt.met
    assert prompt.value == (
        "1.50 ms at most, of 1 runs; in 1 before the true speed reached that limit"
    )
