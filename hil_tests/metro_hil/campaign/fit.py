"""Checks the faults of a scenario against the line, network, service and train that it names."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

from firmware_py.settings import SettingsError, override
from firmware_py.trackdb import load_line
from firmware_py.trackdb.circuit import load_switched
from metro_hil.campaign.problems import Findings
from metro_hil.campaign.tables import ConfigTable
from metro_hil.model.case import Setup
from metro_hil.model.case_setup import file_name
from metro_hil.model.service import service_of, trains_of
from plant_emulator.faults.fitting import (
    FaultTargets,
    check_acting,
    check_commanded,
    check_fitting,
    targets_on,
)
from plant_emulator.faults.plan import FaultPlan, read_faults
from plant_emulator.train_config import load_train

LOOPS: Final = "loop"
"""Begin of the keys of the real train that decide whether a fault fits it."""


class Scope(NamedTuple):
    """Where the faults of a setup may act."""

    targets: FaultTargets
    trains: int
    trips: int


class FaultCheck:
    """Checks the faults of all scenarios of a campaign; reads each line and service once."""

    def __init__(self, files: Mapping[str, Path]) -> None:
        """Args:
        files: paths of the user's files, by their names in the cases. It may still grow.
        """
        self._files = files
        self._scopes: dict[str, Scope] = {}

    def check(self, setup: Setup, tables: Sequence[ConfigTable], findings: Findings) -> None:
        """Report each fault that a run of the setup would refuse.

        Args:
            tables: valid `[[fault]]` tables.
        """
        for plan in read_faults(tables, ""):
            try:
                self._check_one(setup, plan)
            except SettingsError as error:
                findings.add_text(str(error), "fault", ())

    def _check_one(self, setup: Setup, plan: FaultPlan) -> None:
        scope = self._scope(setup)
        check_fitting((plan,), scope.targets, "")
        check_acting((plan,), "", trains=scope.trains, trips=scope.trips)
        if setup.masters:
            check_commanded((plan,), "")

    def _scope(self, setup: Setup) -> Scope:
        loops = {key: value for key, value in setup.real.items() if key.startswith(LOOPS)}
        key = repr((setup.line, setup.consist, sorted(loops.items()), setup.service, setup.trains))
        if key not in self._scopes:
            line = file_name(setup.line, self._files)
            train = load_train(file_name(setup.consist, self._files))
            self._scopes[key] = Scope(
                targets_on(
                    override(train, loops, "train.real"), load_line(line), load_switched(line)
                ),
                trains_of(setup, self._files),
                max(1, len(service_of(setup, self._files))),
            )
        return self._scopes[key]
