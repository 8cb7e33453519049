"""One train of a line in virtual time: controller, plant and bus, run interval by interval."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from can_dbc.vobc import Supervision
from firmware_py.trackdb import LineMap
from metro_hil.line.energy import TrainEnergy, energy_of
from metro_hil.metrics.hops import HopEnergy, MeterReading, hop_between, read_meter
from metro_hil.model.frame_hash import FrameHash
from metro_hil.model.mission import Journey, check_reference
from metro_hil.model.run_folder import RunFolder
from metro_hil.run.lockstep import Lockstep, Taps
from plant_emulator.power.supplies import Supply
from plant_emulator.traffic.config import TrafficConfig, plan_traffic
from plant_emulator.traffic.coupling import INTERVAL_NS, CouplingAnswer, IntervalReport
from plant_emulator.traffic.dispatcher import StationRun
from plant_emulator.traffic.member import TrafficMember, leader_rear_m, scenarios_of
from plant_emulator.traffic.timetable import LapTimetable, Start, lap_timetable, starts
from plant_emulator.world import TrainScenario
from vobc.config import VobcConfig, load_config, plan_mission
from vobc.plausible import check_plausible


@dataclass(frozen=True, slots=True)
class LinePlan:
    """All that is decided before the first step."""

    traffic: TrafficConfig
    timetable: LapTimetable
    line: LineMap
    supply: Supply
    starts: tuple[Start, ...]
    scenarios: tuple[TrainScenario, ...] = field(repr=False)
    config: VobcConfig = field(repr=False)
    seed: int


def plan_line(
    *,
    line: str,
    trains: int,
    consist: str | None,
    params: str | None,
    seed: int,
    law: str | None = None,
    supply: str | None = None,
    traffic: str | None = None,
    cycle_ms: float | None = None,
    stage: str | None = None,
    load_ratio: float | None = None,
    odometer_error_ratio: float | None = None,
) -> LinePlan:
    """Plan a line; None takes the value of the line's traffic. Raises SettingsError."""
    plan, track, network = plan_traffic(line, traffic, supply)
    placed = starts(plan, track, trains)
    scenarios = scenarios_of(
        plan,
        track,
        placed,
        consist=consist,
        seed=seed,
        load_ratio=load_ratio,
        odometer_error_ratio=odometer_error_ratio,
    )
    config = load_config(
        params or plan.params or plan.consist, cycle_ms=cycle_ms, law=law, stage=stage
    )
    track = track.for_train(config.train.length_m)
    check_plausible(config, track)
    check_reference(config, scenarios[0].train)
    timetable = lap_timetable(plan, track)
    return LinePlan(plan, timetable, track, network, placed, scenarios, config, seed)


class VirtualTrainReport(NamedTuple):
    """Results of one train."""

    train: int
    frames: int
    frame_chain: str
    runs: tuple[StationRun, ...]
    hops: tuple[HopEnergy, ...]
    """Energies of the runs."""
    emergencies: int
    energy: TrainEnergy
    lost_log_lines: int


class HopMeter:
    """Reads the meter of a train between its stops, once an interval."""

    def __init__(self, start: str, left: MeterReading, names: Mapping[str, str]) -> None:
        """Args:
        start: station of the first departure.
        names: of the stations of further laps, the name that each has in the first one.
        """
        self.found: list[HopEnergy] = []
        self._from, self._left, self._names = start, left, names

    def look(self, now: MeterReading, runs: Sequence[StationRun], *, stands: bool) -> None:
        """Args:
        runs: all runs that have ended.
        stands: whether the train stands at a platform.
        """
        if len(runs) > len(self.found):
            run = runs[-1]
            time_s = run.arrived_s - run.left_s
            start, end = (self._names.get(each, each) for each in (self._from, run.station))
            self.found.append(hop_between((start, end), time_s, self._left, now))
            self._from = run.station
        if stands:
            self._left = now


class VirtualTrain:
    """One train; `advance` runs it to the end of the next interval."""

    def __init__(self, plan: LinePlan, index: int, folder: RunFolder | None) -> None:
        start, scenario = plan.starts[index], plan.scenarios[index]
        config = replace(plan.config, address=start.train)
        mission = plan_mission(plan.line, start.station.name, None)
        self.chain = FrameHash()
        self._bench = Lockstep(
            config,
            scenario,
            Journey(plan.line, mission),
            folder,
            taps=Taps(frame=self.chain.frame),
        )
        self.member = TrafficMember(
            self._bench.plant,
            plan.traffic,
            plan.timetable,
            start,
            start_ns=0,
            leader_rear_m=leader_rear_m(plan.traffic, plan.starts, index, scenario.train.length_m),
        )
        self._power = self._bench.plant.world.power
        lap = plan.traffic.stations_a_lap or len(plan.line.stations)
        stations = [station.name for station in plan.line.stations]
        names = {name: stations[index % lap] for index, name in enumerate(stations)}
        self._hops = HopMeter(start.station.name, read_meter(self._power), names)
        self._intervals = 0
        self._emergency = False
        self._emergencies = 0

    def advance(self) -> IntervalReport:
        self._intervals += 1
        end_ns = self._intervals * INTERVAL_NS
        self._bench.run_until(lambda now_ns: now_ns >= end_ns)
        emergency = self._bench.vobc.output.supervision is Supervision.EMERGENCY
        self._emergencies += emergency and not self._emergency
        self._emergency = emergency
        report = self.member.says(end_ns)
        dispatcher = self.member.dispatcher
        stands = dispatcher.at_platform and report.speed_mps == 0.0
        self._hops.look(read_meter(self._power), dispatcher.runs, stands=stands)
        return report

    def on_message(self, answer: CouplingAnswer) -> None:
        self.member.on_message(answer)

    def close(self) -> VirtualTrainReport:
        """Close the logs and return the results."""
        self._bench.close()
        return VirtualTrainReport(
            train=self.member.train,
            frames=self.chain.frames,
            frame_chain=self.chain.value,
            runs=tuple(self.member.dispatcher.runs),
            hops=tuple(self._hops.found),
            emergencies=self._emergencies,
            energy=energy_of(self._power),
            lost_log_lines=self._bench.lost_log_lines,
        )
