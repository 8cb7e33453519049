"""No evidence is not a pass: no broken or empty scenario may pass."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import pytest

from firmware_py.settings import SettingsError
from metro_hil.campaign import plan_cases
from metro_hil.campaign.read import define
from metro_hil.model.case import Case, CaseResult, as_expected
from metro_hil.report.campaign.ledger import join
from metro_hil.report.campaign.trace import RequirementStanding, trace_requirements
from metro_hil.run.dispatch import run_case

Table = Mapping[str, Any]

SHORT: Final = {"start": "II", "end": "III", "duration_s": 9.0}
"""The train stands for 4.7 s and then accelerates; the service brake stays released from then
on."""
MINE: Final = "MY-01"
HOLDS: Final = {"name": "holds", "stl": "always(speed_mps <= 40)", "requirements": [MINE]}
FAILS: Final = {"name": "fails", "stl": "always(speed_mps <= 1)", "requirements": [MINE]}
"""The train is faster than this limit from 6 s on."""


def watching(*formulas: str) -> Table:
    """A scenario with only these formulas as monitors."""
    monitors = [{"stl": text, "requirements": [MINE]} for text in formulas]
    return {"invariants": "none", "monitor": monitors}


def measuring(**limits: Any) -> Table:
    return {"invariants": "none", "monitor": [{**limits, "requirements": [MINE]}]}


def suffering(kind: str, **fault: Any) -> Table:
    """A scenario whose monitor holds, under a fault without effect."""
    return {"invariants": "none", "monitor": [HOLDS], "fault": [{"kind": kind, **fault}]}


def expecting(expected: Any, *monitors: Table, **more: Any) -> Table:
    return {"invariants": "none", "expected": expected, "monitor": list(monitors), **more}


REFUSED: Final[dict[str, Table]] = {
    "a formula without a signal": watching("always(1 <= 2)"),
    "a comparison without a signal in a formula": watching("always(speed_mps <= 1 or 1 <= 2)"),
    "a signal that is compared with itself": watching("always(speed_mps <= speed_mps)"),
    "a signal that is multiplied by zero": watching("always(speed_mps * 0 <= 1)"),
    "a condition or its contrary": watching("always(standing or not standing)"),
    "a comparison or its contrary": watching("always(speed_mps <= 5 or speed_mps > 5)"),
    "a conclusion that is its premise": watching("always(emergency -> emergency)"),
    "a state that does not exist": watching("always(supervision <= 4)"),
    "a premise that cannot hold": watching("always(supervision > 4 -> standing)"),
    "a time before the start": watching("always(t_s < 0 -> standing)"),
    "a magnitude that is not negative": watching("always(abs(speed_mps) >= 0)"),
    "a count that is not negative": measuring(measure="emergency_count", min=0.0),
    "an arrival at most once": measuring(measure="arrived_count", max=1.0),
    "a failure without a monitor": expecting("fail", FAILS),
    "an expected absence of evidence": expecting("inconclusive", FAILS),
    "a failure of a monitor that is not there": expecting({"fails": "nobody"}, FAILS),
    "a failure with a margin that is none": expecting({"fails": "fails", "margin_max": 1}, FAILS),
    "an allowance without a reason": {**watching(), "vacuous": {"allowed": "case"}},
    "an allowance without a name": {**watching(), "vacuous": "allowed"},
    "an allowance for what is not there": {
        **watching(),
        "vacuous": {"allowed": "brakes", "reason": "none"},
    },
    "invariants that answer where none is watched": {
        "invariants": "none",
        "monitor": [{"invariant": "all", "requirements": [MINE]}],
    },
}
NEVER: Final = "front_m > 100000"
EMPTY: Final[dict[str, Table]] = {
    "a premise that never holds": watching(f"always({NEVER} -> speed_mps <= 1)"),
    "the same written with not and or": watching(f"always(not ({NEVER}) or speed_mps <= 1)"),
    "the same under a double negation": watching(f"not eventually(not ({NEVER} -> standing))"),
    "the same beside something that is judged": watching(
        f"always(speed_mps <= 40 and ({NEVER} -> standing))"
    ),
    "the same in a chain of premises": watching(f"always(speed_mps > 0 -> ({NEVER} -> standing))"),
    "the same in a window": watching(f"always(always[0:1]({NEVER} -> standing))"),
    "the same joined to a formula that holds": watching(
        f"always(speed_mps <= 40) and always({NEVER} -> standing)"
    ),
    "the same as a choice beside one that is violated": watching(
        f"always({NEVER} -> standing) or always(speed_mps <= 1)"
    ),
    "a premise too late to be judged": watching("always(t_s > 8 -> eventually[0:5](standing))"),
    "an implication under eventually": watching(f"eventually({NEVER} -> speed_mps > 90)"),
    "what is true in the first sample": watching("eventually(standing)"),
    "what is true from the first sample to its interval": watching("eventually[1:3](standing)"),
    "a wait for what is there already": watching("speed_mps <= 40 until standing"),
    "nothing watched": {"invariants": "none"},
    "an empty list of invariants": {"invariants": []},
    "an invariant by name that sees nothing": {"invariants": ["inv-08"], "requirements": [MINE]},
    "a requirement without a monitor": {"requirements": [MINE]},
    "a requirement whose invariant sees nothing": {"requirements": ["INV-08"]},
    "a fault that never begins": suffering("tacho_stuck", when=NEVER),
}
UNTOUCHED: Final[dict[str, Table]] = {
    "a loss of no frame": suffering("frame_drop", frames="BRAKE_CMD*", loss_ratio=0.0),
    "frames that are late by nothing": suffering("frame_delay", delay_s=0.0),
    "frames that are held back by nothing": suffering("frame_reorder", hold_s=0.0),
    "damage to no frame": suffering("frame_corrupt", share_ratio=0.0),
    "an echo of nothing": suffering("frame_replay", memory_s=1.0),
    "messages that are late by nothing": suffering("radio_delay", delay_s=0.0),
    "a loss of no message": suffering("radio_loss", loss_ratio=0.0),
    "damage to no telegram": suffering("telegram_corrupt", share_ratio=0.0),
    "noise of no byte": suffering("serial_noise", bytes_per_s=0.0),
    "a process that is slow by nothing": suffering("slow_cycle", extra_s=0.0),
    "a clock that jumps by nothing": suffering("clock_step", step_s=0.0),
    "a brake of full strength": suffering("brake_weak", gain_ratio=1.0),
    "a late brake while nothing brakes": suffering("brake_late", start_s=7.5, duration_s=0.5),
    "a brake that sticks where it should be": suffering("brake_stuck", start_s=7.5),
    "a late emergency brake without an emergency": suffering("emergency_late", start_s=6.0),
    "a runaway while the brakes are on": suffering("traction_runaway", duration_s=0.5),
    "a tag that is not on the way": suffering("tag_missed", tag_id=101),
    "a displaced tag that is not on the way": suffering("tag_displaced", tag_id=101),
    "a hidden dead antenna where no tag lies": suffering(
        "antenna_dead", hidden=True, duration_s=4.0
    ),
    "an obstacle in doors that stay shut": suffering("door_obstacle"),
    "deaf doors without a command": suffering("door_deaf"),
    "a desk mode that is set already": suffering("desk_mode", mode="auto"),
    "a lever where it is": suffering("desk_lever", lever_percent=0.0),
    "a signal behind the train": suffering("signal_stop", position_m=2500.0),
    "wheels as new": suffering("wheel_wear", diameter_ratio=1.0),
    "slip of a train that stands": suffering("wheel_slip", start_s=1.0, duration_s=1.0),
    "a voltage as it is": suffering("line_voltage", voltage_v=750.0),
    "no bias": suffering("imu_bias", bias_mps2=0.0),
}


def script(folder: Path, text: str) -> Table:
    path = folder / "controller.sh"
    path.write_text(text, encoding="utf-8")
    return {"kind": "command", "command": f"sh {path}"}


READY: Final = '{"type":"ready","version":1,"name":"dies","next_wakeup_ns":0}'
WRONG: Final[dict[str, Callable[[Path], Table]]] = {
    "a controller that dies": lambda folder: expecting(
        {"fails": "fails"}, FAILS, controller=script(folder, f"read l; echo '{READY}'; read l")
    ),
    "a controller that does not start": lambda folder: expecting(
        {"fails": "fails"}, FAILS, controller=script(folder, "exit 3")
    ),
    "another monitor": lambda _: expecting({"fails": "holds"}, FAILS, HOLDS),
    "another monitor too": lambda _: expecting(
        {"fails": "fails"}, FAILS, {"name": "more", "stl": "always(speed_mps <= 0.5)"}
    ),
    "another size of the failure": lambda _: expecting(
        {"fails": "fails", "margin_min": -0.01}, FAILS
    ),
    "no failure": lambda _: expecting({"fails": "holds"}, HOLDS),
    "a failure without its fault": lambda _: expecting(
        {"fails": "fails"}, FAILS, fault=[{"kind": "frame_drop", "loss_ratio": 0.0}]
    ),
    "a failure before its fault": lambda _: expecting(
        {"fails": "fails"}, FAILS, fault=[{"kind": "tacho_stuck", "when": NEVER}]
    ),
    "a failure beside a monitor that sees nothing": lambda _: expecting(
        {"fails": "fails"}, FAILS, {"name": "idle", "stl": f"always({NEVER} -> standing)"}
    ),
}


def made(table: Table) -> Case:
    (case,) = plan_cases(define({"train": SHORT, **table}, source="x.toml", name="x").campaign)
    return case


def standing_of(case: Case, result: CaseResult, name: str = MINE) -> RequirementStanding | None:
    traces = trace_requirements({}, join([case], [result], expected_cases=1))
    return next((trace.standing for trace in traces if trace.requirement.id == name), None)


def refuse_green(case: Case) -> CaseResult:
    result = run_case(case)
    assert not as_expected(case, result), "it is green"
    assert standing_of(case, result) is not RequirementStanding.MET
    return result


@pytest.mark.parametrize("table", REFUSED.values(), ids=REFUSED)
def test_a_scenario_that_no_run_can_decide_is_refused(table: Table) -> None:
    with pytest.raises(SettingsError, match=r"x\.toml: (monitor|expected|vacuous)"):
        made(table)


@pytest.mark.parametrize("table", EMPTY.values(), ids=EMPTY)
def test_a_scenario_that_judged_nothing_is_not_green(table: Table) -> None:
    assert refuse_green(made(table)).lacking


@pytest.mark.parametrize("table", UNTOUCHED.values(), ids=UNTOUCHED)
def test_a_fault_without_effect_is_not_green(table: Table) -> None:
    result = refuse_green(made(table))

    assert result.reason == f"fault {result.faults[0].kind} touched nothing"


@pytest.mark.parametrize("make", WRONG.values(), ids=WRONG)
def test_an_unexpected_failure_is_not_green(make: Callable[[Path], Table], tmp_path: Path) -> None:
    refuse_green(made(make(tmp_path)))


def test_an_expected_failure_is_green_and_its_requirement_counts_as_not_met() -> None:
    case = made(expecting({"fails": "fails", "margin_min": -5.0}, FAILS, HOLDS))

    result = run_case(case)

    assert as_expected(case, result)
    assert standing_of(case, result) is RequirementStanding.KNOWN


def test_an_allowed_vacuous_scenario_is_green_and_meets_no_requirement() -> None:
    allowed = {"allowed": "idle", "reason": "the hop is too short for it"}
    idle = {"name": "idle", "stl": f"always({NEVER} -> standing)", "requirements": ["MY-02"]}
    case = made({"invariants": "none", "monitor": [HOLDS, idle], "vacuous": allowed})

    result = run_case(case)

    assert as_expected(case, result)
    assert "the hop is too short for it" in result.reason
    assert standing_of(case, result) is RequirementStanding.MET
    assert standing_of(case, result, "MY-02") is RequirementStanding.OPEN
