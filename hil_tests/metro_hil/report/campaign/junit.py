"""JUnit XML: one suite for each scenario, one test for each case, in simulated time."""

import re
from collections.abc import Sequence
from typing import Final
from xml.etree import ElementTree as Tree

from metro_hil.model.case import Verdict, expected_text, fault_text
from metro_hil.report.campaign.info import CampaignInfo
from metro_hil.report.campaign.ledger import (
    LACKING_RESULT,
    Ledger,
    LedgerEntry,
    exercised,
    factor_text,
    known_margin,
)
from metro_hil.report.campaign.trace import RequirementEvidence, evidence_of, requirements_of
from metro_hil.report.estimates import rounded

NOT_XML: Final = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""Characters that XML 1.0 cannot contain."""
REQUIREMENT_WORDS: Final = {
    RequirementEvidence.GOOD: "requirement",
    RequirementEvidence.BAD: "requirement",
    RequirementEvidence.KNOWN: "requirement_known_not_met",
    RequirementEvidence.NOTHING: "",
}
"""Name of the property for a requirement, by the case's evidence. A test that passes because its
failure is expected must not look like a proof."""
UNLISTED: Final = "cases that the manifest counts"


def junit_xml(info: CampaignInfo, ledger: Ledger) -> bytes:
    """The document. Any unexpected case is a failure or an error, so CI never passes with one.

    A fail is a failure. Lost, missing, blocked, invalid, inconclusive and vacuous cases are errors,
    and so is a pass where a failure was expected. An expected fail passes, with a property.
    """
    stamp = f" (subset: {info.subset})" if info.subset else ""
    suites = Tree.Element("testsuites", {"name": _text(f"{info.name}{stamp}")})
    for scenario, entries in ledger.scenarios().items():
        suites.append(_suite(info, scenario, entries))
    if ledger.unlisted or ledger.stray:
        suites.append(_disorder(ledger))
    for name in ("tests", "failures", "errors", "skipped"):
        suites.set(name, str(sum(int(suite.get(name, "0")) for suite in suites)))
    suites.set("time", _seconds(ledger.entries))
    Tree.indent(suites)
    body: bytes = Tree.tostring(suites, encoding="utf-8", xml_declaration=True)
    return body + b"\n"


def _suite(info: CampaignInfo, scenario: str, entries: Sequence[LedgerEntry]) -> Tree.Element:
    suite = Tree.Element("testsuite", {"name": _text(scenario)})
    head = [("bench", info.bench), ("controller", info.controller)]
    head += [("fingerprint", info.fingerprint)]
    head += [("subset", info.subset)] if info.subset else []
    head += [(f"version.{name}", version) for name, version in sorted(info.versions.items())]
    _properties(suite, head)
    for entry in entries:
        suite.append(_case(scenario, entry))
    _count(suite)
    suite.set("time", _seconds(entries))
    return suite


def _case(scenario: str, entry: LedgerEntry) -> Tree.Element:
    case = Tree.Element(
        "testcase",
        {
            "classname": _text(scenario),
            "name": _text(entry.case.id),
            "time": _seconds([entry]),
        },
    )
    _properties(case, _facts(entry))
    outcome = _outcome(entry)
    if outcome is not None:
        case.append(outcome)
    if entry.result is not None and entry.result.events:
        story = Tree.SubElement(case, "system-out")
        lines = [f"{event.at_s:.3f} s  {event.what}" for event in entry.result.events]
        story.text = _text("\n".join(lines))
    return case


def _outcome(entry: LedgerEntry) -> Tree.Element | None:
    if entry.as_expected:
        return None
    kind = "failure" if entry.verdict is Verdict.FAIL else "error"
    attributes = {"type": entry.word, "message": _text(entry.reason)}
    outcome = Tree.Element(kind, attributes)
    violated = [
        f"{m.name}: {m.verdict.value}, margin {_number(known_margin(m))} {m.unit}"
        + (f" at {m.at_s:.3f} s" if m.at_s is not None else "")
        + (f" ({m.detail})" if m.detail else "")
        for m in entry.monitors()
        if m.verdict is not Verdict.PASS
    ]
    outcome.text = _text("\n".join([entry.reason, *violated]))
    return outcome


def _facts(entry: LedgerEntry) -> list[tuple[str, str]]:
    case, result = entry.case, entry.result
    facts = [
        (word, name)
        for name in sorted(requirements_of(entry))
        if (word := REQUIREMENT_WORDS[evidence_of(entry, name)])
    ]
    facts += [("verdict", entry.word), ("expected", expected_text(case)), ("seed", str(case.seed))]
    if entry.as_expected and result is not None and result.reason:
        facts.append(("as_expected", f"{entry.word}: {result.reason}"))
    if result is not None:
        facts += [(f"fault.{each.kind}", fault_text(each)) for each in result.faults]
    facts += [(f"factor.{name}", factor_text(value)) for name, value in case.factors.items()]
    if result is not None:
        facts += [("chain", result.chain), ("frames", str(result.frames))]
    for monitor in entry.monitors():
        unit = "" if monitor.unit == "1" else f" {monitor.unit}"
        shown = f"{_number(known_margin(monitor))}{unit}"
        facts.append((f"margin.{monitor.name}", shown if exercised(monitor) else monitor.detail))
    return facts


def _disorder(ledger: Ledger) -> Tree.Element:
    """Suite of errors that belong to no case of the campaign."""
    suite = Tree.Element("testsuite", {"name": "manifest"})
    for number in range(min(1, ledger.unlisted)):
        text = f"{ledger.unlisted} {UNLISTED} are not there: {LACKING_RESULT}"
        _error(suite, f"unlisted cases {number}", "missing", text)
    for case_id in ledger.stray:
        _error(suite, case_id, "stray", "a result of a case that the campaign does not know")
    _count(suite)
    suite.set("time", "0.000")
    return suite


def _error(suite: Tree.Element, name: str, kind: str, text: str) -> None:
    names = {"classname": "manifest", "name": _text(name), "time": "0.000"}
    case = Tree.SubElement(suite, "testcase", names)
    Tree.SubElement(case, "error", {"type": kind, "message": text})


def _count(suite: Tree.Element) -> None:
    suite.set("tests", str(len(suite.findall("testcase"))))
    suite.set("failures", str(len(suite.findall("testcase/failure"))))
    suite.set("errors", str(len(suite.findall("testcase/error"))))
    suite.set("skipped", "0")


def _properties(parent: Tree.Element, facts: Sequence[tuple[str, str]]) -> None:
    node = Tree.SubElement(parent, "properties")
    for name, value in facts:
        Tree.SubElement(node, "property", {"name": _text(name), "value": _text(value)})


def _seconds(entries: Sequence[LedgerEntry]) -> str:
    """Simulated time, so that the report does not depend on the load of the host."""
    return f"{sum(e.result.sim_s for e in entries if e.result is not None):.3f}"


def _number(value: float | None) -> str:
    shown = rounded(value)
    return "unknown" if shown is None else f"{shown:g}"


def _text(text: str) -> str:
    return NOT_XML.sub("\ufffd", text)
