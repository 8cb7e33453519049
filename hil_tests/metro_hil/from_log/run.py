"""From a log to a scenario and its verdict, step by step."""

from dataclasses import dataclass, replace
from pathlib import Path

import canlog
from firmware_py.settings import override
from firmware_py.trackdb import load_line
from metro_hil.campaign import plan_cases, read_campaign
from metro_hil.from_log.compare import RideComparison, compare_rides
from metro_hil.from_log.fit import TrainFit, fit_train, fixed_values
from metro_hil.from_log.ride import (
    RecordedRide,
    RideStations,
    odometer_error_of,
    read_ride,
    stations_of,
)
from metro_hil.from_log.scenario import ChosenFiles, load_ratio_of, write_scenario
from metro_hil.model.case import Case, CaseResult
from metro_hil.model.run_folder import RunFolder
from metro_hil.run.dispatch import run_case
from plant_emulator.train_config import load_train
from plant_emulator.world import plan_scenario


@dataclass(frozen=True, slots=True)
class FittedRide:
    """A ride with the train that explains it."""

    log: "canlog.Log"
    ride: RecordedRide
    stations: RideStations
    files: ChosenFiles
    seed: int
    load_ratio: float | None
    odometer_error_ratio: float
    fit: TrainFit
    real: dict[str, float]
    """What the scenario changes in the consist, by dotted key."""


@dataclass(frozen=True, slots=True)
class Resimulated:
    """The simulated ride, to be compared with the recorded one."""

    case: Case
    result: CaseResult
    ride: RecordedRide
    comparison: RideComparison


def fit_log(log: "canlog.Log", files: ChosenFiles, *, seed: int) -> FittedRide:
    """Read a ride and fit the train to it. Raises SettingsError."""
    ride = read_ride(log)
    train = load_train(files.consist)
    stations = stations_of(ride, load_line(files.line).for_train(train.length_m))
    load_ratio = load_ratio_of(ride, train)
    error = round(odometer_error_of(ride, stations.start.stop_m), 5)
    scenario = plan_scenario(
        line=files.line,
        consist=files.consist,
        seed=seed,
        start=stations.start.name,
        end=stations.stops[-1].name,
        load_ratio=load_ratio,
        odometer_error_ratio=error,
    )
    fixed = fixed_values(train)
    scenario = replace(scenario, train=override(scenario.train, fixed, train.name))
    fit = fit_train(ride, scenario)
    return FittedRide(
        log=log,
        ride=ride,
        stations=stations,
        files=files,
        seed=seed,
        load_ratio=load_ratio,
        odometer_error_ratio=error,
        fit=fit,
        real={**fixed, **fit.values},
    )


def leave_scenario(folder: Path, fitted: FittedRide) -> Path:
    """Write the scenario of a fitted ride and return its path. Raises OSError."""
    return write_scenario(
        folder,
        fitted.ride,
        fitted.stations,
        fitted.files,
        load_ratio=fitted.load_ratio,
        odometer_error_ratio=fitted.odometer_error_ratio,
        real=fitted.real,
        seed=fitted.seed,
    )


def resimulate(
    path: Path, fitted: FittedRide, folder: Path, *, tolerance_ratio: float, window_s: float
) -> Resimulated:
    """Run the scenario as `hil run` does, and compare the controller's frames with the record.

    Raises SettingsError if the simulated train does not leave.
    """
    campaign = read_campaign(str(path))
    (case,) = plan_cases(campaign)
    folder.mkdir()
    files = {name: path.parent / name for name in campaign.files}
    result = run_case(case, files=files, folder=RunFolder(folder))
    again = canlog.read(RunFolder(folder).bus_log)
    ride = read_ride(again)
    comparison = compare_rides(
        *(fitted.log, fitted.ride, again, ride),
        tolerance_ratio=tolerance_ratio,
        window_s=window_s,
    )
    return Resimulated(case, result, ride, comparison)
