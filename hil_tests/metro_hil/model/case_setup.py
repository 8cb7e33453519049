"""Builds from a case what its devices need: line, mission, real train, believed train."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from can_dbc.cab import CabMode
from firmware_py.settings import SettingsError, nearest
from firmware_py.trackdb import LineMap, load_line
from firmware_py.trackdb.circuit import split_route, with_route
from metro_hil.model.case import TIME_MAX_S, Case, Setup
from metro_hil.model.mission import Journey
from plant_emulator.faults.fitting import check_acting, check_fitting, targets_of
from plant_emulator.faults.plan import FaultPlan, read_faults
from plant_emulator.world import TrainScenario, plan_scenario
from vobc.config import VobcConfig, load_config, plan_mission
from vobc.plausible import check_plausible
from vobc.vocabulary import Mission

Files = Mapping[str, Path]
"""Paths of the user's files, by the name by which cases refer to them."""
NO_FILES: Files = {}


@dataclass(frozen=True, slots=True)
class CaseParts:
    """All parts from which a bench sets up a run."""

    journey: Journey
    scenario: TrainScenario
    config: VobcConfig
    faults: tuple[FaultPlan, ...]


def parts_of(case: Case, files: Files = NO_FILES, *, trains: int = 1, trips: int = 1) -> CaseParts:
    """Build the parts. Raises SettingsError for values that do not fit together.

    Args:
        trains, trips: numbers of the service that the case belongs to.
    """
    setup = case.setup
    if setup.service is not None:
        raise SettingsError(
            f"{case.id}: train.service: needs the lockstep bench and the shipped controller and "
            "train, without [branch]"
        )
    line = line_of(setup, files)
    mission = mission_of(setup, line)
    config = config_of(setup, files)
    check_plausible(config, line)
    scenario = scenario_of(setup, mission, _first_seed(case), files)
    faults = read_faults(case.faults, case.id)
    check_fitting(faults, targets_of(scenario), case.id)
    check_acting(faults, case.id, trains=trains, trips=trips)
    return CaseParts(
        journey=Journey(line, mission, setup.wakes_up, _memory_line(setup, files)),
        scenario=scenario,
        config=config,
        faults=faults,
    )


def _memory_line(setup: Setup, files: Files) -> LineMap | None:
    return None if setup.memory_line is None else load_line(file_name(setup.memory_line, files))


def _first_seed(case: Case) -> int:
    return case.seed if case.branch is None else case.branch.seed


def line_of(setup: Setup, files: Files = NO_FILES) -> LineMap:
    """The line as the controller knows it: its file with dwell and running times of the case, and
    with the stopping points of the train that the controller believes.
    """
    line = load_line(file_name(setup.line, files))
    return _timed(setup, line.for_train(config_of(setup, files).train.length_m))


def _timed(setup: Setup, line: LineMap) -> LineMap:
    names = [station.name for station in line.stations]
    for key, times_s in (("dwell_s", setup.dwell_s), ("run_s", setup.run_s)):
        for name, time_s in times_s.items():
            if name not in names:
                raise SettingsError(f"{key}.{name}: no such station; {nearest(name, names)}")
            if not 0.0 <= time_s <= TIME_MAX_S:
                raise SettingsError(f"{key}.{name}: {time_s:g} is not within 0..{TIME_MAX_S:g}")
    stations = tuple(
        replace(
            station,
            dwell_s=setup.dwell_s.get(station.name, station.dwell_s),
            run_s=setup.run_s.get(station.name, station.run_s),
        )
        for station in line.stations
    )
    return replace(line, stations=stations)


def mission_of(setup: Setup, line: LineMap) -> Mission:
    return plan_mission(line, setup.start, setup.end, setup.stops)


def scenario_of(
    setup: Setup, mission: Mission, seed: int, files: Files = NO_FILES
) -> TrainScenario:
    try:
        mode = CabMode[setup.desk_mode.upper()]
    except KeyError:
        modes = [known.name.lower() for known in CabMode]
        raise SettingsError(
            f"desk_mode: {setup.desk_mode!r}: {nearest(setup.desk_mode, modes)}"
        ) from None
    scenario = plan_scenario(
        line=file_name(setup.line, files),
        consist=file_name(setup.consist, files),
        seed=seed,
        start=mission.start.name,
        end=mission.stops[-1].name,
        load_ratio=setup.load_ratio,
        odometer_error_ratio=setup.odometer_error,
        desk_mode=mode,
        real=setup.real,
        driver=setup.driver,
        desk_recording=(
            None if setup.desk_recording is None else file_name(setup.desk_recording, files)
        ),
    )
    return replace(scenario, line=_timed(setup, scenario.line))


def config_of(setup: Setup, files: Files = NO_FILES) -> VobcConfig:
    params = file_name(setup.params, files)
    return load_config(params, cycle_ms=setup.cycle_ms, changes=setup.believed)


def file_name(name: str, files: Files) -> str:
    """The path of a file that a case names, with its route if it is that of a line."""
    base, route = split_route(name)
    if base not in files:
        return name
    return with_route(str(files[base]), route)
