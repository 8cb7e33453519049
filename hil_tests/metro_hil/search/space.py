"""The space that a scenario's sweep spans, and the cases at its points."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import msgspec

from firmware_py.expression import compile_expression
from firmware_py.settings import SettingsError, nearest
from metro_hil.campaign.definition import Body, PointMaker
from metro_hil.campaign.designs import exclusion, expression_names
from metro_hil.campaign.factors import Factor
from metro_hil.campaign.plan import ScenarioPlan, case_of
from metro_hil.campaign.problems import Findings
from metro_hil.campaign.read import Definition
from metro_hil.model.case import Case, ConfigTable


class SearchError(SettingsError):
    """An impossible search; the text names option and value."""


@dataclass(frozen=True, slots=True)
class Sample:
    """One valid point of the space, with a case for each seed."""

    number: int
    values: dict[str, Any]
    cases: tuple[Case, ...]


class SearchSpace:
    """Maps points of the unit cube, with one share for each factor, to cases."""

    def __init__(
        self, plan: ScenarioPlan, body: Body, factors: Sequence[Factor], exclude: Sequence[str]
    ) -> None:
        self.plan = plan
        self.body = body
        self.factors = tuple(factors)
        self._refused = exclusion(exclude, factors)
        self._maker = PointMaker(body, [factor.key for factor in factors], Findings())

    def values(self, shares: Sequence[float]) -> dict[str, Any]:
        return {
            factor.key: factor.searched(share)
            for factor, share in zip(self.factors, shares, strict=True)
        }

    def sample(self, number: int, values: dict[str, Any]) -> Sample | None:
        """The cases of a point; None for values that do not fit together.

        Runs continue after a violation, because otherwise all violations would look alike.
        """
        if self._refused(values):
            return None
        point = self._maker.point(number, values, Findings())
        if point is None:
            return None
        cases = tuple(
            msgspec.structs.replace(case_of(self.plan, point, seed, 0), stop_at_violation=False)
            for seed in self.plan.seeds
        )
        return Sample(number, dict(point.factors), cases)

    def table(self, values: dict[str, Any]) -> ConfigTable:
        """The scenario with these values as a table of a file, without its sweep."""
        table = self.body.with_values(values).raw
        return {name: value for name, value in table.items() if name != "sweep"}


def space_of(
    definition: Definition, scenario: str | None = None, keys: Sequence[str] = ()
) -> SearchSpace:
    """The space of one scenario, by default of the only one with a sweep.

    Args:
        keys: swept keys that may vary; the others stay as in the scenario. Empty means all.

    Raises SearchError.
    """
    campaign = definition.campaign
    swept = [
        plan.name
        for plan, factors in zip(campaign.scenarios, definition.factors, strict=True)
        if factors
    ]
    if not swept:
        raise SearchError(f"{campaign.name}: no scenario has a sweep, so there is nothing to vary")
    if scenario is None and len(swept) > 1:
        raise SearchError(f"--scenario: one of {', '.join(swept)} has to be named")
    name = swept[0] if scenario is None else scenario
    if name not in swept:
        raise SearchError(f"--scenario {name}: {nearest(name, swept, 'scenario')}")
    place = [plan.name for plan in campaign.scenarios].index(name)
    factors = definition.factors[place]
    known = [factor.key for factor in factors]
    for key in keys:
        if key not in known:
            raise SearchError(f"--factors {key}: {nearest(key, known, 'factor')}")
    chosen = [factor for factor in factors if not keys or factor.key in keys]
    body = definition.bodies[place]
    return SearchSpace(campaign.scenarios[place], body, chosen, _exclusions(body, factors, chosen))


def _exclusions(body: Body, factors: Sequence[Factor], chosen: Sequence[Factor]) -> list[str]:
    """Exclusions that name only varied factors; ambiguous names are resolved as in the sweep."""
    names = expression_names(factors)
    kept = {factor.key for factor in chosen}
    texts: list[str] = body.raw.get("sweep", {}).get("exclude", [])
    return [
        text
        for text in texts
        if {names[name] for name in compile_expression(text, list(names)).names} <= kept
    ]
