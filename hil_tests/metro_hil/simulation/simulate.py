"""The job that `hil simulate` runs for one seed; worker processes can receive it."""

import random
from dataclasses import dataclass
from typing import Final

from metro_hil.simulation.batch import cpu_ns
from metro_hil.simulation.event_queue import Codec
from metro_hil.simulation.generate import FAULTS_S, PROFILES, Draw, draw
from metro_hil.simulation.insider import Insider
from metro_hil.simulation.line_world import LineWorld
from metro_hil.simulation.network_faults import FaultScale
from metro_hil.simulation.paper_line import paper_world
from metro_hil.simulation.railway_events import RailwayEvents
from metro_hil.simulation.run import Also, Phases, RunResult, run_seed
from metro_hil.simulation.trace import EventTranscript, Teller
from metro_hil.simulation.wire import RealCodec
from metro_hil.simulation.world import SimulatedLine

PROTOCOLS: Final = ("line", "paper")
BYTES_EVERY: Final = 8
"""Every seed divisible by this number sends its messages through the real codec as bytes."""


@dataclass(frozen=True, slots=True)
class SeedJob:
    """Runs one seed for each call; picklable, so that worker processes can receive it."""

    phases: Phases
    protocol: str = "line"
    bytes_always: bool = False
    told: bool = False
    profile: str | None = None
    """Name of the profile of all seeds. None: each seed has its own."""

    def __reduce__(self) -> tuple[object, ...]:
        return SeedJob, (
            self.phases,
            self.protocol,
            self.bytes_always,
            self.told,
            self.profile,
        )

    def __call__(self, seed: int) -> RunResult:
        tell = EventTranscript(print) if self.told else None
        world = self._world(seed, tell)
        faults_s, foul_share = FAULTS_S, 0.0
        if isinstance(world, LineWorld):
            faults_s, foul_share = world.drawn.faults_s, world.drawn.foul_share
        drift_ppm = random.Random(seed ^ 0x5CA1E).choice((0, 100, 1000))
        scale = FaultScale(*faults_s, drift_ppm=drift_ppm, foul_share=foul_share)
        also: list[Also] = []
        if isinstance(world, LineWorld) and world.drawn.insider:
            scale = FaultScale(drift_ppm=drift_ppm, quiet=True)
            also = [Insider(world, seed)]
        elif isinstance(world, LineWorld):
            also = [RailwayEvents(world, seed)]
        result = run_seed(seed, world, scale, self.phases, cpu_ns, also)
        if isinstance(world, LineWorld):
            result.covered.update(world.t2t.covered)
        return result

    def options(self) -> list[str]:
        """Return the command-line options that repeat this run."""
        words = [] if self.protocol == "line" else [f"--protocol {self.protocol}"]
        words += ["--bytes"] if self.bytes_always else []
        words += [f"--profile {self.profile}"] if self.profile else []
        minutes = self.phases.trouble_s / 60.0
        return words if minutes == 5.0 else [*words, f"--minutes {minutes:g}"]

    def _world(self, seed: int, tell: Teller | None) -> SimulatedLine:
        if self.protocol == "paper":
            return paper_world(seed, tell=tell)
        codec: Codec | None = None
        if self.bytes_always or seed % BYTES_EVERY == 0:
            codec = RealCodec()
        return LineWorld(seed, self.sampled(seed), codec=codec, tell=tell)

    def sampled(self, seed: int) -> Draw:
        """What the seed plays."""
        return draw(seed, PROFILES[self.profile] if self.profile else None)
