"""A train whose guaranteed emergency brake is weak brakes below the curves of protection."""

from dataclasses import replace
from typing import Final

from can_dbc.vobc import Supervision
from metro_hil.model.mission import plan_journey
from metro_hil.model.run_options import parse
from metro_hil.run.lockstep import Lockstep, Taps, config_of, scenario_of
from plant_emulator.truth import Truth

RUN_S: Final = 54.0
"""Time until the train has braked to 15 m/s. Without foresight protection brakes it before."""


def test_protection_never_warns_a_train_with_a_weak_emergency_brake() -> None:
    """The authority ends 60 m beyond the stop, too near for the braking of a usual train."""
    options = parse(["run", "--lockstep", "--from", "III", "--to", "IV"])
    config = config_of(options)
    atp = replace(config.atp, guaranteed_decel_mps2=0.35)
    states: set[Supervision] = set()
    speeds_mps: list[float] = []

    def watch(truth: Truth, _now_ns: int) -> None:
        speeds_mps.append(truth.speed_mps)
        if bench.vobc.output.motion is not None:
            states.add(bench.vobc.output.supervision)

    journey, scenario = plan_journey(options), scenario_of(options)
    line = replace(journey.line, rollback_m=10.0)
    bench = Lockstep(
        replace(config, atp=atp),
        replace(scenario, line=line),
        replace(journey, line=line),
        taps=Taps(truth=watch),
    )
    try:
        bench.run(RUN_S)
    finally:
        bench.close()

    assert states == {Supervision.NO_AUTHORITY, Supervision.NOMINAL}
    assert max(speeds_mps) > 18.0
    assert speeds_mps[-1] < 15.0
