"""Network faults follow from a seed."""

from metro_hil.simulation.batch import cpu_ns
from metro_hil.simulation.generate import PROFILES, draw
from metro_hil.simulation.line_world import LineWorld
from metro_hil.simulation.network_faults import FaultScale
from metro_hil.simulation.run import Phases, RunResult, run_seed

DENSE_SEED = 200_000


def run(foul_share: float) -> RunResult:
    world = LineWorld(DENSE_SEED, draw(DENSE_SEED, PROFILES["dense"]))
    # No fault occurs meanwhile.
    scale = FaultScale(between_s_min=1e6, between_s_max=1e6, foul_share=foul_share)
    return run_seed(DENSE_SEED, world, scale, Phases(trouble_s=20.0, calm_s=5.0), cpu_ns)


def lost_share(result: RunResult) -> float:
    return result.messages["lost"] / result.messages["sent"]


def test_permanent_heavy_loss_breaks_no_rule() -> None:
    fair, foul = run(0.0), run(0.3)

    assert (fair.invariant, foul.invariant) == ("", "")
    assert not fair.faults
    assert not foul.faults
    assert lost_share(foul) > lost_share(fair) + 0.02
