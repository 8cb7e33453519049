"""The report of a campaign: makes a page, JUnit XML, Parquet and tables from cases and results."""

from metro_hil.report.campaign.info import CampaignInfo
from metro_hil.report.campaign.write import write_reports

__all__ = ["CampaignInfo", "write_reports"]
