"""A file of another kind than is wanted: the message says what the file describes."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Final

import pytest

from firmware_py.settings import SettingsError
from firmware_py.trackdb.circuit import load_network
from metro_hil.campaign.read import read_campaign
from metro_hil.model.service import load_service
from plant_emulator.faults.fault_file import load_faults
from plant_emulator.power.supplies import load_supply
from plant_emulator.traffic.config import load_traffic
from plant_emulator.train_config import load_train
from vobc.config import load_config

ROOT: Final = Path(__file__).parents[4]
EXAMPLES: Final = ROOT / "docs" / "examples" / "line"
READERS: Final[dict[str, Callable[[str], object]]] = {
    "a line": load_network,
    "a service": load_service,
    "a consist": load_train,
    "the parameters of a controller": load_config,
    "a supply network": load_supply,
    "the traffic of a line": load_traffic,
    "a campaign": read_campaign,
    "faults": load_faults,
}
FILES: Final = {
    "a service": EXAMPLES / "shuttle.toml",
    "a network": EXAMPLES / "branch.toml",
    "a campaign": EXAMPLES / "turning_faults.toml",
    "a supply network": EXAMPLES / "changping_supply.toml",
    "the traffic of a line": ROOT / "plant_emulator" / "traffic" / "changping.toml",
    "a consist": ROOT / "plant_emulator" / "consists" / "typeB4.toml",
    "the parameters of a controller": ROOT / "vobc" / "params" / "typeB4.toml",
    "a line": ROOT / "firmware_py" / "trackdb" / "florence.toml",
}
READ_TOO: Final = {("a line", "a network"), ("faults", "a campaign")}
"""What a reader also takes: a line is a network of one track, and campaigns have faults."""


@pytest.mark.parametrize("kind", FILES)
@pytest.mark.parametrize("wanted", READERS)
def test_the_message_says_what_the_file_describes(wanted: str, kind: str) -> None:
    if wanted == kind or (wanted, kind) in READ_TOO:
        READERS[wanted](str(FILES[kind]))
        return
    with pytest.raises(SettingsError, match=re.escape(kind)):
        READERS[wanted](str(FILES[kind]))
