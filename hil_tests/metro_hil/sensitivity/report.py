"""Writes the results of `hil sensitivity`: `sensitivity.json` and `junit.xml` in a folder."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final
from xml.etree import ElementTree as Tree

import msgspec

from firmware_py.clock.clock import WallClock
from metro_hil.engine.errors import EngineError, UsageError
from metro_hil.engine.folder import folder_name
from metro_hil.engine.program import program_version
from metro_hil.model.run_folder import utc_text
from metro_hil.report.campaign.junit import NOT_XML
from metro_hil.sensitivity.findings import MutantFinding, MutantOutcome, count_text

ROOT: Final = Path("runs/sensitivity")
FAILURES: Final = (MutantOutcome.UNNOTICED, MutantOutcome.REFUTED)
ERRORS: Final = (MutantOutcome.INVALID, MutantOutcome.NOT_TRIED)


class Document(msgspec.Struct, frozen=True, kw_only=True):
    """The content of `sensitivity.json`."""

    campaign: str
    program: str
    cases: int
    """Number of cases that the campaign offers to each mutant."""
    of_mutants: int
    """Number of shipped mutants; with fewer findings, only a part of them was tried."""
    interrupted: bool
    counts: dict[str, int]
    findings: tuple[MutantFinding, ...]


def new_folder(campaign: str, out: str | None, root: Path = ROOT) -> Path:
    """An empty folder. Raises UsageError if it is not empty, and EngineError for a disk error."""
    stamp = utc_text(WallClock().epoch_ns()).replace(":", "-")
    path = Path(out) if out else root / f"{stamp}_{folder_name(campaign)}"
    number, free = 2, path
    while not out and free.exists():
        free = path.with_name(f"{path.name}_{number}")
        number += 1
    try:
        free.mkdir(parents=True, exist_ok=True)
        if any(free.iterdir()):
            raise UsageError(f"--out {free}: not empty; name a folder that is new or empty")
    except OSError as error:
        raise EngineError(f"{free}: cannot be made: {error.strerror}") from error
    return free


def document(
    campaign: str,
    findings: Sequence[MutantFinding],
    *,
    cases: int,
    of_mutants: int,
    interrupted: bool,
) -> Document:
    counts = {
        outcome.value: sum(each.outcome is outcome for each in findings)
        for outcome in MutantOutcome
    }
    return Document(
        campaign=campaign,
        program=program_version(),
        cases=cases,
        of_mutants=of_mutants,
        interrupted=interrupted,
        counts=counts,
        findings=tuple(findings),
    )


def write(folder: Path, report: Document) -> Sequence[Path]:
    """Write both files; each is complete or missing. Raises OSError."""
    body = msgspec.json.format(msgspec.json.encode(report), indent=2) + b"\n"
    contents = {"sensitivity.json": body, "junit.xml": junit_xml(report)}
    paths = []
    for name, content in contents.items():
        part = folder / f".{name}.part"
        part.write_bytes(content)
        paths.append(part.replace(folder / name))
    return paths


def junit_xml(report: Document) -> bytes:
    """One test for each mutant; an unnoticed mutant is a failure, an untried one an error."""
    suites = Tree.Element("testsuites", {"name": f"sensitivity {report.campaign}"})
    suite = Tree.SubElement(suites, "testsuite", {"name": report.campaign})
    for finding in report.findings:
        suite.append(_test(finding))
    counts = {
        "tests": len(report.findings),
        "failures": sum(each.outcome in FAILURES for each in report.findings),
        "errors": sum(each.outcome in ERRORS for each in report.findings),
        "skipped": 0,
    }
    for node in (suites, suite):
        for name, count in counts.items():
            node.set(name, str(count))
    Tree.indent(suites)
    body: bytes = Tree.tostring(suites, encoding="utf-8", xml_declaration=True)
    return body + b"\n"


def _test(finding: MutantFinding) -> Tree.Element:
    test = Tree.Element(
        "testcase", {"classname": _text(finding.source), "name": finding.mutant, "time": "0.000"}
    )
    facts = {
        "rule": finding.rule,
        "file": finding.file,
        "outcome": finding.outcome.value,
        "scenario": finding.scenario,
        "case": finding.case,
        "monitor": finding.monitor,
        "tried": str(finding.tried),
    }
    properties = Tree.SubElement(test, "properties")
    for name, value in facts.items():
        Tree.SubElement(properties, "property", {"name": name, "value": _text(value)})
    if not finding.outcome.in_order:
        kind = "failure" if finding.outcome in FAILURES else "error"
        message = _text(f"{finding.outcome.value}: {finding.by()}")
        problem = Tree.SubElement(test, kind, {"type": finding.outcome.value, "message": message})
        problem.text = _text(f"{finding.rule}\n{finding.difference}")
    return test


def _text(text: str) -> str:
    return NOT_XML.sub("\ufffd", text)


def summary(report: Document) -> list[str]:
    """The last lines on the terminal."""
    lines = []
    for finding in report.findings:
        if finding.outcome.in_order or finding.outcome is MutantOutcome.NOT_TRIED:
            continue
        lines.append(f"{finding.outcome.value}: {finding.mutant} ({finding.rule}): {finding.by()}")
        if finding.outcome is MutantOutcome.UNNOTICED:
            lines += [f"  {line}" for line in finding.difference.splitlines()[2:]]
            lines.append(f"  add a scenario that notices it, or an `argued` to {finding.source}")
        if finding.outcome is MutantOutcome.REFUTED:
            lines.append(f"  remove `argued` from it in {finding.source}")
    text = count_text(report.findings)
    if len(report.findings) < report.of_mutants:
        text += f"; a selection of {report.of_mutants}"
    if report.interrupted:
        text += "; interrupted, so the rest is unknown"
    return [*lines, f"{report.campaign}: {text}"]
