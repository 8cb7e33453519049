"""Plain values: an image keeps each source with its own age, and defaults claim nothing."""

import dataclasses
import inspect
import math
import typing
from typing import Any

import pytest

from can_dbc.doors import ALL_CARS
from can_dbc.nodes import Direction
from can_dbc.vobc import Intervention, OperatingMode, ReasonCode, Supervision
from vobc.config import load_config
from vobc.vocabulary import (
    SAFE_CURRENTS,
    SAFE_OUTPUT,
    AtoDemand,
    AtoInput,
    Ceiling,
    CurrentReference,
    CycleInput,
    CycleOutput,
    Event,
    Motion,
    OdometryRecord,
    Orders,
    PlaceProof,
    Received,
    TrainBelief,
    cycle_input,
)

NOW_NS = 5_000_000_000
SOURCES = [
    name
    for name, parameter in inspect.signature(cycle_input).parameters.items()
    if "Received[" in str(parameter.annotation)
]
PLAIN: dict[str, Any] = {
    "now_ns": NOW_NS, "dt_s": 0.05, "overruns": 0, "tacho_samples": (), "tags": (),
    "tag_gap": False,
}  # fmt: skip


def test_every_field_but_the_plain_ones_is_a_source_and_its_age() -> None:
    fields = {field.name for field in dataclasses.fields(CycleInput)}

    assert len(SOURCES) == 14
    assert fields == {*PLAIN, *SOURCES, *(f"{name}_age_s" for name in SOURCES)}


def test_value_and_age_of_a_source_come_from_one_received() -> None:
    received: dict[str, Any] = {
        name: Received(f"value of {name}", NOW_NS - 1_000_000 * number)
        for number, name in enumerate(SOURCES)
    }

    image = cycle_input(**PLAIN, **received)

    for number, name in enumerate(SOURCES):
        assert getattr(image, name) == f"value of {name}"
        assert math.isclose(getattr(image, f"{name}_age_s"), 0.001 * number, abs_tol=1e-12)


def test_a_source_that_was_never_received_is_infinitely_old() -> None:
    nothing: dict[str, Any] = dict.fromkeys(SOURCES)

    image = cycle_input(**PLAIN, **nothing)

    assert image == CycleInput(now_ns=NOW_NS, dt_s=0.05)
    for name in SOURCES:
        assert getattr(image, name) is None
        assert getattr(image, f"{name}_age_s") == math.inf


def test_the_type_of_a_source_is_that_of_its_field() -> None:
    fields = typing.get_type_hints(CycleInput)
    parameters = typing.get_type_hints(cycle_input)

    for name in SOURCES:
        (received,) = [each for each in typing.get_args(parameters[name]) if each is not type(None)]
        assert set(typing.get_args(fields[name])) == {*typing.get_args(received), type(None)}


FILLED: dict[str, Any] = {
    "AtoInput.departure_permitted": True,
    "CycleOutput.replicas_agree": True,
    "CycleOutput.mode": OperatingMode.STANDBY,
    "CycleOutput.intervention": Intervention.EMERGENCY_BRAKE,
    "CycleOutput.reason": ReasonCode.CONTROLLER_ENDS,
    "CycleOutput.door_cars": ALL_CARS,
    "Motion.next_tag_m": math.inf,
    "OdometryRecord.proof": PlaceProof.SET_UP,
}
"""Defaults that say something. An age is infinite."""


@pytest.mark.parametrize(
    "kind",
    [AtoDemand, AtoInput, Ceiling, CycleInput, CycleOutput, Event, Motion, OdometryRecord, Orders,
     TrainBelief],
)  # fmt: skip
def test_what_is_not_given_is_said_to_be_nothing(kind: type[Any]) -> None:
    for field in dataclasses.fields(kind):
        if field.default is dataclasses.MISSING:
            continue
        name = f"{kind.__name__}.{field.name}"
        if field.name.endswith("_age_s"):
            assert field.default == math.inf, name
        elif name in FILLED:
            assert field.default == FILLED[name], name
        else:
            assert not field.default, name


def test_the_safe_output_releases_and_enables_nothing() -> None:
    kept = {"motion", "ceiling", "currents", *(name.split(".")[1] for name in FILLED)}
    said = {
        field.name: getattr(SAFE_OUTPUT, field.name)
        for field in dataclasses.fields(CycleOutput)
        if field.name not in kept and getattr(SAFE_OUTPUT, field.name)
    }

    assert said == {
        "service_decel_mps2": 2.0,
        "supervision": Supervision.EMERGENCY,
        "distance_to_stop_m": math.inf,
        "cause": "safe output",
    }
    assert SAFE_OUTPUT.direction is Direction.NEUTRAL
    assert (SAFE_OUTPUT.motion, SAFE_OUTPUT.ceiling, SAFE_OUTPUT.currents) == (None, None, None)
    assert CurrentReference(traction_ma=3.8, brake_ma=18.0) == SAFE_CURRENTS


TRAIN = load_config("florence4").train
PLAUSIBLE = {
    "length_m": (1.0, 500.0), "tare_kg": (1e3, 2e6), "full_load_kg": (0.0, 2e6),
    "rotating_mass_ratio": (0.0, 0.5), "antenna_offset_m": (0.0, 500.0),
    "wheel_diameter_m": (0.3, 1.5), "pulses_per_turn": (1, 10_000), "rated_force_n": (1e3, 3e6),
    "rated_power_w": (1e3, 1e8), "service_decel_max_mps2": (0.2, 2.0),
    "car_lengths_m": (1.0, 100.0),
}  # fmt: skip


def train(name: str, value: float) -> TrainBelief:
    given: Any = (20.0, value) if name == "car_lengths_m" else value
    return dataclasses.replace(TRAIN, **{name: given})


@pytest.mark.parametrize("name", [field.name for field in dataclasses.fields(TrainBelief)])
def test_a_property_of_the_train_has_a_plausible_range(name: str) -> None:
    least, most = PLAUSIBLE[name]

    for value in (least, most):
        train(name, value)
    for value in (math.nextafter(least, -math.inf), math.nextafter(most, math.inf), math.nan):
        with pytest.raises(ValueError, match=rf"^{name} \S+ is not in "):
            train(name, value)


def test_a_pulse_is_the_share_of_a_turn_of_the_wheel() -> None:
    turning = dataclasses.replace(TRAIN, wheel_diameter_m=0.8, pulses_per_turn=100)

    assert turning.nominal_m_per_pulse == pytest.approx(0.025133, abs=1e-6)


def test_an_age_is_the_time_since_the_reception() -> None:
    assert Received("value", 4_000_000_000).age_s(NOW_NS) == pytest.approx(1.0)
    assert Received("value", NOW_NS).age_s(NOW_NS) == 0.0
