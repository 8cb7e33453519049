"""All monitors of a run together: what ends the run, its results, and the signals from the bus."""

from typing import Any

import pytest

from can_dbc.binding import kinds
from can_dbc.brake import BrakeCommand
from can_dbc.cab import Desk
from can_dbc.codec import Encoder
from can_dbc.doors import DoorCommand
from can_dbc.nodes import Direction
from can_dbc.traction import TractionCommand
from can_dbc.vobc import AtoPhase, Missing, Supervision, VobcMotion, VobcPosition, VobcStatus
from metro_hil.model.case import Verdict
from metro_hil.monitors import MonitorSet, read_monitors
from metro_hil.monitors.description import DECODED, STAMPED, Spoken
from metro_hil.monitors.vocabulary import BOOLEANS, NAMES, SIGNALS, Origin
from plant_emulator import truth

Rig = Any
"""Rig of conftest.py."""


def stl(text: str, **more: Any) -> dict[str, Any]:
    return {"stl": text, "name": text, **more}


def test_the_first_violation_is_the_one_that_ends_the_run(rig_for: type[Rig]) -> None:
    rig = rig_for([stl("always(speed_mps <= 3)"), stl("always(speed_mps <= 2)")], "none")
    rig.step(10, speed_mps=1.0)
    assert rig.monitors.violated is None
    assert rig.monitors.violated_at_s is None

    rig.step(1, speed_mps=2.5)
    rig.step(1, speed_mps=3.5)

    violated = rig.monitors.violated
    assert violated is not None
    assert violated.name == "always(speed_mps <= 2)"
    assert rig.monitors.violated_at_s == pytest.approx(0.11)


def test_a_violation_that_may_go_on_fails_without_ending_the_run(rig_for: type[Rig]) -> None:
    rig = rig_for([stl("always(speed_mps <= 2)", severity="continue")], "none")
    rig.step(10, speed_mps=3.0)

    assert rig.monitors.violated is None
    assert rig.result("always(speed_mps <= 2)").verdict is Verdict.FAIL


def test_a_violated_invariant_that_is_not_requested_does_not_end_the_run(
    rig_for: type[Rig],
) -> None:
    rig = rig_for([{"invariant": 4}], "none")
    rig.step(10, speed_mps=5.0, authority_end_m=900.0)

    assert rig.monitors.violated is None
    assert rig.result("inv-04-civil-limit").verdict is Verdict.PASS


def test_the_reported_interval_is_a_second_around_the_violation(rig_for: type[Rig]) -> None:
    rig = rig_for([stl("always(speed_mps <= 2)")], [4])
    rig.step(200, speed_mps=1.0)
    rig.step(10, speed_mps=3.0)
    rig.step(10, speed_mps=4.0)

    (found,) = rig.monitors.violations()
    assert found.monitor == "always(speed_mps <= 2)"
    assert found.first_ns == 2_010_000_000
    assert (found.begin_ns, found.end_ns) == (1_010_000_000, 3_110_000_000)


def test_an_invariant_without_its_premise_is_vacuous(rig_for: type[Rig]) -> None:
    rig = rig_for([], "all")
    rig.step(10)

    result = rig.result("inv-08-rollback")
    assert result.verdict is Verdict.VACUOUS
    assert result.margin is None
    assert not result.asked


def test_an_invariant_requested_by_name_is_marked(rig_for: type[Rig]) -> None:
    rig = rig_for([], ["inv-08"])
    rig.step(10)

    result = rig.result("inv-08-rollback")
    assert (result.verdict, result.asked, result.own) == (Verdict.VACUOUS, True, True)


def test_all_invariants_requested_together_may_be_vacuous(rig_for: type[Rig]) -> None:
    rig = rig_for([{"invariant": "all", "requirements": ["ACC-26"]}], "all")
    rig.step(10)

    result = rig.result("inv-08-rollback")
    assert (result.asked, result.own) == (False, True)
    assert result.requirements == ("INV-08", "ACC-26")


