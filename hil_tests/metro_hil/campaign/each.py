"""Scenarios that are one for each of several values, such as one for each control law."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

from metro_hil.campaign.problems import Findings
from metro_hil.campaign.schema import NAME

EACH: Final = "each"
Numbered = tuple[int, str, Mapping[str, Any]]
"""Place in the file, name in the file, and the scenario itself."""


def scenarios_of(table: Mapping[str, Any], findings: Findings | None = None) -> list[Numbered]:
    """All scenarios that a file's table makes, value by value, then those that stand alone.

    A scenario takes `each` from above unless it has one of its own; an empty one keeps it single.
    The value is a factor of its sweep with one level, and ends its name.

    Args:
        table: of a whole file; what is wrong with it otherwise does not matter here.
        findings: takes what is wrong with `each`, and such a scenario stays single.
    """
    found = Findings() if findings is None else findings
    above = _checked(table.get(EACH, {}), EACH, found)
    values: dict[object, list[Numbered]] = {}
    alone: list[Numbered] = []
    for index, own in enumerate(table.get("scenario", [])):
        if not isinstance(own, Mapping):
            continue
        each = above
        if EACH in own:
            each = _checked(own[EACH], f"scenario[{index}].{EACH}", found)
        bare = {name: value for name, value in own.items() if name != EACH}
        base = str(own.get("name", ""))
        if each is None or "name" not in own:
            alone.append((index, base, bare))
            continue
        key, levels = each
        sweep = own.get("sweep", table.get("sweep", {}))
        for level in levels:
            made = {**bare, "name": f"{base}-{level}", "sweep": _with_factor(sweep, key, level)}
            values.setdefault(level, []).append((index, base, made))
    return [*(one for group in values.values() for one in group), *alone]


def _with_factor(sweep: Any, key: str, level: Any) -> Any:
    """First of all factors, so that points keep their order."""
    if not isinstance(sweep, Mapping):
        return sweep
    factors = sweep.get("factors", {})
    return (
        {**sweep, "factors": {key: [level], **factors}} if isinstance(factors, Mapping) else sweep
    )


def _checked(each: Any, where: str, findings: Findings) -> tuple[str, Sequence[Any]] | None:
    """The key and its values; None where there is none, or where they are wrong."""
    if each == {}:
        return None
    if not isinstance(each, Mapping) or len(each) != 1:
        findings.add(where, f"{each!r} is not a table of one key with a list of values")
        return None
    ((key, levels),) = each.items()
    if not isinstance(levels, list) or not levels or len(set(map(str, levels))) < len(levels):
        findings.add(f"{where}.{key}", f"{levels!r} is not a list of different values")
        return None
    for level in levels:
        if not NAME.fullmatch(str(level)):
            findings.add(f"{where}.{key}", f"{level!r} cannot end the name of a scenario")
            return None
    return key, levels
