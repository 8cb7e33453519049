"""The frames of the shipped lines and of `hil run smoke` are those that were recorded.

A change of names, rooms or texts leaves all hashes as they are. A commit that changes what the
controller or the train sends records them again and says why. Last: the law `chasing`, which
drives on hefei, identifies its brake.
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
    "florence": "8edbae94d93130eeb09e1a268a0ebe54acae7c250af024abb8ce75a961669a2c",
    "hefei": "e77dd38e34584f1c9e1f0d25b9a827e619b4210e41c7d8104f7d86a2ed3c21be",
    "changping": "77ea8c5bffbc88bf881981ad8dbed753d969d152a7c064accebeac99d6926e13",
    "nanakuma": "dd2e0b3ddf9f315fbc8ce8ac17ac7ee208e35b3dbcc65e1e38b194ef7dc2a473",
    "loop": "d60ccca53a9e6f756dac0eaf0241d980f4bda1240f14f51272a711aa09b1d767",
}
TRAINS: Final = {"hefei": "hefei6", "changping": "typeB4", "nanakuma": "nanakuma4"}
"""Train of each line; florence4 runs on the others."""
SMOKE: Final = (
    "3a134ffcdc97d49525e004b8ecbaf7df0e241015b95fb95aba1f66bd47e2fbb7",
    "12f36435345c4156c9d6fdb60384ab4e27265d9a51196686a4456fa30b2de606",
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