def test_a_formula_whose_premise_never_held_is_vacuous(rig_for: type[Rig]) -> None:
    text = "always(emergency -> drive_n <= 0)"
    rig = rig_for([stl(text)], "none")
    rig.step(10)

    result = rig.result(text)
    assert (result.verdict, result.margin) == (Verdict.VACUOUS, None)
    assert result.detail == "its premise never held"


def test_an_undecided_formula_is_inconclusive(rig_for: type[Rig]) -> None:
    for text in ("always[0:5](speed_mps <= 1)", "always(drive_n / speed_mps <= 1)"):
        rig = rig_for([stl(text)], "none")
        rig.step(10)

        assert rig.result(text).verdict is Verdict.INCONCLUSIVE, text


@pytest.mark.parametrize(
    ("value", "verdict", "margin"),
    [
        (0.1, Verdict.PASS, 0.0),
        (0.11, Verdict.FAIL, -0.01),
        (-0.2, Verdict.FAIL, -0.1),
        (0.0, Verdict.PASS, 0.1),
        (None, Verdict.INCONCLUSIVE, None),
        (float("nan"), Verdict.INCONCLUSIVE, None),
    ],
)
def test_a_measure_is_judged_at_the_end(
    rig_for: type[Rig], value: float | None, verdict: Verdict, margin: float | None
) -> None:
    rig = rig_for([{"measure": "error_m", "min": -0.1, "max": 0.1, "name": "error"}], "none")
    rig.monitors.finish()

    (result,) = rig.monitors.results({"error_m": value})
    assert result.verdict is verdict
    assert result.margin == (None if margin is None else pytest.approx(margin))


def test_a_missing_measure_is_inconclusive(rig_for: type[Rig]) -> None:
    rig = rig_for([{"measure": "error_m", "max": 0.1}], "none")
    rig.monitors.finish()

    (result,) = rig.monitors.results({})
    assert result.verdict is Verdict.INCONCLUSIVE
    assert "error_m was not measured" in result.detail


# Signals from the bus.

EXAMPLES = (
    BrakeCommand(service_decel_mps2=0.5, emergency_released=True, holding_released=False),
    TractionCommand(force_n=1234.0, direction=Direction.REVERSE, traction_permitted=True),
    DoorCommand(enable_left=True, enable_right=False, open_left=False, open_right=True),
    VobcStatus(
        supervision=Supervision.SERVICE,
        ato_phase=AtoPhase.STOPPING,
        missing=Missing.DESK | Missing.DOORS,
        localised=True,
        slip_detected=True,
        work_us=400.0,
        cycle_slips=7,
    ),
    VobcMotion(speed_mps=-1.5, ceiling_mps=11.0, emergency_mps=13.0),
    VobcPosition(front_m=1234.5, uncertainty_m=0.75),
)
SAID = {
    "service_decel_mps2": 0.5,
    "emergency_commanded": 0.0,
    "holding_commanded": 1.0,
    "force_commanded_n": 1234.0,
    "direction": -1.0,
    "traction_permitted": 1.0,
    "enable_left": 1.0,
    "enable_right": 0.0,
    "open_left_commanded": 0.0,
    "open_right_commanded": 1.0,
    "supervision": 3.0,
    "ato_phase": 5.0,
    "missing": 24.0,
    "localised": 1.0,
    "slip_detected": 1.0,
    "work_us": 400.0,
    "cycle_slips": 7.0,
    "claimed_speed_mps": -1.5,
    "ceiling_mps": 11.0,
    "emergency_limit_mps": 13.0,
    "claimed_front_m": 1234.5,
    "uncertainty_m": 0.75,
}


def test_encoded_values_are_read_back() -> None:
    """The encoder belongs to the wire contract; the names are those of expressions."""
    spoken, encoder = Spoken(), Encoder()
    for frame in EXAMPLES:
        for can_id, data in encoder.encode(frame):
            assert can_id in spoken.wanted_ids
            spoken.frame(1000, can_id, data)

    assert {name: getattr(spoken, name) for name in SAID} == pytest.approx(SAID)
    assert spoken.brake_ns == spoken.position_ns == 1000


