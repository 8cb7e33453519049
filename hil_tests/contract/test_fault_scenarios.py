"""A shipped scenario causes every kind of fault of the catalogue."""

from metro_hil.campaign import plan_cases, read_campaign
from plant_emulator.faults.kinds import CATALOGUE

CAMPAIGNS = ("faults", "acceptance")


def test_every_kind_of_fault_of_the_catalogue_has_a_scenario() -> None:
    used = {
        fault["kind"]
        for name in CAMPAIGNS
        for case in plan_cases(read_campaign(name))
        for fault in case.faults
    }

    assert set(CATALOGUE) - used == set()
