"""Writes all files of a campaign's report into its folder."""

from collections.abc import Sequence
from pathlib import Path

from firmware_py.storage.whole_file import whole_file, write_whole
from metro_hil.model.case import Case, CaseResult
from metro_hil.report.campaign.info import CampaignInfo


def write_reports(
    folder: Path, info: CampaignInfo, cases: Sequence[Case], results: Sequence[CaseResult]
) -> list[Path]:
    """Write the reports; return the paths of page, JUnit, measures, requirements, summary, figures.

    Equal campaigns give equal bytes, independent of the order of the results and of the host.

    Args:
        folder: the campaign's folder, which may hold logs of kept runs.
        cases: all cases that the manifest names, in any order.
        results: all results, in any order; a case without one is missing.
    """
    # Imported here, because these need heavy libraries.
    from metro_hil.model.requirements import shipped_requirements
    from metro_hil.report.campaign.junit import junit_xml
    from metro_hil.report.campaign.ledger import join
    from metro_hil.report.campaign.page.render import Content, render_page
    from metro_hil.report.campaign.parquet import write_parquet
    from metro_hil.report.campaign.requirement_table import requirement_rows, requirements_markdown
    from metro_hil.report.campaign.summary import summary_json
    from metro_hil.report.campaign.tally import tally_measures, tally_monitors
    from metro_hil.report.campaign.trace import trace_requirements
    from metro_hil.report.layouts import LAYOUTS

    ledger = join(cases, results, expected_cases=info.expected_cases)
    monitors, measures = tally_monitors(ledger), tally_measures(ledger)
    traces = trace_requirements(shipped_requirements(), ledger, subset=bool(info.subset))
    rows = requirement_rows(folder, traces)
    pairs = [(entry.case, entry.result) for entry in ledger.entries]
    layout = LAYOUTS.get(info.layout or "")
    tables = [] if layout is None else layout.tables(pairs)
    figures = [] if layout is None else layout.draw(folder, [case for case, _ in pairs])
    content = Content(info, ledger, monitors, measures, rows, tables, figures)
    paths = [folder / name for name in FILES]
    page, junit, parquet, requirements, summary = paths
    write_whole(page, render_page(folder, content))
    write_whole(junit, junit_xml(info, ledger))
    with whole_file(parquet) as part:
        write_parquet(part, info, ledger)
    write_whole(requirements, requirements_markdown(info, ledger, rows))
    write_whole(summary, summary_json(info, ledger, monitors, measures, traces))
    return [*paths, *(figure.path for figure in figures)]


FILES = ("report.html", "junit.xml", "measures.parquet", "requirements.md", "summary.json")
"""File names in the order of `write_reports`."""
