"""Expands `each`: a scenario that stands for several, such as one for each control law."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

from firmware_py.settings import nearest
from metro_hil.campaign.problems import Findings
from metro_hil.campaign.schema import NAME

EACH: Final = "each"
WITH: Final = "with"
Numbered = tuple[int, str, Mapping[str, Any]]
"""Index in the file, name in the file, and the scenario itself."""


def scenarios_of(table: Mapping[str, Any], findings: Findings | None = None) -> list[Numbered]:
    """All scenarios of a file's table: first those with `each`, value by value, then the others.

    A scenario inherits `each` from the campaign unless it has its own; an empty one switches it
    off. The value becomes a factor of the sweep with one level, and is appended to the name. `with`
    adds further factors of one level for a value.

    Args:
        table: table of a whole file; other errors in it do not matter here.
        findings: takes errors in `each`; a scenario with such an error stays single.
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
        key, levels, more = each
        sweep = own.get("sweep", table.get("sweep", {}))
        for level in levels:
            factors = {key: level, **more.get(str(level), {})}
            made = {**bare, "name": f"{base}-{level}", "sweep": _with_factors(sweep, factors)}
            values.setdefault(level, []).append((index, base, made))
    return [*(one for group in values.values() for one in group), *alone]


def _with_factors(sweep: Any, added: Mapping[str, Any]) -> Any:
    """Put the added factors first, so that points keep their order."""
    if not isinstance(sweep, Mapping):
        return sweep
    factors = sweep.get("factors", {})
    if not isinstance(factors, Mapping):
        return sweep
    single = {key: [level] for key, level in added.items()}
    return {**sweep, "factors": {**single, **factors}}


def _checked(
    each: Any, where: str, findings: Findings
) -> tuple[str, Sequence[Any], Mapping[str, Mapping[str, Any]]] | None:
    """Key, values, and further factors of some values; None without `each`, or if it is wrong."""
    if each == {}:
        return None
    keys = [key for key in each if key != WITH] if isinstance(each, Mapping) else []
    if len(keys) != 1:
        findings.add(where, f"{each!r} is not a table of one key with a list of values")
        return None
    (key,) = keys
    levels, more = each[key], each.get(WITH, {})
    if not isinstance(levels, list) or not levels or len(set(map(str, levels))) < len(levels):
        findings.add(f"{where}.{key}", f"{levels!r} is not a list of different values")
        return None
    for level in levels:
        if not NAME.fullmatch(str(level)):
            findings.add(f"{where}.{key}", f"{level!r} cannot end the name of a scenario")
            return None
    if not isinstance(more, Mapping) or not all(isinstance(t, Mapping) for t in more.values()):
        findings.add(f"{where}.{WITH}", f"{more!r} is not a table of tables, one for a value")
        return None
    known = [str(level) for level in levels]
    for level in more:
        if level not in known:
            findings.add(f"{where}.{WITH}.{level}", nearest(level, known))
            return None
    return key, levels, more
