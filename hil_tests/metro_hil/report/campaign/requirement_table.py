"""The requirement table: scenarios, cases, worst margin and frames of each requirement."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from metro_hil.report.campaign.evidence import FrameSpan, frames_around
from metro_hil.report.campaign.info import CampaignInfo
from metro_hil.report.campaign.ledger import Ledger, known_margin
from metro_hil.report.campaign.trace import (
    RequirementEvidence,
    RequirementStanding,
    RequirementTrace,
)
from metro_hil.report.campaign.units import with_unit


@dataclass(frozen=True, slots=True)
class RequirementRow:
    """One line of the table, ready for output."""

    id: str
    source: str
    text: str
    standing: RequirementStanding
    scenarios: str
    run: int
    """Number of cases that name the requirement."""
    passed: int
    failed: int
    known: int
    """Number of cases that demonstrate an expected violation."""
    nothing: int
    """Number of cases that name the requirement but are no evidence."""
    worst: str
    worst_case: str
    frames: FrameSpan | None


def requirement_rows(folder: Path, traces: Sequence[RequirementTrace]) -> list[RequirementRow]:
    """Rows with the frames of each worst case, which are looked up in the campaign's folder."""
    return [_row(folder, trace) for trace in traces]


def _row(folder: Path, trace: RequirementTrace) -> RequirementRow:
    worst = worst_case = ""
    frames = None
    if trace.worst is not None:
        entry, result = trace.worst
        worst = f"{with_unit(known_margin(result), result.unit)} ({result.name})"
        worst_case = entry.case.id
        if result.at_s is not None:
            frames = frames_around(folder, entry, result.at_s)
    return RequirementRow(
        id=trace.requirement.id,
        source=trace.requirement.source,
        text=trace.requirement.text,
        standing=trace.standing,
        scenarios=", ".join(trace.scenarios),
        run=trace.cases,
        passed=trace.counts[RequirementEvidence.GOOD],
        failed=trace.counts[RequirementEvidence.BAD],
        known=trace.counts[RequirementEvidence.KNOWN],
        nothing=trace.counts[RequirementEvidence.NOTHING],
        worst=worst,
        worst_case=worst_case,
        frames=frames,
    )


def requirements_markdown(
    info: CampaignInfo, ledger: Ledger, rows: Sequence[RequirementRow]
) -> str:
    """The table as Markdown; requirements without evidence are listed separately."""
    lines = [
        f"# Requirements: {_cell(info.title or info.name)}",
        "",
        f"Campaign {_cell(info.name)}: {ledger.as_expected} of {ledger.expected_cases} cases as "
        f"expected, {ledger.missing} missing.",
        *_stamp(info),
        "",
        "| requirement | source | text | standing | scenarios | cases | passed | failed "
        "| worst margin | worst case | frames |",
        "|---|---|---|---|---|---:|---:|---:|---|---|---|",
    ]
    shown = [row for row in rows if row.run]
    for row in shown:
        cells = (
            *(row.id, row.source, row.text, row.standing.value, row.scenarios),
            *(str(row.run), str(row.passed), _failed(row)),
            *(row.worst, row.worst_case, row.frames.text if row.frames else ""),
        )
        lines.append("| " + " | ".join(_cell(cell) for cell in cells) + " |")
    if not shown:
        lines.append("| none | | | | | | | | | | |")
    if remarks := ledger.remarks():
        lines += ["", "## Expected failures, and what may show nothing", ""]
        lines += [f"- {_cell(each.text)} ({each.where})" for each in remarks]
    lines += ["", "## Open: no evidence in this campaign", ""]
    for row in rows:
        if row.standing is RequirementStanding.OPEN:
            lines.append(f"- {row.id} ({_cell(row.source)}): {_cell(row.text)}")
    return "\n".join(lines) + "\n"


def _stamp(info: CampaignInfo) -> list[str]:
    """Warning above the table if the campaign is only a subset."""
    if not info.subset:
        return []
    words = f"Subset: {info.subset}. No requirement counts as met before all of them were run."
    return ["", f"**{words}**"]


def _failed(row: RequirementRow) -> str:
    return f"{row.failed} (+{row.known} known)" if row.known else str(row.failed)


def _cell(text: str) -> str:
    """Escape text so that it neither ends the cell nor acts as markup."""
    plain = " ".join(text.split()).replace("\\", "\\\\")
    for mark in ("|", "<", "[", "]", "*", "`"):
        plain = plain.replace(mark, "\\" + mark)
    return plain
