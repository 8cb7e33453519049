"""All files of a campaign's report, written into its folder."""

from collections.abc import Sequence
from pathlib import Path

from metro_hil.cases import Case, CaseResult
from metro_hil.report.campaign.info import CampaignInfo


def write_reports(
    folder: Path, info: CampaignInfo, cases: Sequence[Case], results: Sequence[CaseResult]
) -> list[Path]:
    """Write the reports and name them, in this order: page, JUnit, measures, requirements, summary.

    Args:
        folder: of the campaign; logs of kept runs are looked for in `cases/<id>/`.
        cases: all that the manifest names, in any order.
        results: what came back, in any order; a case without one is missing.
    """
    raise NotImplementedError
