"""Driver models at the desk of a train that the controller supervises."""

from functools import cache

import pytest

from can_dbc.vobc import Supervision
from metro_hil.model.mission import plan_journey
from metro_hil.model.run_options import parse
from metro_hil.run.lockstep import Lockstep, config_of, scenario_of

END_S = 90.0


@cache
def driven(name: str) -> tuple[frozenset[Supervision], float, float]:
    """All supervision states, and the final front and end of authority."""
    options = parse(
        ["run", "--lockstep", "--from", "II", "--to", "III", "--desk", "manual", "--driver", name]
    )
    bench = Lockstep(config_of(options), scenario_of(options), plan_journey(options))
    seen: set[Supervision] = set()

    def over(now_ns: int) -> bool:
        seen.add(bench.vobc.output.supervision)
        return now_ns >= END_S * 1e9

    bench.run_until(over)
    bench.close()
    plant = bench.plant
    return frozenset(seen), plant.world.front_m, plant.authority_end_m


def test_an_obedient_driver_arrives_without_intervention_of_protection() -> None:
    seen, front_m, _ = driven("obedient")
    # Before its first cycle a controller sends the safe output.
    assert seen <= {Supervision.EMERGENCY, Supervision.NO_AUTHORITY, Supervision.NOMINAL}
    assert front_m > 3500.0


@pytest.mark.parametrize("name", ["reckless", "late"])
def test_a_reckless_driver_is_braked_and_never_passes_the_end_of_authority(name: str) -> None:
    seen, front_m, end_m = driven(name)
    assert Supervision.SERVICE in seen
    assert 3250.0 < front_m <= end_m
