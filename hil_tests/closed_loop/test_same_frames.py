"""The frames of the shipped lines and of `hil run smoke` are those that were recorded.

A change of names, rooms or texts leaves all hashes as they are. A commit that changes what the
controller or the train sends records them again and says why. Last: a second measurement has to
confirm the scale of the wheels, so the interval of the front has another width.
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
    "florence": "09a89c5c878ce372928afad77b16a6337290e15f4ad86fc7cceda9374ad4e1b7",
    "hefei": "1281b532397336c6793fd0a7c7ea4fe60cd911f25e85234fa4654d1b4c16562a",
    "changping": "6fa5686bfb4632da78254fe00d664bed4cdff4bfe9b401718cb9a90b655671d3",
    "nanakuma": "cb0ff3fa6decccfe95decc9fd600e2b19230b9a94cb4fe10b852a75f7d58bb7b",
    "loop": "8ba2f210ae766e64e14f88a47b8df4aba0e92cdc78408c67112949149f0c0b2f",
}
TRAINS: Final = {"hefei": "hefei6", "changping": "typeB4", "nanakuma": "nanakuma4"}
"""Train of each line; florence4 runs on the others."""
SMOKE: Final = (
    "44f47849a3e2e1386321f6c409aaee3d753189170f27e8e9b19b76aeee1a2b7d",
    "a121340d32c59db7cf4cee17419176eec8d27f782937edec385f7583de2cced2",
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
