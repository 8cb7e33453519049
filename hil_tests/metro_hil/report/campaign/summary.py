"""summary.json: the data of a campaign for scripts."""

import json
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from metro_hil.model.case import Verdict, expected_text
from metro_hil.report.campaign.info import CampaignInfo
from metro_hil.report.campaign.ledger import Ledger, LedgerEntry, known_margin
from metro_hil.report.campaign.tally import MeasureTally, MonitorOutcome, MonitorTally
from metro_hil.report.campaign.trace import RequirementTrace
from metro_hil.report.campaign.units import unit_of
from metro_hil.report.estimates import CONFIDENCE_RATIO, ConfidenceInterval, pass_share, rounded

FORMAT: Final = 1
QUANTILES: Final = (5.0, 25.0, 50.0, 75.0, 95.0)


def summary_json(
    info: CampaignInfo,
    ledger: Ledger,
    monitors: Sequence[MonitorTally],
    measures: Sequence[MeasureTally],
    traces: Sequence[RequirementTrace],
) -> str:
    """The document, with keys in a fixed order and numbers of six significant digits."""
    document = {
        "format": FORMAT,
        "campaign": {
            "name": info.name,
            "title": info.title,
            "bench": info.bench,
            "controller": info.controller,
            "fingerprint": info.fingerprint,
            "versions": dict(sorted(info.versions.items())),
            "layout": info.layout,
        },
        "subset": {"cases": info.expected_cases, "of": info.planned_cases} if info.subset else None,
        "passed": ledger.good,
        "confidence": CONFIDENCE_RATIO,
        "totals": totals(ledger),
        "scenarios": {
            name: {**_totals_of(entries), "requirements": _requirements(entries)}
            for name, entries in ledger.scenarios().items()
        },
        "monitors": [_monitor(tally) for tally in monitors],
        "measures": {tally.name: _measure(tally) for tally in measures},
        "unexpected": [_entry(e) for e in ledger.entries if not e.as_expected],
        "stray_results": list(ledger.stray),
        "requirements": {trace.requirement.id: _trace(trace) for trace in traces if trace.cases},
        "open_requirements": [t.requirement.id for t in traces if not t.cases],
    }
    return json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def totals(ledger: Ledger) -> dict[str, Any]:
    """Counts over the whole campaign."""
    return {
        "cases": ledger.expected_cases,
        "done": ledger.expected_cases - ledger.missing,
        "as_expected": ledger.as_expected,
        "as_expected_share": _interval(pass_share(ledger.as_expected, ledger.expected_cases)),
        "counts": ledger.counts(),
        "sim_s": rounded(sum(e.result.sim_s for e in ledger.entries if e.result is not None)),
        "frames": sum(e.result.frames for e in ledger.entries if e.result is not None),
    }


def _totals_of(entries: Sequence[LedgerEntry]) -> dict[str, Any]:
    good = sum(entry.as_expected for entry in entries)
    return {
        "cases": len(entries),
        "as_expected": good,
        "as_expected_share": _interval(pass_share(good, len(entries))),
        "counts": {v.value: sum(e.word == v.value for e in entries) for v in Verdict},
        "missing": sum(entry.missing for entry in entries),
    }


def _requirements(entries: Sequence[LedgerEntry]) -> list[str]:
    return list(dict.fromkeys(name for entry in entries for name in entry.case.requirements))


def _monitor(tally: MonitorTally) -> dict[str, Any]:
    return {
        "name": tally.name,
        "unit": tally.unit,
        "requirements": list(tally.requirements),
        "passed": tally.counts[Verdict.PASS],
        "failed": tally.counts[Verdict.FAIL],
        "inconclusive": tally.counts[Verdict.INCONCLUSIVE],
        "not_exercised": tally.not_exercised,
        "pass_share": _interval(tally.share),
        "margin_mean": _interval(tally.mean),
        "margin_least": _seen(tally.least),
    }


def _seen(seen: MonitorOutcome | None) -> dict[str, Any] | None:
    if seen is None:
        return None
    return {
        "margin": rounded(known_margin(seen.result)),
        "case_id": seen.entry.case.id,
        "at_s": rounded(seen.result.at_s),
    }


def _measure(tally: MeasureTally) -> dict[str, Any]:
    values = np.array(tally.values())
    return {
        "unit": unit_of(tally.name),
        "cases": len(values),
        "absent": tally.absent,
        "mean": _interval(tally.mean),
        "min": rounded(float(values.min())),
        "max": rounded(float(values.max())),
        "quantiles": {
            f"{q:g}": rounded(float(x))
            for q, x in zip(QUANTILES, np.percentile(values, QUANTILES), strict=True)
        },
    }


def _entry(entry: LedgerEntry) -> dict[str, Any]:
    return {
        "case_id": entry.case.id,
        "index": entry.case.index,
        "scenario": entry.case.scenario,
        "verdict": entry.word,
        "expected": expected_text(entry.case),
        "reason": entry.reason,
    }


def _trace(trace: RequirementTrace) -> Mapping[str, Any]:
    worst = None
    if trace.worst is not None:
        entry, result = trace.worst
        worst = {
            "monitor": result.name,
            "margin": rounded(known_margin(result)),
            "unit": result.unit,
            "case_id": entry.case.id,
            "at_s": rounded(result.at_s),
        }
    return {
        "standing": trace.standing.value,
        "scenarios": trace.scenarios,
        "cases": {kind.name.lower(): count for kind, count in trace.counts.items()},
        "worst": worst,
    }


def _interval(interval: ConfidenceInterval | None) -> dict[str, float | None] | None:
    if interval is None:
        return None
    return {
        "best": rounded(interval.best),
        "low": rounded(interval.low),
        "high": rounded(interval.high),
    }
