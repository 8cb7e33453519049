"""Tolerances of the monitors in real time, compared with the disturbances attributed to the
host."""

from dataclasses import fields
from typing import Any

import pytest

from metro_hil.model.case import Case, Setup
from metro_hil.model.case_setup import parts_of
from metro_hil.monitors import Context
from metro_hil.realtime.attribution import GATEWAY_LATE_S, LATE_S, PLANT_LATE_S
from metro_hil.realtime.tolerances import FAULT_AGE_S, FRAME_WAIT_S, context_of

DROP: Any = {"kind": "frame_drop", "start_s": 1.0}
PAUSE: Any = {"kind": "controller_paused", "start_s": 1.0}
SLIP: Any = {"kind": "wheel_slip", "start_s": 1.0}


def context(*faults: Any) -> Context:
    setup = Setup(start="II", end="III")
    case = Case(id="one", index=0, scenario="hop", seed=1, setup=setup, faults=faults)
    return context_of(case, parts_of(case))


@pytest.mark.parametrize(
    ("faults", "gateway_s"), [((), 0.0), ((SLIP,), 0.0), ((PAUSE,), 0.0), ((DROP,), GATEWAY_LATE_S)]
)
def test_no_monitor_is_stricter_than_an_unreported_host_disturbance(
    faults: tuple[Any, ...], gateway_s: float
) -> None:
    """A cycle or step that is late by just less than the limit adds to the tolerance of
    lockstep."""
    found = context(*faults)

    assert found.slack_s >= FRAME_WAIT_S + max(LATE_S, PLANT_LATE_S) + gateway_s
    assert found.lateness_s >= LATE_S
    assert found.input_age_s >= PLANT_LATE_S + gateway_s


@pytest.mark.parametrize(("fault", "ages"), [(SLIP, False), (PAUSE, True), (DROP, True)])
def test_inputs_age_by_faults_of_bus_and_process_and_by_no_others(fault: Any, ages: bool) -> None:
    assert (context(fault).input_age_s >= FAULT_AGE_S) is ages


def test_all_other_tolerances_equal_those_of_lockstep() -> None:
    found = context()
    plain = Context(line=found.line, train=found.train)

    changed = {
        each.name
        for each in fields(Context)
        if getattr(found, each.name) != getattr(plain, each.name)
    }
    assert changed == {"slack_s", "input_age_s", "lateness_s", "settling_s"}
