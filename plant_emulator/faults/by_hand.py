"""Faults that a person starts, changes and stops while the train runs.

Each act is a line of JSON. These are the three acts; a fault's number counts the starts from 0:

    {"start": {"kind": "brake_weak", "gain_ratio": 0.3}}
    {"set": 0, "values": {"gain_ratio": 0.1}}
    {"stop": 0}

The record is a list of `[[fault]]` tables, as in a scenario file. An act takes effect at the next
step of the plant, and the record has the time of that step. So a scenario with these tables gives
the same faults at the same steps.
"""

import json
import re
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final

import tomli_w

from firmware_py.settings import SettingsError
from plant_emulator.faults.fitting import FaultTargets, check_fitting
from plant_emulator.faults.kinds import FaultPlace
from plant_emulator.faults.plan import WINDOW_KEYS, FaultPlan, read_fault
from plant_emulator.faults.schedule import Schedule

STEP_S: Final = 0.01
"""Step of the plant: the shortest time that a fault can act."""
FIXED_KEYS: Final = (*WINDOW_KEYS, "seed")
"""Keys of a fault that a person cannot give, because the instants of the acts replace them."""

Tables = tuple[Mapping[str, Any], ...]


class ActError(Exception):
    """The act is impossible; the text says why in one sentence."""


def plan_by_hand(
    table: Mapping[str, Any],
    index: int,
    targets: FaultTargets,
    places: frozenset[FaultPlace],
) -> FaultPlan:
    """Check a fault that a person wants to start.

    Raises ActError.

    Args:
        places: places where this bench applies faults.
    """
    source = "faults"
    if not isinstance(table, Mapping):
        raise ActError(f"{table!r} is no table of a fault")
    if found := [key for key in FIXED_KEYS if key in table]:
        raise ActError(f"{found[0]}: the fault begins at once and ends by hand; leave the key out")
    try:
        plan = read_fault(table, index, source)
        check_fitting((plan,), targets, source)
    except SettingsError as error:
        raise ActError(re.sub(rf"^{source}: fault\[\d+\][.:] ?", "", str(error))) from error
    if plan.kind.place not in places:
        raise ActError(
            f"{plan.kind.name} acts on the {plan.kind.place.value}, which a run in real time does "
            "not touch; use --lockstep"
        )
    return plan


class FaultsByHand:
    """Passes a person's acts on to the schedule of the faults, and records them."""

    def __init__(
        self,
        acts: Callable[[], Iterable[str]],
        record: Callable[[str], None],
        targets: FaultTargets,
        places: frozenset[FaultPlace],
    ) -> None:
        """Args:
        acts: returns the acts since the last call, each a line of JSON.
        record: receives the whole record after each change.
        places: places where this bench applies faults.
        """
        self._acts, self._record = acts, record
        self._targets, self.places = targets, places
        self._tables: list[dict[str, Any]] = []
        self._open: set[int] = set()
        """Numbers of the faults that act."""

    def step(self, t_s: float, schedule: Schedule) -> None:
        """Apply the acts since the last step.

        Args:
            t_s: time of the run, in seconds.
        """
        lines = self._acts()
        if not lines:
            return
        for line in lines:
            try:
                self._apply(json.loads(line), t_s, schedule)
            except (ActError, ValueError, TypeError, KeyError):
                # The page checks each act before it passes it on, so this one has another source.
                continue
        self._record(record_text(self._tables))

    def _apply(self, act: Mapping[str, Any], t_s: float, schedule: Schedule) -> None:
        if "start" in act:
            self._start(act["start"], t_s, schedule)
        elif "stop" in act:
            self._stop(act["stop"], t_s, schedule)
        elif "set" in act:
            table, index = dict(act["values"]), act["set"]
            if index in self._open:
                new = {"kind": self._tables[index]["kind"], **table}
                plan_by_hand(new, len(self._tables), self._targets, self.places)
                self._stop(index, t_s, schedule)
                self._start(new, t_s, schedule)

    def _start(self, table: Mapping[str, Any], t_s: float, schedule: Schedule) -> None:
        index = len(self._tables)
        plan_by_hand(table, index, self._targets, self.places)
        timed = {"kind": table["kind"], "start_s": t_s, **table}
        schedule.add(read_fault(timed, index, "faults"))
        self._tables.append(timed)
        self._open.add(index)

    def _stop(self, index: int, t_s: float, schedule: Schedule) -> None:
        if index not in self._open:
            return
        self._open.remove(index)
        table = self._tables[index]
        # A fault that was started in this step acts for this step.
        end_s = max(t_s, round(table["start_s"] + STEP_S, 3))
        schedule.end(index, end_s)
        parameters = {key: value for key, value in table.items() if key not in ("kind", "start_s")}
        self._tables[index] = {
            "kind": table["kind"],
            "start_s": table["start_s"],
            "end_s": end_s,
            **parameters,
        }


def record_text(tables: Iterable[Mapping[str, Any]]) -> str:
    """Return the record as part of a scenario file."""
    return HEADER + tomli_w.dumps({"fault": list(tables)})


HEADER: Final = """\
# Faults that a person started and stopped; times count in seconds from the start of the train.
# `hil from-run` makes a scenario of them.

"""
