"""What monitors have to allow for in real time: no less than what a host does unnoticed.

A host that holds the run up for longer than the thresholds of `metro_hil.realtime.attribution` is
named for it, and a failure beside that is INVALID. What stays below them is named by nobody, so no
monitor may take it for the controller's doing: between the two is no gap through which a host makes
a failure of a good controller.
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
"""As in lockstep: what happens between two samples, and frames that wait for the bus."""
FAULT_AGE_S: Final = 0.25
"""As in lockstep: what faults delay by less is heard, and believed to be as old as it is."""
MS_PER_S: Final = 1000.0


def context_of(case: Case, made: CaseParts) -> Context:
    """The same values as in lockstep, and what the host and the gateway may add to them."""
    gateway_s = GATEWAY_LATE_S if needs_gateway(made.faults) else 0.0
    places = {plan.kind.place for plan in made.faults}
    faults_s = 0.0 if places.isdisjoint(BENCH_PLACES) else FAULT_AGE_S
    return Context(
        line=made.journey.line,
        train=made.scenario.train,
        cycle_s=case.setup.cycle_ms / MS_PER_S,
        # Either the controller is late or the train that it is compared with.
        slack_s=FRAME_WAIT_S + max(LATE_S, PLANT_LATE_S) + gateway_s,
        input_age_s=faults_s + PLANT_LATE_S + gateway_s,
        lateness_s=LATE_S,
        settling_s=START_UP_S,
    )


def needs_gateway(faults: Sequence[FaultPlan]) -> bool:
    """Whether controller and train are on segments of their own."""
    return any(plan.kind.place is FaultPlace.BUS for plan in faults)
