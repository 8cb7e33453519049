"""Reads what a scenario claims: its expected failures, and its parts that may show nothing."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

from firmware_py.settings import nearest, unknown_key
from metro_hil.campaign.plan import SweepPoint
from metro_hil.campaign.problems import Findings
from metro_hil.model.case import ALLOWANCE_GROUPS, Allowance, ExpectedFailure
from metro_hil.monitors import read_monitors

EXPECTED: Final = "expected"
VACUOUS: Final = "vacuous"
EXPECTED_FORM: Final = 'expected = { fails = "NAME OF THE MONITOR" }'
VACUOUS_FORM: Final = 'vacuous = { allowed = "NAME", reason = "WHY" }'
MARGINS: Final = ("margin_min", "margin_max")


def read_expected(table: Mapping[str, Any], findings: Findings) -> tuple[ExpectedFailure, ...]:
    """The monitors that are expected to fail; the default, `pass`, names none."""
    value = table.get(EXPECTED, "pass")
    if value == "pass":
        return ()
    if isinstance(value, str):
        findings.add(EXPECTED, f"{value!r} names no monitor; write {EXPECTED_FORM}")
        return ()
    found: list[ExpectedFailure] = []
    for key, each in _tables(value, EXPECTED, EXPECTED_FORM, findings):
        _refuse_unknown(each, key, ("fails", *MARGINS), findings)
        names = _names(each.get("fails"), f"{key}.fails", EXPECTED_FORM, findings)
        low, high = (_number(each, name, key, findings) for name in MARGINS)
        if low is not None and high is not None and low > high:
            findings.add(f"{key}.margin_min", f"{low:g} is over margin_max, {high:g}")
        for name, margin in zip(MARGINS, (low, high), strict=True):
            if margin is not None and margin >= 0.0:
                findings.add(
                    f"{key}.{name}", f"{margin:g} is no failure; failures have margins below 0"
                )
        found += [ExpectedFailure(monitor=name, margin_min=low, margin_max=high) for name in names]
    return tuple(found)


def read_vacuous(table: Mapping[str, Any], findings: Findings) -> tuple[Allowance, ...]:
    """The parts that may show nothing, each with a reason that the reports print."""
    if VACUOUS not in table:
        return ()
    value = table[VACUOUS]
    if isinstance(value, str):
        findings.add(VACUOUS, f"{value!r} says neither what nor why; write {VACUOUS_FORM}")
        return ()
    found: list[Allowance] = []
    for key, each in _tables(value, VACUOUS, VACUOUS_FORM, findings):
        _refuse_unknown(each, key, ("allowed", "reason"), findings)
        names = _names(each.get("allowed"), f"{key}.allowed", VACUOUS_FORM, findings)
        reason = each.get("reason")
        if isinstance(reason, str) and reason.strip():
            found.append(Allowance(names=names, reason=reason.strip()))
        else:
            findings.add(f"{key}.reason", f"{reason!r} is no reason; write {VACUOUS_FORM}")
    return tuple(found)


def check_claims(
    expected: Sequence[ExpectedFailure],
    vacuous: Sequence[Allowance],
    points: Sequence[SweepPoint],
    *,
    invariants: str | tuple[str, ...],
    requirements: Sequence[str],
    findings: Findings,
) -> None:
    """Report every claimed name that no monitor, or other part that counts, of the scenario has."""
    # Most points differ in values only, not in the names that a claim can use.
    tables: object = None
    monitors: list[str] = []
    seen: list[object] = []
    for point in points if expected or vacuous else ():
        kinds = sorted({str(fault.get("kind")) for fault in point.faults})
        if point.monitors == tables and kinds in seen:
            continue
        if point.monitors != tables:
            tables, seen = point.monitors, []
            monitors = [plan.name for plan in read_monitors(point.monitors, "", invariants)]
        seen.append(kinds)
        for each in expected:
            _refuse_unknown_name(each.monitor, monitors, f"{EXPECTED}.fails", "monitor", findings)
        known = [*monitors, *kinds, *requirements, *ALLOWANCE_GROUPS]
        for name in (name for allowance in vacuous for name in allowance.names):
            what = "monitor, fault, requirement or group"
            _refuse_unknown_name(name, known, f"{VACUOUS}.allowed", what, findings)


def _refuse_unknown_name(
    name: str, known: Sequence[str], key: str, what: str, findings: Findings
) -> None:
    if name not in known:
        hint = nearest(name, list(known), what.partition(",")[0]) if known else "there is none"
        findings.add(key, f"{name!r} is no {what} of this scenario; {hint}")


def _tables(
    value: Any, key: str, form: str, findings: Findings
) -> list[tuple[str, Mapping[str, Any]]]:
    if isinstance(value, dict):
        return [(key, value)]
    if isinstance(value, list) and value and all(isinstance(each, dict) for each in value):
        return [(f"{key}[{index}]", each) for index, each in enumerate(value)]
    findings.add(key, f"{value!r} is neither a table nor a list of them; write {form}")
    return []


def _refuse_unknown(
    table: Mapping[str, Any], key: str, known: Sequence[str], findings: Findings
) -> None:
    for name in table:
        if name not in known:
            findings.add(f"{key}.{name}", unknown_key(name, list(known)))


def _names(value: Any, key: str, form: str, findings: Findings) -> tuple[str, ...]:
    names = value if isinstance(value, list) else [value]
    if names and all(isinstance(name, str) and name.strip() for name in names):
        return tuple(name.strip() for name in names)
    findings.add(key, "missing key" if value is None else f"{value!r} is no name; write {form}")
    return ()


def _number(table: Mapping[str, Any], name: str, key: str, findings: Findings) -> float | None:
    value = table.get(name)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float):
        findings.add(f"{key}.{name}", f"{value!r} is not a number")
        return None
    return float(value)
