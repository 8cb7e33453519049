"""One train of a line: its plant, its dispatcher, and its end of the coupling."""

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final, Protocol

from firmware_py.trackdb import LineMap
from plant_emulator.noise import Generators, NoiseSource, Uniform
from plant_emulator.power.box import Due
from plant_emulator.traffic.config import TrafficConfig
from plant_emulator.traffic.coupling import CLEAR_M, INTERVAL_S, CouplingAnswer, IntervalReport
from plant_emulator.traffic.dispatcher import Dispatcher
from plant_emulator.traffic.timetable import LapTimetable, Start
from plant_emulator.wayside.railway import Railway
from plant_emulator.wayside.separation import REAR_M, SPACE_M
from plant_emulator.world import TrainScenario, World, plan_scenario

NS_PER_S: Final = 1_000_000_000
SEEDS: Final = 1000
"""Distance between the seeds of two lines; it leaves room for a seed for each train."""


class Plant(Protocol):
    """The parts of a train's plant that the line uses."""

    @property
    def scenario(self) -> TrainScenario: ...

    @property
    def world(self) -> World: ...

    @property
    def railway(self) -> Railway: ...


class TrafficMember:
    """Couples one train to the line once an interval; answers may come an interval late, in
    order.
    """

    def __init__(
        self,
        plant: Plant,
        config: TrafficConfig,
        timetable: LapTimetable,
        start: Start,
        *,
        start_ns: int | None,
        leader_rear_m: float,
    ) -> None:
        """Args:
        start_ns: begin of the timetable; None: not before `begin`.
        leader_rear_m: initial rear of the train ahead, in this train's chainage.
        """
        scenario = plant.scenario
        self.plant = plant
        self.train = start.train
        self.dispatcher = Dispatcher(
            config, timetable, scenario.line, start, _dwells_s(config, scenario.seed)
        )
        self._start_ns = start_ns
        self._due: deque[Due] = deque()
        plant.world.power.join()
        plant.railway.zone.limit_m = leader_rear_m - SPACE_M

    def begin(self, now_ns: int) -> None:
        """Start the timetable now."""
        self._start_ns = now_ns

    def says(self, now_ns: int) -> IntervalReport:
        """Report the last interval, and let the dispatcher decide whether to hold the train."""
        plant, world = self.plant, self.plant.world
        wish, due = world.power.take_load(INTERVAL_S)
        self._due.append(due)
        centre, hold = plant.railway.centre, True
        if self._start_ns is not None:
            now_s = (now_ns - self._start_ns) / NS_PER_S
            hold = self.dispatcher.holds(now_s, world.front_m, world.speed_mps)
        if hold is not centre.standing.hold:
            centre.standing = replace(centre.standing, hold=hold)
        zone = plant.railway.zone
        rear_m = zone.latest_rear_m
        if zone.latest is None:
            rear_m = first_rear_m(world.front_m, world.length_m)
        return IntervalReport(
            front_m=world.front_m,
            speed_mps=world.speed_mps,
            rear_m=rear_m,
            traction_w=wish.traction_w,
            regenerated_w=wish.regenerated_w,
            auxiliary_w=wish.auxiliary_w,
        )

    def on_message(self, answer: CouplingAnswer) -> None:
        """Apply an answer to the earliest interval without one."""
        world = self.plant.world
        world.power.fed(
            answer.voltage_v,
            answer.chopped_ratio,
            answer.effort_ratio,
            self._due.popleft(),
            INTERVAL_S,
        )
        world.traction.feed(world.power.effort_ratio)
        self.plant.railway.zone.limit_m = answer.leader_rear_m - SPACE_M


def first_rear_m(front_m: float, length_m: float) -> float:
    """Return the rear of the track reserved for a stationary train that has not reported yet."""
    return front_m - length_m - REAR_M


def leader_rear_m(
    config: TrafficConfig, placed: Sequence[Start], index: int, length_m: float
) -> float:
    """Return the same for the train ahead, in this train's chainage; the foremost follows the
    last on a circuit.
    """
    if index == 0 and not config.circular:
        return CLEAR_M
    front_m = placed[index - 1].station.stop_m + (config.lap_m if index == 0 else 0.0)
    return first_rear_m(front_m, length_m)


def scenarios_of(
    config: TrafficConfig,
    line: LineMap,
    placed: Sequence[Start],
    *,
    consist: str | None,
    seed: int,
    load_ratio: float | None = None,
    odometer_error_ratio: float | None = None,
) -> tuple[TrainScenario, ...]:
    """Return the scenario of each train, each with its own seed. Raises SettingsError.

    Args:
        line: the line with the running times of the traffic.
    """
    found = []
    for start in placed:
        scenario = plan_scenario(
            line=config.line,
            consist=consist or config.consist,
            seed=seed * SEEDS + start.train,
            start=start.station.name,
            load_ratio=load_ratio,
            odometer_error_ratio=odometer_error_ratio,
        )
        timed = line.for_train(scenario.train.length_m)
        found.append(replace(scenario, line=timed) if config.runs_s else scenario)
    return tuple(found)


def _dwells_s(config: TrafficConfig, seed: int) -> Iterator[float]:
    """Uniformly distributed dwell times of one train; they do not depend on the ATO law."""
    generator = Generators(seed).of(NoiseSource.DWELL)
    low_s, high_s = config.dwell_s - config.dwell_spread_s, config.dwell_s + config.dwell_spread_s
    draws = Uniform(generator, low=low_s, high=high_s)
    while True:
        yield draws.draw()
