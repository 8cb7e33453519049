"""Runs in lockstep that record the true state and the controller's output at every step."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

from can_dbc.cab import Desk
from can_dbc.vobc import Cause, OperatingMode
from metro_hil.model.mission import plan_journey
from metro_hil.model.run_options import parse
from metro_hil.run.lockstep import Lockstep, Taps, config_of, scenario_of
from plant_emulator.faults.plan import read_faults
from plant_emulator.truth import Truth
from vobc.vocabulary import CycleOutput

NS_PER_S: Final = 1_000_000_000
Hand = Callable[[Desk, float], Desk]
"""Gives the desk's new state from the present one and the time of the run, s."""


class ObservedInstant(NamedTuple):
    t_s: float
    front_m: float
    """True value, like the speed."""
    speed_mps: float
    output: CycleOutput


@dataclass
class ObservedRun:
    """True states and controller outputs, every 10 ms."""

    seen: list[ObservedInstant] = field(default_factory=list)

    def within(self, mode: OperatingMode) -> list[ObservedInstant]:
        return [each for each in self.seen if each.output.mode is mode]

    def at(self, t_s: float) -> ObservedInstant:
        return next(each for each in self.seen if each.t_s >= t_s)

    def between(self, start_s: float, end_s: float) -> list[ObservedInstant]:
        """The instants from `start_s` on and before `end_s`."""
        return [each for each in self.seen if start_s <= each.t_s < end_s]

    @property
    def causes(self) -> set[Cause]:
        return {each.output.emergency_cause for each in self.seen}


def ride(
    *faults: dict[str, Any],
    seconds: float,
    end: str = "III",
    hand: Hand | None = None,
) -> ObservedRun:
    """Run from station II of the Florence line to `end`, with faults as in a scenario's file."""
    options = parse(["run", "--lockstep", "--from", "II", "--to", end, "--seed", "3"])
    found = ObservedRun()

    def observe(truth: Truth, now_ns: int) -> None:
        t_s = now_ns / NS_PER_S
        found.seen.append(ObservedInstant(t_s, truth.front_m, truth.speed_mps, bench.vobc.output))
        if hand is not None:
            bench.plant.world.put_desk(hand(bench.plant.world.desk, t_s))

    bench = Lockstep(
        config_of(options),
        scenario_of(options),
        plan_journey(options),
        faults=read_faults(faults, "scenario"),
        taps=Taps(truth=observe),
    )
    bench.run(seconds)
    bench.close()
    return found
