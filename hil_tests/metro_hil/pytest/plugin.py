"""The fixture `bench`: scenarios of the bench as tests of pytest.

    def test_a_runaway_is_stopped(bench):
        result = bench.run(
            Scenario(
                train={"end": "I"},
                fault=[{"kind": "traction_runaway", "when": "speed_mps > 16.6"}],
            )
        )
        assert result.verdict is Verdict.PASS, result.reason

A scenario is what a campaign file holds and gives the same case, with the same frames. Where a test
wants to look while the train runs, `bench.start` gives a run that goes on piece by piece.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from metro_hil.pytest.bench import Bench


@pytest.fixture
def bench(tmp_path: Path) -> "Iterator[Bench]":
    """A bench in virtual time."""
    # Every run of pytest where this package is installed loads this module.
    from metro_hil.pytest.bench import Bench

    made = Bench(tmp_path)
    yield made
    made.close()
