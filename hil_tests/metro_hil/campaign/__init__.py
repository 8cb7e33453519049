"""Campaigns: the file, the scenarios in it, the points of its sweeps, the cases they make."""

from metro_hil.campaign.plan import Campaign, ScenarioPlan, SweepPoint, fingerprint, plan_cases
from metro_hil.campaign.problems import CampaignError
from metro_hil.campaign.read import define, read_campaign, read_definition

__all__ = [
    "Campaign",
    "CampaignError",
    "SweepPoint",
    "ScenarioPlan",
    "define",
    "fingerprint",
    "plan_cases",
    "read_campaign",
    "read_definition",
]
