"""Finds a shipped scenario by its own name and makes a campaign of it alone."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from firmware_py import settings
from firmware_py.settings import SettingsError
from metro_hil.campaign.each import EACH, Numbered, scenarios_of
from metro_hil.campaign.plan import Campaign
from metro_hil.campaign.read import PACKAGE, define, read_campaign

CLOSE_MAX: Final = 5


@dataclass(frozen=True, slots=True)
class Named:
    """One scenario of a shipped campaign, as its file introduces it."""

    name: str
    campaign: str
    title: str
    requirements: tuple[str, ...]


def shipped_scenarios() -> tuple[Named, ...]:
    """All shipped scenarios, campaign by campaign in file order; their contents are not checked."""
    return tuple(
        Named(
            name=str(own.get("name", campaign)),
            campaign=campaign,
            title=str(own.get("title", table.get("title", ""))),
            requirements=(*table.get("requirements", ()), *own.get("requirements", ())),
        )
        for campaign in settings.shipped_names(PACKAGE)
        for table in (_shipped_table(campaign),)
        for own in ([own for _, _, own in scenarios_of(table)] if "scenario" in table else [{}])
    )


def read_named(
    name_or_path: str, seed: int | None = None, added: Sequence[Mapping[str, Any]] = ()
) -> Campaign:
    """A campaign by name or path, or a campaign of the one shipped scenario with this name.

    The own name of a scenario with `each` means all of its values.

    Args:
        seed: replaces all seeds. In a campaign it keeps only the scenarios that have this seed, or
            all of them if none has.
        added: tables of further scenarios, which inherit what stands above the campaign's own.

    Raises:
        CampaignError: with every problem of the file.
        SettingsError: if there is neither, with the nearest names.
    """
    campaigns = settings.shipped_names(PACKAGE)
    if name_or_path in campaigns or name_or_path.endswith(".toml") or "/" in name_or_path:
        if seed is None and not added:
            return read_campaign(name_or_path)
        path = settings.find(name_or_path, PACKAGE)
        table = dict(settings.parse(path))
        if added:
            table["scenario"] = [*table.get("scenario", ()), *added]
        if seed is not None:
            table = _with_seed(table, seed)
        return define(table, source=str(path), folder=path.parent, name=path.stem).campaign
    holders = [
        campaign
        for campaign in campaigns
        if any(name_or_path in (base, own.get("name")) for _, base, own in _scenarios(campaign))
    ]
    if not holders:
        raise SettingsError(f"{name_or_path}: no campaign and no scenario; {_hint(name_or_path)}")
    path = settings.find(holders[0], PACKAGE)
    table = _shipped_table(holders[0])
    table["scenario"] = [
        own for _, base, own in _scenarios(holders[0]) if name_or_path in (base, own.get("name"))
    ]
    table.pop(EACH, None)
    title = table["scenario"][0].get("title")
    if title is not None:
        table["title"] = title
    if seed is not None:
        table = _with_seed(table, seed)
    return define(table, source=str(path), folder=path.parent, name=name_or_path).campaign


def is_scenario(name: str) -> bool:
    """Whether the name is that of a shipped scenario and of no campaign."""
    known = settings.shipped_names(PACKAGE)
    return name not in known and any(each.name == name for each in shipped_scenarios())


def _with_seed(table: dict[str, Any], seed: int) -> dict[str, Any]:
    scenarios = table.get("scenario")
    if not isinstance(scenarios, list):
        return {**table, "seeds": [seed]}
    own = [each for each in scenarios if _has_seed({**table, **each}, seed)] or scenarios
    return {**table, "scenario": [{**each, "seeds": [seed]} for each in own]}


def _has_seed(table: Mapping[str, Any], seed: int) -> bool:
    seeds, base = table.get("seeds", 1), table.get("seed_base", 1)
    if isinstance(seeds, int) and isinstance(base, int):
        return base <= seed < base + seeds
    return isinstance(seeds, list) and seed in seeds


def _shipped_table(campaign: str) -> dict[str, Any]:
    path = Path(str(settings.find(campaign, PACKAGE)))
    table: Mapping[str, Any] = settings.parse(path)
    return dict(table)


def _scenarios(campaign: str) -> list[Numbered]:
    return scenarios_of(_shipped_table(campaign))


def _hint(name: str) -> str:
    """The nearest names; common parts of a name count as well as common letters."""
    import difflib

    known = [*settings.shipped_names(PACKAGE), *(each.name for each in shipped_scenarios())]
    words = set(name.lower().replace("_", "-").split("-"))
    shared = [each for each in known if words & set(each.split("-"))]
    close = [*difflib.get_close_matches(name, known, n=CLOSE_MAX), *shared]
    nearest = list(dict.fromkeys(close))[:CLOSE_MAX]
    found = f"nearest: {', '.join(nearest)}; " if nearest else ""
    return f"{found}`hil scenarios` lists all"
