"""A scenario defined in Python, with the keys of a campaign file and the same cases."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from enum import Enum
from pathlib import Path
from typing import Any

import msgspec

from metro_hil.campaign.plan import Campaign, plan_cases
from metro_hil.campaign.read import define
from metro_hil.campaign.tables import copied
from metro_hil.model.case import Case

Table = Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """The keys of one scenario in a campaign file; a key that is left out has its default.

    Tables are dictionaries, and arrays of tables are sequences of them. Thus

        Scenario(name="hop", train={"end": "I"}, fault=[{"kind": "tacho_stuck", "start_s":
        20.0}])

    equals a file with `name`, `[train]` and `[[fault]]`.

    """

    name: str = "scenario"
    title: str | None = None
    description: str | None = None
    requirements: Sequence[str] | None = None
    bench: str | Enum | None = None
    seeds: int | Sequence[int] | None = None
    seed_base: int | None = None
    expected: Table | Sequence[Table] | None = None
    vacuous: Table | Sequence[Table] | None = None
    stop_at_violation: bool | None = None
    idle_counts: bool | None = None
    invariants: str | Sequence[str] | None = None
    train: Table = field(default_factory=dict)
    timetable: Table = field(default_factory=dict)
    controller: Table = field(default_factory=dict)
    plant: Table = field(default_factory=dict)
    branch: Table | None = None
    fault: Sequence[Table] = ()
    monitor: Sequence[Table] = ()
    sweep: Table = field(default_factory=dict)

    def table(self) -> dict[str, Any]:
        """The scenario as a table of a campaign file."""
        values = ((item.name, getattr(self, item.name)) for item in fields(self))
        given = {name: value for name, value in values if value is not None}
        made: dict[str, Any] = copied(msgspec.to_builtins(given))
        return made

    def campaign(self, folder: Path | None = None) -> Campaign:
        """A campaign of this scenario alone. Raises CampaignError with every problem.

        Args:
            folder: start of relative paths of line and train files; None for the working directory.
        """
        where = Path() if folder is None else folder
        source = f"Scenario {self.name}"
        return define(self.table(), source=source, folder=where, name=self.name).campaign

    def cases(self, folder: Path | None = None) -> tuple[Case, ...]:
        """The cases of the scenario. Raises CampaignError."""
        return plan_cases(self.campaign(folder))
