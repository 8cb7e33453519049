"""The runs on which a law is tuned, and those with other seeds on which it is judged."""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import msgspec

from firmware_py.settings import SettingsError
from firmware_py.trackdb import load_line
from metro_hil.model.case import Case, Setup
from plant_emulator.train_config import load_train
from vobc.config import load_config

LOADS: Final = (0.0, 0.5, 1.0)
ODOMETER_ERRORS: Final = (0.05, -0.01, 0.02)
TRAINING: Final = 6
VALIDATION: Final = 12
SEEDS_APART: Final = 100_000
"""Distance between the seeds of training and those of validation."""
DURATION_S: Final = 300.0


@dataclass(frozen=True, slots=True)
class Ground:
    """Where a law is tuned: the shortest hop of a line, a train, and the controller's
    parameters."""

    law: str
    line: str
    consist: str
    params: str

    def check(self) -> None:
        """Raises SettingsError for files that are unreadable or do not fit."""
        load_train(self.consist)
        load_config(self.params, law=self.law)
        self._hop()

    @property
    def by_notches(self) -> bool:
        """Whether notches drive the train, chosen by the law or by the output stage."""
        stage = load_config(self.params, law=self.law).ato.output.stage
        return self.law.startswith("chasing") or stage == "notches"

    def _hop(self) -> tuple[str, str]:
        """The two neighbouring stations with the shortest distance."""
        stations = load_line(self.line).stations
        if len(stations) < 2:
            raise SettingsError(f"--line {self.line}: has no two stations to run between")
        hops = itertools.pairwise(stations)
        first, last = min(hops, key=lambda hop: hop[1].stop_m - hop[0].stop_m)
        return first.name, last.name

    def training(self, values: Mapping[str, Any], seed: int) -> list[Case]:
        return self._cases("training", TRAINING, values, seed)

    def validation(self, values: Mapping[str, Any], seed: int) -> list[Case]:
        return self._cases("validation", VALIDATION, values, seed + SEEDS_APART)

    def allows(self, values: Mapping[str, Any]) -> bool:
        """Whether the parameter classes accept these settings together."""
        try:
            load_config(self.params, changes=self._believed(values))
        except SettingsError:
            return False
        return True

    def _believed(self, values: Mapping[str, Any]) -> dict[str, Any]:
        return {"ato.strategy": self.law, **values}

    def _cases(self, name: str, count: int, values: Mapping[str, Any], seed: int) -> list[Case]:
        """Cases that vary loads, odometer errors and brake delays: random, or fixed at a bound."""
        start, end = self._hop()
        dead_time_s = load_train(self.consist).brake.service.dead_time_s
        delays: tuple[float | None, ...] = (None, dead_time_s.high, None, dead_time_s.low)
        return [
            Case(
                id=f"{name}/{place:02d}",
                index=place,
                scenario=name,
                seed=seed + place,
                setup=self._setup(start, end, place, delays[place % len(delays)], values),
                invariants="none",
                stop_at_violation=False,
            )
            for place in range(count)
        ]

    def _setup(
        self, start: str, end: str, place: int, delay_s: float | None, values: Mapping[str, Any]
    ) -> Setup:
        setup = Setup(
            line=self.line,
            start=start,
            end=end,
            consist=self.consist,
            params=self.params,
            load_ratio=LOADS[place % len(LOADS)],
            odometer_error=ODOMETER_ERRORS[place // len(LOADS) % len(ODOMETER_ERRORS)],
            duration_s=DURATION_S,
            believed=self._believed(values),
        )
        if delay_s is None:
            return setup
        return msgspec.structs.replace(setup, real={"brake.service.dead_time_s": delay_s})
