"""Loads the parts of a run and checks that they fit, before any process starts."""

from collections.abc import Sequence
from dataclasses import dataclass

from firmware_py.settings import SettingsError
from firmware_py.trackdb import LineMap, Station, load_line
from metro_hil.model.run_options import RunOptions
from plant_emulator.train_config import TrainConfig
from vobc.config import VobcConfig, load_config, plan_mission
from vobc.vocabulary import Mission, OdometryRecord


@dataclass(frozen=True, slots=True)
class Journey:
    """One trip along one line."""

    line: LineMap
    mission: Mission
    wakes_up: bool = False
    """Whether the controller was switched off at the start and remembers its place."""
    memory_line: LineMap | None = None
    """Line that the remembered place belongs to; None: that of the run."""
    handed_over: OdometryRecord | None = None
    """Place that the controller of the other cab handed over; None: the train was set up."""

    @property
    def start(self) -> Station:
        return self.mission.start

    @property
    def stops(self) -> Sequence[Station]:
        """Stations at which the train stops, in running order."""
        return self.mission.stops

    @property
    def end(self) -> Station:
        return self.mission.stops[-1]

    @property
    def planned_run_s(self) -> dict[str, float]:
        """Planned running times between stops by the later stop, s; only where the line plans
        them."""
        planned: dict[str, float] = {}
        before_m = self.start.stop_m
        for stop in self.stops:
            times_s = [each.run_s for each in self.line.stations_between(before_m, stop.stop_m)]
            if times_s and min(times_s) > 0.0:
                planned[stop.name] = sum(times_s)
            before_m = stop.stop_m
        return planned


def check_reference(config: VobcConfig, train: TrainConfig) -> None:
    """Raises SettingsError if the train takes its demands from another output than the
    controller's."""
    by_loop = config.ato.output.stage == "current_loop"
    if by_loop and not train.loop.connected:
        raise SettingsError(
            f"--output current_loop: the train {train.name} takes traction and service brake from "
            "the bus; choose one on current loops, such as --consist florence4_loop"
        )
    if train.loop.connected and not by_loop:
        raise SettingsError(
            f"--consist {train.name}: takes traction and service brake from current loops; it "
            f"needs --output current_loop, not {config.ato.output.stage}"
        )


def plan_journey(options: RunOptions) -> Journey:
    """Load line and mission. Raises SettingsError if line and stations do not fit together."""
    config = load_config(options.params)
    line = load_line(options.line).for_train(config.train.length_m)
    return Journey(line, plan_mission(line, options.start, options.end))
