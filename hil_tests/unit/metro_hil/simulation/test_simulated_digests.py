"""The simulator runs every seed as recorded.

The digests cover one or two seeds of each profile; the seed that is a multiple of 8 goes through
the real codec. A commit that changes a run on purpose records them again and says why. They were
last recorded when candidates began to repeat their requests; 500,002 when arbiters of such lines
began to sign their grants.
"""

from typing import Final

import pytest

from metro_hil.cli.hil import main
from metro_hil.simulation.run import Phases
from metro_hil.simulation.simulate import SeedJob

DIGESTS: Final = {
    1: "bb9ac75fe72dc0fb3e3eceaf7db9fa53",
    8: "936c85be9c7cd4ef76ca9289e94d5498",
    10_003: "2221c21848edbb780b1edb588bf216e7",
    20_001: "2e71ab7453bb0556fcc19ec9679da9f4",
    100_001: "118d26d6989d419e4a595dcca89ee566",
    110_001: "c45b5ee135cda401470c881efb92b35f",
    120_003: "5caeea15a1e43639c9afde106ab70a34",
    130_002: "c2d58e5affc5aacc3c19c64eb0a4ad37",
    200_005: "599dcc971fa200430a028c37ed5c7feb",
    400_001: "14951fdac331bc81f913e9970fe7ec8b",
    500_002: "27899d30aeaa5171e2a9be49ad290b2e",
}
JOB: Final = SeedJob(phases=Phases(trouble_s=10.0))


@pytest.mark.parametrize("seed", DIGESTS)
def test_a_seed_runs_as_recorded(seed: int) -> None:
    assert JOB(seed).digest == DIGESTS[seed]


def test_a_named_profile_changes_the_run_and_stands_in_what_repeats_it() -> None:
    dense = SeedJob(phases=Phases(trouble_s=1.0), profile="dense")

    assert "--profile dense" in dense.options()
    assert dense(1).digest != SeedJob(phases=Phases(trouble_s=1.0))(1).digest


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--profile", "dens"], "--profile dens: unknown; nearest valid profile: dense"),
        (["--profile", "dense", "--protocol", "paper"], "--profile: the paper's rules"),
        (["--profile", "dense", "--journal", "x"], "--profile: not with --journal"),
    ],
)
def test_a_profile_that_cannot_be_is_refused(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["simulate", "--seed", "1", *words]) == 2
    assert said in capsys.readouterr().err
