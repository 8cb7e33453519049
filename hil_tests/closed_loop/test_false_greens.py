"""Inputs that show nothing, or the opposite, and once came out green: none of them passes."""

import pytest

import metro_hil.pytest.bench  # noqa: F401  # a run of pytest inside this one cannot load numpy again

pytest_plugins = ["pytester"]

HEAD = """\
import pytest
from metro_hil.campaign.builder import Scenario

TRAIN = {"start": "II", "end": "III", "duration_s": 2.0}
BROKEN = {"name": "broken", "stl": "always(t_s < 0.5)"}
UNSEEN = {"name": "unseen", "stl": "eventually(speed_mps > 20)"}
LATE = {"kind": "brake_weak", "start_s": 500.0}

"""
BY_FIXTURE = {
    "a violation that the test never looks at": """
def test_it(bench):
    bench.start(Scenario(train=TRAIN, monitor=[BROKEN])).run_for(1.0)
""",
    "a violation in a run that a fixture started": """
@pytest.fixture
def run(bench):
    return bench.start(Scenario(train=TRAIN, monitor=[BROKEN]))

def test_it(run):
    run.run_for(1.0)
""",
    "a violation in a run that the test closed": """
def test_it(bench):
    run = bench.start(Scenario(train=TRAIN, monitor=[BROKEN]))
    run.run_for(1.0)
    run.close()
""",
    "a monitor that judged nothing": """
def test_it(bench):
    bench.start(Scenario(train=TRAIN, monitor=[UNSEEN])).run_for(1.0)
""",
    "a fault that never began": """
def test_it(bench):
    bench.start(Scenario(train=TRAIN, fault=[LATE])).run_for(1.0)
""",
    "a fault planned on the way that never began": """
def test_it(bench):
    run = bench.start(Scenario(train=TRAIN))
    run.plan_faults(LATE)
    run.run_for(1.0)
""",
    "a fault that another took the place of before it began": """
def test_it(bench):
    run = bench.start(Scenario(train=TRAIN))
    run.plan_faults(LATE)
    run.plan_faults({"kind": "brake_weak"})
    run.run_for(1.0)
""",
    "an expected violation that did not come": """
def test_it(bench):
    run = bench.start(Scenario(train=TRAIN, monitor=[BROKEN]), expect="broken")
    run.run_for(0.3)
""",
    "another violation than the expected one": """
def test_it(bench):
    run = bench.start(Scenario(train=TRAIN, monitor=[BROKEN]), expect="INV-08")
    run.run_for(1.0)
""",
    "an expected name that no monitor has": """
def test_it(bench):
    bench.start(Scenario(train=TRAIN, monitor=[BROKEN]), expect="brokn").run_for(1.0)
""",
    "a whole case whose result nothing is asked of": """
def test_it(bench):
    bench.run(Scenario(train=TRAIN, monitor=[BROKEN]))
""",
    "a whole case with a fault that never began": """
def test_it(bench):
    bench.run(Scenario(train=TRAIN, fault=[LATE]))
""",
    "one of several cases": """
def test_it(bench):
    bench.run_all(Scenario(train=TRAIN, monitor=[BROKEN], seeds=2))
""",
}


def outcomes(pytester: pytest.Pytester, body: str) -> tuple[dict[str, int], str]:
    pytester.makepyfile(HEAD + body)
    done = pytester.runpytest_inprocess("-p", "no:cacheprovider", "-p", "no:xdist")
    return done.parseoutcomes(), done.stdout.str()


@pytest.mark.parametrize("name", BY_FIXTURE)
def test_the_fixture_fails_a_test_that_overlooks_what_its_runs_show(
    pytester: pytest.Pytester, name: str
) -> None:
    counts, said = outcomes(pytester, BY_FIXTURE[name])

    assert counts == {"failed": 1}, said


def test_what_a_test_expects_and_what_is_in_order_passes(pytester: pytest.Pytester) -> None:
    body = """
def test_expected(bench):
    bench.start(Scenario(train=TRAIN, monitor=[BROKEN]), expect="broken").run_for(1.0)

def test_in_order(bench):
    run = bench.start(Scenario(train=TRAIN))
    run.plan_faults({"kind": "brake_weak"})
    run.run_for(1.0)

def test_not_to_begin(bench):
    bench.start(Scenario(train=TRAIN, fault=[LATE]), expect="fault brake_weak").run_for(1.0)
"""

    assert outcomes(pytester, body)[0] == {"passed": 3}


def test_the_failure_of_the_test_itself_comes_first(pytester: pytest.Pytester) -> None:
    body = """
def test_it(bench):
    bench.start(Scenario(train=TRAIN, monitor=[BROKEN])).run_for(1.0)
    assert 1 == 2, "its own"

def test_skipped(bench):
    bench.start(Scenario(train=TRAIN, monitor=[BROKEN])).run_for(1.0)
    pytest.skip("for a reason")
"""

    counts, said = outcomes(pytester, body)

    assert counts == {"failed": 1, "skipped": 1}
    assert said.index("its own") < said.index("Captured bench call") < said.index("broken violated")
