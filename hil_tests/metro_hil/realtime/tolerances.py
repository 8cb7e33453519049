"""Tolerances that monitors need in real time: no less than the delays of a host that go unnoticed.

If a host delays the run beyond the thresholds of `metro_hil.realtime.attribution`, the evidence
names it, and a failure nearby is INVALID. Delays below them are not named, so no monitor may
attribute them to the controller. Thresholds and tolerances fit without a gap: a host cannot make a
good controller fail.
"""

from collections.abc import Sequence
from typing import Final

from metro_hil.model.case import Case
from metro_hil.model.case_setup import CaseParts
from metro_hil.monitors import Context
from metro_hil.realtime.attribution import GATEWAY_LATE_S, LATE_S, PLANT_LATE_S, START_UP_S
from plant_emulator.faults.kinds import BENCH_PLACES, FaultPlace
from plant_emulator.faults.plan import FaultPlan

FRAME_WAIT_S: Final = 0.02
"""As in lockstep: events between two samples, and frames that wait for the bus."""
FAULT_AGE_S: Final = 0.25
"""As in lockstep: frames that faults delay by less are accepted as being that old."""
MS_PER_S: Final = 1000.0


def context_of(case: Case, made: CaseParts) -> Context:
    """Return the values of lockstep plus what host and gateway may add."""
    gateway_s = GATEWAY_LATE_S if needs_gateway(made.faults) else 0.0
    places = {plan.kind.place for plan in made.faults}
    faults_s = 0.0 if places.isdisjoint(BENCH_PLACES) else FAULT_AGE_S
    return Context(
        line=made.journey.line,
        train=made.scenario.train,
        cycle_s=case.setup.cycle_ms / MS_PER_S,
        localisation_limit_m=made.config.odometry.localisation_limit_m,
        # Either the controller or the train that it is compared with is late.
        slack_s=FRAME_WAIT_S + max(LATE_S, PLANT_LATE_S) + gateway_s,
        input_age_s=faults_s + PLANT_LATE_S + gateway_s,
        lateness_s=LATE_S,
        settling_s=START_UP_S,
    )


def needs_gateway(faults: Sequence[FaultPlan]) -> bool:
    """Tell whether the case has bus faults, so that controller and train are kept apart."""
    return any(plan.kind.place is FaultPlace.BUS for plan in faults)
