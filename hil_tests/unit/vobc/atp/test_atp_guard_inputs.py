"""Defaults of the guard inputs before the first step, and the meaning of a default verdict."""

import itertools
import math
from dataclasses import MISSING, astuple, fields

from can_dbc.doors import ALL_CARS
from can_dbc.vobc import Cause, Inhibit, Intervention, OperatingMode, ReasonCode, Withheld
from vobc.atp.guard_inputs import NOWHERE, GuardInputs
from vobc.atp.verdict import ProtectionVerdict
from vobc.config import load_config
from vobc.vocabulary import Interval

CONFIG = load_config("florence4").atp


def test_the_default_guard_inputs_know_nothing_and_request_nothing() -> None:
    seen = GuardInputs(CONFIG)
    told = seen._asdict()

    assert told.pop("limits") is CONFIG
    assert told.pop("speed_mps") == Interval(0.0, 0.0, 0.0)
    assert told.pop("stop_by_mps") == math.inf
    assert told.pop("rollback_room_m") == math.inf
    assert told.pop("ceiling") is NOWHERE
    assert told.pop("mode") is OperatingMode.STANDBY
    assert told.pop("station_cause") is Cause.NONE
    assert told.pop("latched") == ()
    assert {name: value for name, value in told.items() if value} == {}
    assert all(type(value) in (bool, int, float) for value in told.values())


def test_a_train_without_position_has_no_permitted_speed() -> None:
    assert astuple(NOWHERE) == (0.0, 0.0, 0.0, 0.0, 0.0, None)


def test_only_both_signs_together_prove_rest() -> None:
    for standing, standstill in itertools.product((False, True), repeat=2):
        seen = GuardInputs(CONFIG, standing=standing, standstill=standstill)

        assert seen.at_rest is (standing and standstill)


def test_the_default_verdict_permits_nothing() -> None:
    silent = {
        field.name: field.default
        for field in fields(ProtectionVerdict)
        if field.default is not MISSING
    }

    assert silent == {
        "mode": OperatingMode.STANDBY,
        "emergency_cause": Cause.NONE,
        "emergency_number": 0,
        "intervention": Intervention.HELD,
        "reason": ReasonCode.NONE,
        "departure_inhibits": Inhibit.NONE,
        "doors_withheld": Withheld.NONE,
        "door_cars": ALL_CARS,
        "reverse_permitted": False,
        "jog_permitted": False,
        "jog_to_tag": False,
        "jog_back_m": 0.0,
        "jog_attempts": 0,
        "stop_now": False,
        "stop_next": False,
        "keep_doors_open": False,
        "creep": False,
        "replicas_agree": True,
        "alarm_raised": False,
        "door_bypass": False,
    }
