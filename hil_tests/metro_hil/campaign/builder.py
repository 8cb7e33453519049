"""A scenario in Python: the same keys as in a campaign file, and the same cases."""

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
    """What a campaign file says of one scenario; what is left out is left to its default.

    Tables are dictionaries and arrays of tables are sequences of them, so that

        Scenario(name="hop", train={"end": "I"}, fault=[{"kind": "tacho_stuck", "start_s": 20.0}])

    is the file with `name`, `[train]` and `[[fault]]`.
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
    branch: Table | None = None
    fault: Sequence[Table] = ()
    monitor: Sequence[Table] = ()
    sweep: Table = field(default_factory=dict)

    def table(self) -> dict[str, Any]:
        """As the file would have it."""
        values = ((item.name, getattr(self, item.name)) for item in fields(self))
        given = {name: value for name, value in values if value is not None}
        made: dict[str, Any] = copied(msgspec.to_builtins(given))
        return made

    def campaign(self, folder: Path | None = None) -> Campaign:
        """The campaign of this scenario alone; raises CampaignError with all that is wrong.

        Args:
            folder: where relative paths of line and train files start; None for the one of work.
        """
        where = Path() if folder is None else folder
        source = f"Scenario {self.name}"
        return define(self.table(), source=source, folder=where, name=self.name).campaign

    def cases(self, folder: Path | None = None) -> tuple[Case, ...]:
        """Raises CampaignError."""
        return plan_cases(self.campaign(folder))