def test_a_frame_with_a_flipped_bit_does_not_count() -> None:
    encoder = Encoder()
    for frame in EXAMPLES:
        for bit in range(8):
            spoken = Spoken()
            for can_id, data in encoder.encode(frame):
                broken = bytes([data[0] ^ 1 << bit, *data[1:]])
                spoken.frame(1000, can_id, broken)
            assert not spoken.news, frame


def test_half_a_vital_pair_does_not_count() -> None:
    spoken = Spoken()
    (can_id, data), _ = Encoder().encode(EXAMPLES[0])
    spoken.frame(1000, can_id, data)

    assert spoken.emergency_commanded == 1.0


def test_before_the_first_frame_the_signals_are_the_most_restrictive() -> None:
    spoken = Spoken()

    assert spoken.emergency_commanded == spoken.holding_commanded == 1.0
    assert spoken.traction_permitted == spoken.enable_left == spoken.localised == 0.0


def test_other_frames_have_no_effect_and_are_not_subscribed(rig: Rig) -> None:
    wanted = {*DECODED, *STAMPED}
    others = [kind for kind in kinds() if kind not in wanted]

    assert Desk in wanted
    assert len(others) >= 20
    rig.monitors.frame(5, 0x7FF, b"")
    assert 0x7FF not in rig.monitors.wanted_ids


def test_frames_at_the_controllers_own_port_count_before_those_on_the_bus(
    rig: Rig,
) -> None:
    """A fault that writes a released brake onto the bus does not count as the controller's
    output."""
    plans = read_monitors([stl("always(emergency_commanded)")], "test", "none")
    monitors = MonitorSet(plans, rig.context, own_port=True)
    for can_id, data in Encoder().encode(EXAMPLES[0]):
        monitors.frame(1000, can_id, data)
    monitors.sample(rig.truth, 10_000_000)
    assert monitors.violated is None

    for can_id, data in Encoder().encode(EXAMPLES[0]):
        monitors.said(11_000_000, can_id, data)
    monitors.sample(rig.truth, 20_000_000)
    assert monitors.violated is plans[0]


# Signals of expressions.


@pytest.mark.parametrize("name", NAMES)
def test_every_signal_can_be_read_and_is_a_finite_number(rig_for: type[Rig], name: str) -> None:
    text = f"always({name} <= 1000000000)"
    rig = rig_for([stl(text)], "none")
    rig.step(10, speed_mps=1.0)

    result = rig.result(text)
    assert result.verdict is Verdict.PASS
    assert result.margin is not None


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("civil_limit_mps", 70 / 3.6),
        ("to_authority_m", 3559.9),
        ("stop_error_m", 1000.1 - 1500.0),
        ("standing", 0.0),
        ("platform_left", 0.0),
        ("claimed_front_m", 1000.0),
        ("uncertainty_m", 1.0),
        ("brake_age_s", 0.04875),
        ("emergency_commanded", 0.0),
        ("supervision", 1.0),
        ("position_error_m", -0.00175),
        ("stopping_m", 0.7 + 0.5),
        ("t_s", 0.1),
    ],
)
def test_every_signal_has_the_value_of_its_name(
    rig_for: type[Rig], name: str, value: float
) -> None:
    """The state after ten steps at 1 m/s on the level; the last frames were sent 50 ms ago."""
    above, below = f"always[0.09:0.09]({name} >= 0)", f"always[0.09:0.09]({name} - {value} <= 0)"
    rig = rig_for([stl(above), stl(below)], "none")
    rig.step(10, speed_mps=1.0)

    if name not in BOOLEANS:
        assert rig.margin(above) == pytest.approx(value, abs=2e-3)
    assert rig.margin(below) == pytest.approx(0.0, abs=2e-3)


def test_every_signal_of_the_truth_is_in_the_vocabulary_and_no_other() -> None:
    of_truth = {signal.name for signal in SIGNALS if signal.origin is Origin.TRUTH}

    assert of_truth == set(truth.SIGNALS)
    assert len(set(NAMES)) == len(NAMES)
