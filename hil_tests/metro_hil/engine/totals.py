"""Totals of a campaign: counts by verdict, and whether every case is as expected.

A missing, doubled or foreign result always makes the campaign fail. Pure.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Final

import msgspec

from metro_hil.engine.journal import same_result
from metro_hil.model.case import Case, CaseResult, Verdict, as_expected

NAMED_MAX: Final = 5


class Totals(msgspec.Struct, frozen=True, kw_only=True):
    """Totals over all results of a campaign."""

    cases: int
    """Number of cases that the manifest names."""
    done: int
    """Cases with a result."""
    counts: dict[str, int]
    """Number of cases with a result, for every verdict."""
    unexpected: tuple[str, ...]
    """Ids of the cases with an unexpected result, in order."""
    missing: tuple[str, ...]
    """Ids of the cases without a result, in order."""
    problems: tuple[str, ...]
    """Reasons, as text, why the totals cannot be trusted."""
    passed: bool


def total(
    cases_expected: int,
    cases: Sequence[Case],
    results: Sequence[CaseResult],
    problems: Sequence[str] = (),
) -> Totals:
    """Count the results.

    Args:
        cases_expected: number of cases that the manifest names.
        cases: cases of the campaign's folder.
        results: all lines of the journal; equal ones for one case count once.
        problems: faults of the folder that are known already.
    """
    found = [*problems, *_faults(cases_expected, cases, results)]
    by_id: dict[str, CaseResult] = {}
    for result in results:
        by_id.setdefault(result.case_id, result)
    counts: Counter[str] = Counter()
    unexpected, missing = [], []
    for case in sorted(cases, key=lambda case: case.index):
        known = by_id.get(case.id)
        if known is None:
            missing.append(case.id)
            continue
        counts[known.verdict.value] += 1
        if not as_expected(case, known):
            unexpected.append(case.id)
    return Totals(
        cases=cases_expected,
        done=len(cases) - len(missing),
        counts={verdict.value: counts[verdict.value] for verdict in Verdict},
        unexpected=tuple(unexpected),
        missing=tuple(missing),
        problems=tuple(found),
        passed=not (found or unexpected or missing),
    )


def counts_words(counts: Mapping[str, int], missing: int) -> str:
    """Text such as `pass 8, fail 1, missing 3`; a case that has not run is missing, not lost."""
    shown = {**counts, "missing": missing}
    return ", ".join(f"{name} {count}" for name, count in shown.items() if count)


def _faults(cases_expected: int, cases: Sequence[Case], results: Sequence[CaseResult]) -> list[str]:
    faults = []
    ids = Counter(case.id for case in cases)
    if cases_expected == 0 or not cases:
        faults.append("there is no case, so nothing was shown")
    if len(cases) != cases_expected:
        faults.append(f"{len(cases)} cases, but the manifest names {cases_expected}")
    if doubled := [name for name, count in ids.items() if count > 1]:
        faults.append(f"case ids that occur twice: {_some(doubled)}")
    if foreign := sorted({result.case_id for result in results} - ids.keys()):
        faults.append(f"results of cases that are not in the campaign: {_some(foreign)}")
    if doubtful := _contradictions(results):
        faults.append(f"cases with results that differ from each other: {_some(doubtful)}")
    return faults


def _contradictions(results: Sequence[CaseResult]) -> list[str]:
    first: dict[str, CaseResult] = {}
    return [
        result.case_id
        for result in results
        if not same_result(first.setdefault(result.case_id, result), result)
    ]


def _some(names: Sequence[str]) -> str:
    shown = ", ".join(names[:NAMED_MAX])
    return shown if len(names) <= NAMED_MAX else f"{shown} and {len(names) - NAMED_MAX} more"
