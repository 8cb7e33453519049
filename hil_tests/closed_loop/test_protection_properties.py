"""Random trains with random odometers in the closed loop: every claim of the controller must be
true."""

import os
from typing import Final

from hypothesis import Phase, given, note, settings
from hypothesis import strategies as st

from metro_hil.model.mission import plan_journey
from metro_hil.model.run_options import parse
from metro_hil.run.lockstep import Lockstep, Taps, config_of, scenario_of
from plant_emulator.truth import Truth

EXAMPLES: Final = int(os.environ.get("METRO_PROPERTY_EXAMPLES", "4"))
"""Number of examples; METRO_PROPERTY_EXAMPLES=200 tries more."""
CLAIM_AGE_S: Final = 0.1
"""Age of a claim: a cycle and the frames before it, s."""
STANDS_MPS: Final = 3.0 / 3.6
RIDE_S: Final = 120.0
CONSISTS: Final = ("florence4", "florence4_blending", "florence4_fixed_delay", "florence4_ideal")


class Oracle:
    """Compares every claim of the controller with the truth of the plant, step by step."""

    def __init__(self, margin_mps: float) -> None:
        self.bench: Lockstep | None = None
        self.false: dict[str, float] = {}
        """False claims, and when each first occurred."""
        self._margin_mps = margin_mps

    def __call__(self, truth: Truth, now_ns: int) -> None:
        if self.bench is None or self.bench.vobc.output.motion is None:
            return
        for name in self._false_claims(truth):
            self.false.setdefault(name, now_ns / 1e9)

    def _false_claims(self, truth: Truth) -> list[str]:
        assert self.bench is not None
        output, line = self.bench.vobc.output, self.bench.plant.world.line
        motion = output.motion
        assert motion is not None
        play_m = abs(truth.speed_mps) * CLAIM_AGE_S
        front_m, limit_mps = truth.front_m, line.least_limit_mps(truth.rear_m, truth.front_m)
        claims = {
            "the front lies in its interval": not motion.localised
            or motion.front_m.low - play_m <= front_m <= motion.front_m.high + play_m,
            "standstill means standing": not motion.standstill or truth.speed_mps < STANDS_MPS,
            "the civil limit holds": truth.speed_mps <= limit_mps + self._margin_mps,
            "doors only at rest": not (output.enable_left or output.enable_right)
            or abs(truth.speed_mps) < STANDS_MPS,
        }
        return [name for name, holds in claims.items() if not holds]


@settings(max_examples=EXAMPLES, derandomize=True, phases=[Phase.explicit, Phase.generate])
@given(
    seed=st.integers(0, 10_000),
    consist=st.sampled_from(CONSISTS),
    load_ratio=st.floats(0.0, 1.0).map(lambda ratio: round(ratio, 2)),
    odometer_error=st.floats(-0.01, 0.05).map(lambda ratio: round(ratio, 4)),
    hop=st.sampled_from([("Start", "I"), ("II", "III"), ("III", "IV")]),
)
def test_every_claim_about_a_train_is_true(
    seed: int, consist: str, load_ratio: float, odometer_error: float, hop: tuple[str, str]
) -> None:
    words = ["run", "--lockstep", "--seed", str(seed), "--consist", consist]
    words += ["--load-ratio", str(load_ratio), f"--odometer-error={odometer_error}"]
    words += ["--from", hop[0], "--to", hop[1]]
    note(f"again: vobc {' '.join(words)}")
    options = parse(words)
    config = config_of(options)
    oracle = Oracle(config.atp.emergency_margin_mps)
    bench = Lockstep(config, scenario_of(options), plan_journey(options), taps=Taps(truth=oracle))
    oracle.bench = bench
    try:
        bench.run(RIDE_S)
    finally:
        bench.close()

    assert oracle.false == {}
    assert bench.plant.world.front_m > plan_journey(options).start.stop_m + 1.0
