"""Reads campaigns: the file, its scenarios, the points of its sweeps, and the resulting cases."""

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
