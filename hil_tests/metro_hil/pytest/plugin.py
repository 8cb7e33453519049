"""The fixture `bench`: scenarios of the bench as tests of pytest.

    def test_a_runaway_is_stopped(bench):
        result = bench.run(
            Scenario(
                train={"end": "I"},
                fault=[{"kind": "traction_runaway", "when": "speed_mps > 16.6"}],
            )
        )
        assert result.measures["emergency_count"] == 1.0

A scenario has the keys of a campaign file and gives the same case, with the same frames. If a test
needs to look while the train runs, `bench.start` gives it a run to drive piece by piece.

When the test ends, the bench judges all of its runs: a violated monitor or invariant, or a planned
fault that never began, fails the test unless the call says `expect=`.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import pytest

if TYPE_CHECKING:
    from metro_hil.pytest.bench import Bench

BENCHES: Final = pytest.StashKey["list[Bench]"]()
HEAD: Final = "the bench judges what this test ran:"
REMEDY: Final = (
    "If the test is about a violation, name it: expect='NAME'. A fault that never began needs "
    "another window or a longer run."
)


@pytest.fixture
def bench(request: pytest.FixtureRequest, tmp_path: Path) -> "Iterator[Bench]":
    """A bench in virtual time."""
    # Imported here, because every run of pytest loads this module where this package is installed.
    from metro_hil.pytest.bench import Bench

    made = Bench(tmp_path)
    request.node.stash.setdefault(BENCHES, []).append(made)
    yield made
    # Runs that began after the test's own body, or where this plugin is not registered.
    _fail_for(made.judge())


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    """Judge at the end of the body, so that the test itself fails; its own failure comes first."""
    try:
        yield
    except (KeyboardInterrupt, SystemExit, pytest.exit.Exception):
        raise
    except BaseException:
        # Outcomes of pytest, such as a skip, are not subclasses of Exception.
        if said := _judged(item, quietly=True):
            item.add_report_section("call", "bench", _text(said))
        raise
    _fail_for(_judged(item))


def _judged(item: pytest.Item, *, quietly: bool = False) -> Sequence[str]:
    said: list[str] = []
    for made in item.stash.get(BENCHES, []):
        try:
            said += made.judge()
        except Exception as error:
            if not quietly:
                raise
            said.append(f"not judged: {error!r}")
    return said


def _fail_for(said: Sequence[str]) -> None:
    if said:
        pytest.fail(_text(said), pytrace=False)


def _text(said: Sequence[str]) -> str:
    return "\n".join([HEAD, *[f"  {each}" for each in said], REMEDY])
