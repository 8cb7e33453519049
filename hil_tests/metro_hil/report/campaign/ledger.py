"""Joins cases with their results, and finds what is missing."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import msgspec

from metro_hil.model.case import (
    BenchKind,
    Case,
    CaseResult,
    Host,
    MonitorResult,
    Verdict,
    as_expected,
    mismatch,
)

LACKING_RESULT: Final = "no result came back"
MISSING: Final = "missing"
"""Word for a case without a result, beside the verdicts."""
WORSE_LATER: Final = (
    *(Verdict.LOST, Verdict.PASS, Verdict.VACUOUS, Verdict.INCONCLUSIVE),
    *(Verdict.BLOCKED, Verdict.INVALID, Verdict.FAIL),
)
CONTRADICTION: Final = "two results of the same case differ: the run is not a function of its case"


@dataclass(frozen=True, slots=True)
class LedgerEntry:
    """One case and its result, if any, without data about the host."""

    case: Case
    result: CaseResult | None

    @property
    def missing(self) -> bool:
        return self.result is None

    @property
    def verdict(self) -> Verdict:
        """The verdict; `LOST` for a missing case."""
        return Verdict.LOST if self.result is None else self.result.verdict

    @property
    def word(self) -> str:
        """The verdict as a word, or `missing`."""
        return MISSING if self.result is None else self.result.verdict.value

    @property
    def as_expected(self) -> bool:
        """Whether the result is as expected; a missing case never is."""
        return self.result is not None and as_expected(self.case, self.result)

    @property
    def reason(self) -> str:
        if self.result is None:
            return LACKING_RESULT
        if self.as_expected and self.case.expected:
            return f"as expected: {self.result.reason}"
        return mismatch(self.case, self.result) or self.result.reason

    def monitors(self) -> tuple[MonitorResult, ...]:
        return () if self.result is None else self.result.monitors

    def measures(self) -> Mapping[str, float | None]:
        return {} if self.result is None else self.result.measures


@dataclass(frozen=True, slots=True)
class Remark:
    """A reason shared by cases that are as expected but no plain passes."""

    text: str
    first_case: str
    cases: int

    @property
    def where(self) -> str:
        return (
            self.first_case if self.cases == 1 else f"{self.first_case} and {self.cases - 1} more"
        )


@dataclass(frozen=True, slots=True)
class Ledger:
    """All cases of a campaign in its order."""

    entries: tuple[LedgerEntry, ...]
    unlisted: int
    """Number of cases that the manifest counts but does not name; they are missing as well."""
    stray: tuple[str, ...]
    """Ids of results that belong to no case."""

    @property
    def expected_cases(self) -> int:
        return len(self.entries) + self.unlisted

    @property
    def missing(self) -> int:
        return self.unlisted + sum(entry.missing for entry in self.entries)

    @property
    def as_expected(self) -> int:
        return sum(entry.as_expected for entry in self.entries)

    @property
    def good(self) -> bool:
        """Whether all cases are as expected; a campaign without cases is not good."""
        return 0 < self.expected_cases == self.as_expected and not self.stray

    def remarks(self) -> list["Remark"]:
        """Reasons why cases that are as expected are no plain passes, each once."""
        cases: dict[str, list[str]] = {}
        for entry in self.entries:
            if entry.as_expected and entry.reason:
                cases.setdefault(entry.reason, []).append(entry.case.id)
        return [Remark(text, ids[0], len(ids)) for text, ids in cases.items()]

    def counts(self) -> dict[str, int]:
        """Number of cases by verdict and `missing`, in the order of the verdicts, including
        zeros."""
        found = Counter(entry.word for entry in self.entries)
        found[MISSING] += self.unlisted
        return {word: found[word] for word in (*(v.value for v in Verdict), MISSING)}

    def scenarios(self) -> dict[str, tuple[LedgerEntry, ...]]:
        """Entries by scenario, in the order of their first cases."""
        groups: dict[str, list[LedgerEntry]] = {}
        for entry in self.entries:
            groups.setdefault(entry.case.scenario, []).append(entry)
        return {name: tuple(group) for name, group in groups.items()}


def join(cases: Sequence[Case], results: Sequence[CaseResult], *, expected_cases: int) -> Ledger:
    """Join in the order of the campaign, independent of the order of arrival.

    If a case has several results, a result replaces a lost attempt. In virtual time two different
    results make the case `INVALID`, because its outcome is not reproducible. In real time, where no
    two runs are equal, the worse one counts.
    """
    lockstep = {case.id for case in cases if case.bench is BenchKind.LOCKSTEP}
    by_id: dict[str, CaseResult] = {}
    for result in results:
        bare = msgspec.structs.replace(result, host=Host())
        known = by_id.get(result.case_id)
        by_id[result.case_id] = (
            bare if known is None else _one_of(known, bare, result.case_id in lockstep)
        )
    ordered = sorted(cases, key=lambda case: (case.index, case.id))
    named = {case.id for case in ordered}
    return Ledger(
        entries=tuple(LedgerEntry(case, by_id.get(case.id)) for case in ordered),
        unlisted=max(0, expected_cases - len(ordered)),
        stray=tuple(sorted(case_id for case_id in by_id if case_id not in named)),
    )


def _one_of(known: CaseResult, other: CaseResult, lockstep: bool) -> CaseResult:
    """The result that counts, independent of the order."""
    if known == other or other.verdict is Verdict.LOST:
        return known
    if known.verdict is Verdict.LOST:
        return other
    if not lockstep:
        return max(known, other, key=_badness)
    return CaseResult(
        case_id=known.case_id,
        index=min(known.index, other.index),
        verdict=Verdict.INVALID,
        reason=CONTRADICTION,
    )


def _badness(result: CaseResult) -> tuple[int, bytes]:
    return WORSE_LATER.index(result.verdict), msgspec.json.encode(result)


def exercised(result: MonitorResult) -> bool:
    """Whether the monitor judged something, so that its result is evidence."""
    return result.verdict is not Verdict.VACUOUS


def known_margin(result: MonitorResult) -> float | None:
    """The margin if it is a finite number."""
    margin = result.margin
    return margin if margin is not None and math.isfinite(margin) else None


def factor_text(value: Any) -> str:
    """A factor's value in its usual notation, with at most six digits."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(factor_text(item) for item in value) + "]"
    return str(value)


def factors_text(case: Case) -> str:
    """All factors in one line; the seed if there are none."""
    words = [f"{name} = {factor_text(value)}" for name, value in case.factors.items()]
    return ", ".join(words) if words else f"seed {case.seed}"
