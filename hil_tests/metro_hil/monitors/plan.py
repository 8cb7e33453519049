"""Monitors of a scenario and how they are read: invariants, formulas and measures."""

import functools
import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any, Final

from firmware_py.settings import SettingsError, nearest
from metro_hil.model.case import Case
from metro_hil.monitors.catalogue import INVARIANTS, WATCHED, Invariant
from metro_hil.monitors.constant import refuse_constant
from metro_hil.monitors.reading import FormulaError
from metro_hil.monitors.stl import Formula
from metro_hil.monitors.vocabulary import BOOLEANS, NAMES

NAME_MAX: Final = 60
REQUIREMENT: Final = re.compile(r"[A-Z][A-Z0-9]*-[A-Za-z0-9-]+")


class MonitorKind(Enum):
    INVARIANT = "invariant"
    STL = "stl"
    MEASURE = "measure"


class Severity(Enum):
    """Effect of a violation on the run; the case fails with either."""

    STOP = "stop"
    """The violation ends the run if the case stops at violations."""
    CONTINUE = "continue"
    """The run goes on."""


@dataclass(frozen=True, slots=True)
class MonitorPlan:
    """One monitor of a case."""

    name: str
    """Unique within the case."""
    kind: MonitorKind
    text: str
    """Name of the invariant, formula, or name of the measure."""
    unit: str = ""
    requirements: tuple[str, ...] = ()
    limits: tuple[float | None, float | None] = (None, None)
    """Minimum and maximum of a measure, both inclusive."""
    severity: Severity = Severity.STOP
    asked: bool = True
    """Whether the file names the monitor. An invariant from `all` may be vacuous."""
    own: bool = True
    """Whether the monitor stands under `[[monitor]]` or in a list of invariants by name."""


COMMON: Final = ("name", "unit", "requirements", "severity")
KEYS: Final = {
    MonitorKind.INVARIANT: ("invariant", "requirements", "severity", "name"),
    MonitorKind.STL: ("stl", *COMMON),
    MonitorKind.MEASURE: ("measure", "min", "max", *COMMON),
}


ALL: Final = "all"
"""Selects every invariant that is watched."""


def plans_of(case: Case) -> tuple[MonitorPlan, ...]:
    """Return the monitors of a case; one that is expected to fail never ends the run."""
    expected = {each.monitor for each in case.expected}
    return tuple(
        replace(plan, severity=Severity.CONTINUE) if plan.name in expected else plan
        for plan in read_monitors(case.monitors, case.id, case.invariants)
    )


def read_monitors(
    tables: Sequence[Mapping[str, Any]],
    source: str,
    invariants: object = "all",
    measures: Collection[str] | None = None,
) -> tuple[MonitorPlan, ...]:
    """Read the `[[monitor]]` tables of a scenario; its invariants come first.

    Args:
        source: file or case that errors name.
        invariants: `all`, `none`, or a list of names and numbers.
        measures: known names, in which `*` stands for any part. With None the function checks
            neither names nor whether a run can decide a monitor.

    Raises:
        SettingsError: with source, key, value and the nearest valid value.
    """
    plans = list(_standing(invariants, source))
    for index, table in enumerate(tables):
        where = f"{source}: monitor[{index}]" if source else f"monitor[{index}]"
        if table.get("invariant") == ALL:
            plans = _owned(plans, table, where)
            continue
        for plan in _read(table, where, measures):
            if plan.kind is MonitorKind.INVARIANT:
                # An invariant that is named replaces the one from `all`.
                plans = [each for each in plans if each.asked or each.text != plan.text]
            if any(each.name == plan.name for each in plans):
                raise SettingsError(f"{where}.name: {plan.name!r} is the name of two monitors")
            plans.append(plan)
    return tuple(plans)


def _owned(plans: Sequence[MonitorPlan], table: Mapping[str, Any], where: str) -> list[MonitorPlan]:
    """Make all watched invariants the scenario's own, so that they cover its requirements."""
    _refuse_unknown(table, ("invariant", "requirements", "severity"), where)
    added, severity = _requirements(table, where), _severity(table, where)
    made = [
        replace(plan, own=True, requirements=(*plan.requirements, *added), severity=severity)
        if plan.kind is MonitorKind.INVARIANT
        else plan
        for plan in plans
    ]
    if not any(plan.kind is MonitorKind.INVARIANT for plan in made):
        raise SettingsError(f"{where}.invariant: 'all': invariants is 'none', so there is none")
    return made


