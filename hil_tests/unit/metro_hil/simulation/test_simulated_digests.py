"""The simulator runs every seed as version 0.1.0 did.

The digests were recorded with commit 9a50b18, with one or two seeds of each profile; the seed that
is a multiple of 8 goes through the real codec. A commit that changes a run on purpose records them
again and says why.
"""

from typing import Final

import pytest

from metro_hil.cli.hil import main
from metro_hil.simulation.run import Phases
from metro_hil.simulation.simulate import SeedJob

DIGESTS: Final = {
    1: "64b7093a6753613860a38ed7d09b2b35",
    8: "502b6abb17eaadd2a8f495c7f88fcb1c",
    10_003: "cfc7fffb52971e74b8362cd33fbf2263",
    20_001: "bac39d3ec0e5478678237e8497661573",
    100_001: "fcfec5324ae118a65ffef4c9d728e03e",
    110_001: "c45b5ee135cda401470c881efb92b35f",
    120_003: "64c33ae1cb311cc131ce11f0901d9a56",
    130_002: "51d84e4026e52932e8f6b7af775790b2",
    200_005: "a89028f9f3e86cdfe11b5e4bb52b7ca6",
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
