"""The frames of the shipped lines and of `hil run smoke` are those of version 0.1.0.

Each hash was recorded with commit 9a50b18. A change of names, rooms or texts leaves all of them as
they are. A commit that changes what the controller or the train sends records them again and says
why.
"""

from typing import Any, Final

import pytest

from firmware_py.settings import shipped_names
from hil_tests.native_rig import code_in
from metro_hil.campaign import plan_cases
from metro_hil.campaign.builder import Scenario
from metro_hil.campaign.scenarios import read_named
from metro_hil.run.dispatch import run_case

RUN_S: Final = 120.0
"""Each line is driven this long, which takes the train out of its first station."""
MOVES: Final = {"name": "moves", "stl": "eventually(speed_mps > 5)", "unit": "m/s"}
LINES: Final = {
    "florence": "bc474d0a0e4c6325a17261c2024fce9c4c5207d2fcb136b9496218bf74a0c780",
    "hefei": "b28fb9516abe45a36fc0d6642b124ef05639db2bfe7fb30a168c3c692f84213c",
    "changping": "91c4056baa7f40433f1c276d55899c2d0c62f4ef146f3f74b5e9fe2b3c789a9a",
    "nanakuma": "282f3250c7cbcf63ef5cd57acf2656a047c1de2df76a134d7612f6ebff0af38f",
    "loop": "cc6716eef29047bda19aee7c3b50f0fed3b042132f30dc3023f6cb72a8b6efae",
}
TRAINS: Final = {"hefei": "hefei6", "changping": "typeB4", "nanakuma": "nanakuma4"}
"""Train of each line; florence4 runs on the others."""
SMOKE: Final = (
    "b5611b7490b048b74461e87eb832dcdb9219a9448172fa2fce4f4ae3e89ef617",
    "833b063ad6a0cb89e40ddbaade37e908f6f27fa404f8cfa28e04f7a6368bbddf",
)


def test_every_shipped_line_has_a_recorded_hash() -> None:
    assert sorted(LINES) == shipped_names("firmware_py.trackdb")


@pytest.mark.parametrize("line", LINES)
def test_a_shipped_line_gives_the_recorded_frames(line: str) -> None:
    name = TRAINS.get(line, "florence4")
    train: dict[str, Any] = {"line": line, "consist": name, "params": name, "duration_s": RUN_S}
    (case,) = Scenario(name=line, train=train, monitor=[MOVES], seeds=1).cases()

    assert run_case(case).chain == LINES[line]


def test_the_frames_in_python_alone_are_the_recorded_ones() -> None:
    """The other tests use C for codec, bus and logs where it can be built."""
    (case,) = Scenario(name="florence", train={"duration_s": RUN_S}, monitor=[MOVES]).cases()

    with code_in("Python"):
        assert run_case(case).chain == LINES["florence"]


def test_the_campaign_smoke_gives_the_recorded_frames() -> None:
    results = [run_case(case) for case in plan_cases(read_named("smoke"))]

    assert tuple(result.chain for result in results) == SMOKE
