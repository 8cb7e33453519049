"""The frames of the shipped lines and of `hil run smoke` are those that were recorded.

A change of names, rooms or texts leaves all hashes as they are. A commit that changes what the
controller or the train sends records them again and says why. Last: the law `predictive`
plans for late brakes, and raises the demand of weak ones.
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
    "florence": "d595b48cc4f262ebfa539de43b7316501527cf7c573f7f62defd71af745f7732",
    "hefei": "e77dd38e34584f1c9e1f0d25b9a827e619b4210e41c7d8104f7d86a2ed3c21be",
    "changping": "afaece22ec3e2701a781135ab536987927dc33d8708622457e2fd6c70124c18a",
    "nanakuma": "b91e8d0ab6d00e10518a91c49a8f6f7c8258be5500b318417c25db40909fa18e",
    "loop": "17cd192928baeab713899c477d2ce1d619cd341470b2fc936af56bf8449a4ae2",
}
TRAINS: Final = {"hefei": "hefei6", "changping": "typeB4", "nanakuma": "nanakuma4"}
"""Train of each line; florence4 runs on the others."""
SMOKE: Final = (
    "8ecc957bc063b5eb4ec2be69a30dda18d7b031ad0cc727a49b5345ddb24e8960",
    "dfc35c2fb53d2f3a50bf6956351443c77b164128cc913783db9ffd8198f884ff",
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
