"""A sample of `hil run energy`: friction braking where necessary, and low voltage without harm."""

from pathlib import Path

import pytest

from metro_hil.cli.hil import main


@pytest.mark.parametrize("name", ["power-limited-late", "green-undervoltage"])
def test_a_scenario_of_the_energy_campaign_holds(name: str, tmp_path: Path) -> None:
    assert main(["run", name, "--workers", "1", "--out", str(tmp_path / "out")]) == 0