def _refuse_unknown(table: Mapping[str, Any], known: Sequence[str], where: str) -> None:
    for key in table:
        if key not in known:
            hint = nearest(key, list(known), "key")
            raise SettingsError(f"{where}.{key}: unknown key; {hint}")


def _standing(invariants: object, source: str) -> Sequence[MonitorPlan]:
    if invariants == ALL:
        return _all_standing()
    if invariants == "none":
        return []
    where = f"{source}: invariants" if source else "invariants"
    if isinstance(invariants, str | bytes) or not isinstance(invariants, Sequence):
        raise SettingsError(
            f"{where}: {invariants!r} is neither 'all', 'none' nor a list of names and numbers"
        )
    found: dict[str, MonitorPlan] = {}
    for wanted in invariants:
        for each in _invariants(wanted, where):
            found[each.name] = _of_invariant(each)
    return list(found.values())


@functools.cache
def _all_standing() -> Sequence[MonitorPlan]:
    """Thousands of cases share these values, which never change."""
    return tuple(replace(_of_invariant(each), asked=False, own=False) for each in WATCHED)


def _of_invariant(each: Invariant) -> MonitorPlan:
    return MonitorPlan(
        name=each.name,
        kind=MonitorKind.INVARIANT,
        text=each.name,
        unit=each.unit,
        requirements=(each.requirement,),
    )


def _invariants(wanted: object, where: str) -> Sequence[Invariant]:
    """Return the invariants of a full name or a number: 30, "30", "inv-30" or "INV-30"."""
    found = invariants_named(wanted)
    watched = [each for each in found if each.watched]
    if watched:
        return watched
    if found:
        raise SettingsError(f"{where}: {wanted!r} is not watched: {found[0].why_not}")
    raise SettingsError(f"{where}: {wanted!r}: {nearest(str(wanted), _known())}")


def invariants_named(wanted: object) -> Sequence[Invariant]:
    """Return the invariants of a name or number; none for other values."""
    if isinstance(wanted, bool) or not isinstance(wanted, str | int):
        return []
    word = str(wanted).lower()
    number = word.removeprefix("inv-")
    if number.isdecimal():
        return [each for each in INVARIANTS if each.number == int(number)]
    return [each for each in INVARIANTS if each.name == word]


def _known() -> list[str]:
    return [each.name for each in WATCHED]


def _read(
    table: Mapping[str, Any], where: str, measures: Collection[str] | None
) -> Sequence[MonitorPlan]:
    kinds = [kind for kind in MonitorKind if kind.value in table]
    if len(kinds) != 1:
        words = " and ".join(kind.value for kind in kinds)
        stands = f"{words} exclude each other" if kinds else "it has none of them"
        known = [*(kind.value for kind in MonitorKind)]
        raise SettingsError(f"{where}: wants one of {', '.join(known)}; {stands}")
    kind = kinds[0]
    _refuse_unknown(table, KEYS[kind], where)
    if kind is MonitorKind.INVARIANT:
        return _read_invariant(table, where)
    if kind is MonitorKind.STL:
        return [_read_formula(table, where, decidable=measures is not None)]
    return [_read_measure(table, where, measures)]


def _read_invariant(table: Mapping[str, Any], where: str) -> Sequence[MonitorPlan]:
    found = _invariants(table["invariant"], f"{where}.invariant")
    if "name" in table and len(found) > 1:
        names = ", ".join(each.name for each in found)
        raise SettingsError(f"{where}.name: {table['name']!r} would be that of {names}")
    return [
        MonitorPlan(
            name=_text(table, "name", where, each.name),
            kind=MonitorKind.INVARIANT,
            text=each.name,
            unit=each.unit,
            requirements=(each.requirement, *_requirements(table, where)),
            severity=_severity(table, where),
        )
        for each in found
    ]


