"""When faults begin and end: by time, by conditions on the train, once or repeatedly."""

from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from can_dbc.vobc import (
    AtoPhase,
    Cause,
    Inhibit,
    Missing,
    OperatingMode,
    Supervision,
    VobcMode,
    VobcStatus,
    Withheld,
)
from firmware_py.settings import SettingsError
from plant_emulator.faults.fault_file import faults_of, load_faults
from plant_emulator.faults.plan import read_faults
from plant_emulator.faults.schedule import Schedule
from plant_emulator.truth import Truth

STEP_NS = 10_000_000


def windows(
    steps: int, table: dict[str, Any], **signals: Callable[[float], float]
) -> list[tuple[int, int | None]]:
    """Steps of 10 ms at which the fault began and ended."""
    schedule = Schedule(read_faults([{"kind": "passenger_alarm", **table}], "scenario"))
    found: list[tuple[int, int | None]] = []

    def listener(plan: object, active: bool, now_ns: int) -> None:
        step = now_ns // STEP_NS
        if active:
            found.append((step, None))
        else:
            found[-1] = (found[-1][0], step)

    schedule.listen(listener)
    truth = Truth()
    for step in range(steps):
        truth.t_s = step * STEP_NS / 1e9
        for name, value_of in signals.items():
            setattr(truth, name, value_of(truth.t_s))
        schedule.step(truth, step * STEP_NS)
    assert bool(schedule.never_began) is not bool(found)
    return found


def ramp(t_s: float) -> float:
    """A speed that rises to 10 m/s at 10 s and falls to zero at 20 s, repeatedly."""
    return 10.0 - abs(t_s % 20.0 - 10.0)


@pytest.mark.parametrize(
    ("table", "expected"),
    [
        ({}, [(0, None)]),
        ({"start_s": 1.0}, [(100, None)]),
        ({"start_s": 0.995}, [(100, None)]),
        ({"end_s": 2.0}, [(0, 200)]),
        ({"start_s": 1.0, "end_s": 2.0}, [(100, 200)]),
        ({"start_s": 1.0, "duration_s": 0.5}, [(100, 150)]),
        ({"start_s": 1.0, "duration_s": 5.0, "end_s": 2.0}, [(100, 200)]),
        ({"start_s": 1.0, "end_s": 2.0, "repeat": True}, [(100, 200)]),
        ({"start_s": 99.0}, []),
        ({"when": "speed_mps > 5"}, [(501, None)]),
        ({"when": "speed_mps > 5", "until": "speed_mps < 4"}, [(501, 1601)]),
        ({"when": "speed_mps > 5", "duration_s": 1.0}, [(501, 601)]),
        ({"start_s": 8.0, "when": "speed_mps > 5"}, [(800, None)]),
        ({"when": "speed_mps > 5", "end_s": 4.0}, []),
        ({"when": "speed_mps > 50"}, []),
        ({"until": "speed_mps > 3"}, [(0, 301)]),
        (
            {"when": "speed_mps > 5", "until": "speed_mps < 4", "repeat": True},
            [(501, 1601), (2501, 3601)],
        ),
        (
            {"when": "speed_mps > 9", "duration_s": 0.5, "repeat": True, "end_s": 9.8},
            [(901, 951), (952, 980)],
        ),
        ({"when": "1 / (speed_mps - speed_mps) > 0"}, []),
        ({"when": "supervision == 'emergency' or mode == 'creep'"}, []),
        ({"when": "ato_phase == 'off'", "duration_s": 1.0}, [(0, 100)]),
        ({"until": "1 / (speed_mps - speed_mps) > 0", "end_s": 1.0}, [(0, 100)]),
    ],
)
def test_a_fault_acts_in_its_window(table: dict[str, Any], expected: list[object]) -> None:
    assert windows(4000, table, speed_mps=ramp) == expected


@given(
    start_s=st.floats(0.0, 3.0),
    duration_s=st.none() | st.floats(0.02, 3.0),
    length_s=st.none() | st.floats(0.02, 3.0),
)
def test_a_window_in_time_covers_the_steps_within_it(
    start_s: float, duration_s: float | None, length_s: float | None
) -> None:
    table: dict[str, Any] = {"start_s": start_s}
    if length_s is not None:
        table["end_s"] = start_s + length_s
    if duration_s is not None:
        table["duration_s"] = duration_s

    found = windows(1000, table)

    begin, end = found[0]
    assert len(found) == 1
    assert begin * 0.01 >= start_s > (begin - 1) * 0.01
    ends_s = [
        at_s for at_s in (table.get("end_s"), duration_s and begin * 0.01 + duration_s) if at_s
    ]
    if not ends_s:
        assert end is None
    else:
        assert end is not None
        assert end * 0.01 >= min(ends_s) - 1e-9
        assert (end - 1) * 0.01 < min(ends_s) + 1e-9