def _read_formula(table: Mapping[str, Any], where: str, *, decidable: bool) -> MonitorPlan:
    """`decidable` rejects a formula whose result does not depend on the run."""
    text = _text(table, "stl", where, "")
    try:
        Formula(text, NAMES, BOOLEANS)
        if decidable:
            refuse_constant(text)
    except FormulaError as error:
        raise SettingsError(f"{where}.stl: {error}") from error
    return MonitorPlan(
        name=_text(table, "name", where, text if len(text) <= NAME_MAX else f"{text[:NAME_MAX]}…"),
        kind=MonitorKind.STL,
        text=text,
        unit=_text(table, "unit", where, "1"),
        requirements=_requirements(table, where),
        severity=_severity(table, where),
    )


def _read_measure(
    table: Mapping[str, Any], where: str, measures: Collection[str] | None
) -> MonitorPlan:
    measure = _text(table, "measure", where, "")
    if measures is not None and not any(_matches(measure, known) for known in measures):
        raise SettingsError(
            f"{where}.measure: {measure!r}: {nearest(measure, sorted(measures), 'measure')}"
        )
    low, high = _number(table, "min", where), _number(table, "max", where)
    if low is None and high is None:
        raise SettingsError(f"{where}: a measure wants min or max or both")
    if low is not None and high is not None and low > high:
        raise SettingsError(f"{where}.min: {low:g} is over max, {high:g}")
    if measures is not None:
        _refuse_limits(measure, low, high, where)
    ends = [f"{low:g} <=" if low is not None else "", f"<= {high:g}" if high is not None else ""]
    return MonitorPlan(
        name=_text(table, "name", where, " ".join([ends[0], measure, ends[1]]).strip()),
        kind=MonitorKind.MEASURE,
        text=measure,
        unit=_text(table, "unit", where, _unit_of(measure)),
        requirements=_requirements(table, where),
        limits=(low, high),
        severity=_severity(table, where),
    )


SIGNED: Final = ("front_end_m", "stop_*_error_m")
"""Measures that may be negative."""
MOST: Final = {"arrived_count": 1.0, "bus_load_ratio": 1.0}
"""Upper bound of measures that have one."""


def _refuse_limits(measure: str, low: float | None, high: float | None, where: str) -> None:
    """Raise SettingsError for limits that no run can violate."""
    least = -math.inf if any(_matches(measure, each) for each in SIGNED) else 0.0
    most = MOST.get(measure, math.inf)
    if (low is None or low <= least) and (high is None or high >= most):
        key, value = ("min", low) if high is None else ("max", high)
        bound = f"less than {least:g}" if high is None else f"more than {most:g}"
        raise SettingsError(
            f"{where}.{key}: {value:g}: {measure} is never {bound}, so no run can violate it"
        )


def _matches(name: str, pattern: str) -> bool:
    """Match a name; `*` in the pattern stands for one or more characters."""
    return re.fullmatch(".+".join(re.escape(part) for part in pattern.split("*")), name) is not None


_UNITS: Final = {
    "mps": "m/s",
    "mps2": "m/s²",
    "mps3": "m/s³",
    "m": "m",
    "s": "s",
    "ms": "ms",
    "us": "µs",
    "n": "N",
    "kwh": "kWh",
    "percent": "%",
}


def _unit_of(measure: str) -> str:
    return _UNITS.get(measure.rsplit("_", 1)[-1], "1")


def _text(table: Mapping[str, Any], key: str, where: str, default: str) -> str:
    value = table.get(key, default)
    if not isinstance(value, str) or not value.strip():
        raise SettingsError(f"{where}.{key}: {value!r} is not text")
    return value.strip()


def _number(table: Mapping[str, Any], key: str, where: str) -> float | None:
    value = table.get(key)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or value != value:
        raise SettingsError(f"{where}.{key}: {value!r} is not a number")
    return float(value)


def _requirements(table: Mapping[str, Any], where: str) -> tuple[str, ...]:
    value = table.get("requirements", [])
    if isinstance(value, str) or not isinstance(value, Sequence):
        raise SettingsError(f"{where}.requirements: {value!r} is not a list of ids")
    for name in value:
        if not isinstance(name, str) or not REQUIREMENT.fullmatch(name):
            raise SettingsError(f"{where}.requirements: {name!r} is not an id such as INV-04")
    return tuple(value)


def _severity(table: Mapping[str, Any], where: str) -> Severity:
    value = table.get("severity", Severity.STOP.value)
    known = [each.value for each in Severity]
    if value not in known:
        raise SettingsError(f"{where}.severity: {value!r}: {nearest(str(value), known)}")
    return Severity(value)