def test_listeners_receive_changes_in_the_order_of_the_scenario() -> None:
    kinds = ["frame_drop", "controller_killed", "wheel_slip", "radio_loss"]
    schedule = Schedule(read_faults([{"kind": kind, "end_s": 0.5} for kind in kinds], "scenario"))
    heard: list[tuple[str, bool]] = []
    schedule.listen(lambda plan, active, now_ns: heard.append((plan.kind.name, active)))
    truth = Truth()
    for truth.t_s in (0.0, 0.3, 0.6):
        schedule.step(truth, 0)
    assert heard == [*((kind, True) for kind in kinds), *((kind, False) for kind in kinds)]


SCENARIO = """
name = "leaves"
[train]
end = "I"
[[monitor]]
stl = "speed_mps > 1"
[[fault]]
kind = "low_adhesion"
adhesion_ratio = 0.05
when = "speed_mps > 5"
[[fault]]
kind = "desk_mode"
mode = "manual"
"""


def test_a_scenario_file_gives_its_faults(tmp_path: Any) -> None:
    path = tmp_path / "leaves.toml"
    path.write_text(SCENARIO, encoding="utf-8")
    plans = load_faults(str(path))
    assert [(plan.index, plan.kind.name) for plan in plans] == [
        (0, "low_adhesion"),
        (1, "desk_mode"),
    ]
    assert plans[0].parameters.adhesion_ratio == 0.05


def test_a_file_without_faults_gives_none() -> None:
    assert faults_of({"name": "healthy"}, "healthy.toml") == ()


@pytest.mark.parametrize(
    ("scenario", "words"),
    [
        ({"faults": []}, r"x.toml: faults: unknown key; nearest valid key: fault$"),
        ({"fault": {"kind": "wheel_slip"}}, r"x.toml: fault: .* is not a list of \[\[fault\]\]"),
        ({"fault": [3]}, r"x.toml: fault: \[3\] is not a list"),
        ({"fault": [{"kind": "wheel_slid"}]}, r"fault\[0\].kind: 'wheel_slid'.*: wheel_slide"),
        ({"fault": [{"kind": "wheel_slip", "slip": 1}]}, r"fault\[0\].slip: unknown.*slip_ratio"),
        ({"fault": [{"kind": "wheel_slip", "axle": "c"}]}, r"fault\[0\].axle: 'c'"),
        (
            {"fault": [{"kind": "brake_late"}, {"kind": "brake_late", "delay_s": -1}]},
            r"x.toml: fault\[1\]: delay_s -1 is not within 0..30",
        ),
        ({"fault": [{"kind": "brake_late", "when": "speed > 1"}]}, r"fault\[0\]: when .*speed_mps"),
        (
            {"fault": [{"kind": "brake_late", "start_s": 2.0, "end_s": 1.0}]},
            r"fault\[0\]: end_s 1 is not after start_s 2",
        ),
        ({"fault": [{"kind": "tag_missed", "seed": -1}]}, r"fault\[0\].seed: -1 is not a whole"),
    ],
)
def test_an_impossible_scenario_is_refused_with_file_key_and_value(
    scenario: dict[str, Any], words: str
) -> None:
    with pytest.raises(SettingsError, match=words):
        faults_of(scenario, "x.toml")


def test_a_condition_reads_what_the_controller_reports() -> None:
    truth = Truth()
    (plan,) = read_faults(
        [{"kind": "obstacle", "when": "supervision == 'emergency'", "until": "mode == 'standby'"}],
        "scenario",
    )
    (other,) = read_faults([{"kind": "obstacle", "when": "speed_mps > 3"}], "scenario")
    begins, ends = plan.window.begins(), plan.window.ends()
    assert begins is not None
    assert ends is not None

    before = begins(truth)
    truth.report(VobcStatus(Supervision.EMERGENCY, AtoPhase.OFF, Missing(0), True, False, 0.0, 0))
    truth.report(
        VobcMode(OperatingMode.STANDBY, Cause.BUTTON, Inhibit(0), Withheld(0), 0, True, False)
    )

    assert (before, begins(truth), ends(truth)) == (0.0, 1.0, 1.0)
    assert plan.window.reads_controller
    assert not other.window.reads_controller
