"""Inputs without evidence, or with evidence of a failure, that once passed: none of them passes."""

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

import metro_hil.pytest.bench  # noqa: F401  # a run of pytest inside this one cannot load numpy again
from can_dbc.binding import can_id
from can_dbc.brake import BrakeCommand
from can_dbc.odometer import Tacho
from canlog.command import main as canlog
from canlog.damage import Damages
from canlog.formats import candump_write as candump
from canlog.frames import Frames
from canlog.rows import from_rows
from hil_tests.unit.metro_hil.report.test_report_commands import left_behind
from hil_tests.unit.metro_hil.report.test_report_comparison_power import Campaign, campaign_of
from metro_hil.cli.hil import main as hil
from metro_hil.model.run_options import EXIT_ENVIRONMENT

pytest_plugins = ["pytester"]
MS = 1_000_000

HEAD = """\
import pytest
from pytest import skip
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
def test_the_fixture_fails_a_test_that_ignores_a_failed_run(
    pytester: pytest.Pytester, name: str
) -> None:
    counts, said = outcomes(pytester, BY_FIXTURE[name])

    assert counts == {"failed": 1}, said


def test_expected_failures_and_correct_runs_pass(pytester: pytest.Pytester) -> None:
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


def test_the_failure_of_the_test_itself_is_reported_first(pytester: pytest.Pytester) -> None:
    body = """
def test_it(bench):
    bench.start(Scenario(train=TRAIN, monitor=[BROKEN])).run_for(1.0)
    assert 1 == 2, "its own"

def test_skipped(bench):
    bench.start(Scenario(train=TRAIN, monitor=[BROKEN])).run_for(1.0)
    skip("for a reason")
"""

    counts, said = outcomes(pytester, body)

    assert counts == {"failed": 1, "skipped": 1}
    assert said.index("its own") < said.index("Captured bench call") < said.index("broken violated")


# The same for logs, campaigns and lines, by the exit codes of their programs.


def beats(*, tacho_until_ms: int = 2000, brake: bool = True) -> Frames:
    """Two messages of the bus at their cycle times; all others are missing."""
    tacho = [(at * MS, can_id(Tacho), 0, "c", bytes(8)) for at in range(0, tacho_until_ms, 20)]
    brakes = [(at * MS, can_id(BrakeCommand), 0, "c", bytes(8)) for at in range(0, 2000, 50)]
    return from_rows(sorted([*tacho, *(brakes if brake else [])]))


def a_log(folder: Path) -> Path:
    path = folder / "whole.log"
    candump.write(path, [beats()], Damages())
    return path


def of_text(text: str, name: str = "x.log") -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        path = folder / name
        path.write_text(text, encoding="utf-8")
        return path

    return write


def of_frames(frames: Frames) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        path = folder / "x.log"
        candump.write(path, [frames], Damages())
        return path

    return write


BY_CANLOG: dict[str, tuple[Callable[[Path], Path], tuple[str, ...], int]] = {
    "a message that ends halfway": (
        *(of_frames(beats(tacho_until_ms=1000)), ("--fail-on", "TACHO: missing > 0"), 1),
    ),
    "a message that is stale when the log ends": (
        *(of_frames(beats(tacho_until_ms=1000)), ("--fail-on", "TACHO: stale > 0"), 1),
    ),
    "a cyclic message that never came": (
        *(of_frames(beats(tacho_until_ms=0)), ("--fail-on", "TACHO: missing > 0"), 1),
    ),
    "its longest gap": (
        *(of_frames(beats(tacho_until_ms=0)), ("--fail-on", "TACHO: gap_ms_max > 100"), 1),
    ),
    "a rule for a name that nothing has": (a_log, ("--fail-on", "TACO: crc_errors > 0"), 1),
    "a rule for a bus that is not there": (a_log, ("--fail-on", "can7: bus_load_ratio > 0.9"), 1),
    "a rule that divides by zero": (a_log, ("--fail-on", "TACHO: missing / extra > 0.1"), 1),
    "an empty log": (of_text(""), ("--fail-on", "missing > 0"), 2),
    "a log of something else": (of_text("once upon a time\n" * 9), (), 2),
    "an empty log of another format": (of_text("date Mon Jan 1\nbase hex\n", "x.asc"), (), 2),
}


@pytest.mark.parametrize("name", BY_CANLOG)
def test_canlog_stats_passes_no_log_without_evidence(tmp_path: Path, name: str) -> None:
    write, rules, code = BY_CANLOG[name]

    assert canlog(["stats", str(write(tmp_path)), *rules]) == code


def test_a_correct_log_passes_its_rules(tmp_path: Path) -> None:
    log = str(a_log(tmp_path))

    for rule in ("TACHO: missing > 0", "BRAKE_CMD: stale > 0", "bus_load_ratio > 0.9"):
        assert canlog(["stats", log, "--fail-on", rule]) == 0


@pytest.mark.parametrize("text", ["", "once upon a time\n"])
def test_a_file_without_a_frame_is_not_converted(tmp_path: Path, text: str) -> None:
    source, target = of_text(text)(tmp_path), tmp_path / "y.blf"

    assert canlog(["convert", str(source), str(target)]) == 2
    assert not target.exists()


def test_a_comparison_that_ignores_everything_is_refused(tmp_path: Path) -> None:
    log = str(a_log(tmp_path))

    assert canlog(["diff", log, log, "--ignore", "*"]) == 2


FELL = {"stop": [0.9, 0.8, 0.7]}
ROSE_BUT_ONE = {"stop": [1.1 if n < 60 else 0.9 - n * 1e-3 for n in range(68)]}
BY_COMPARE: dict[str, tuple[Campaign, Campaign]] = {
    "three pairs, too few to tell": (
        campaign_of({"stop": [1.0] * 3}),
        campaign_of(FELL),
    ),
    "one of many scenarios": (
        campaign_of({"stop": [1.0] * 68}, lambda n: "hop" if n < 60 else "curve"),
        campaign_of(ROSE_BUT_ONE, lambda n: "hop" if n < 60 else "curve"),
    ),
    "a monitor that is gone": (
        campaign_of({"stop": [1.0] * 9, "speed": [1.0] * 9}),
        campaign_of({"speed": [1.0] * 9}),
    ),
    "cases that are gone": (
        campaign_of({"stop": [1.0] * 9}),
        campaign_of({"stop": [1.0] * 8}),
    ),
    "nine pairs among many series that are equal": (
        campaign_of({"stop": [1.0] * 9}, still=50),
        campaign_of({"stop": [0.99 - n * 1e-3 for n in range(9)]}, still=50),
    ),
}


def compared(tmp_path: Path, a: Campaign, b: Campaign, *words: str) -> int:
    folders = [
        left_behind(tmp_path / name, SimpleNamespace(cases=cases, results=results))
        for name, (cases, results) in (("a", a), ("b", b))
    ]
    return hil(["compare", *[str(each.path) for each in folders], *words])


@pytest.mark.parametrize("name", BY_COMPARE)
def test_a_comparison_that_fails_on_worse_needs_evidence_that_nothing_is_worse(
    tmp_path: Path, name: str
) -> None:
    assert compared(tmp_path, *BY_COMPARE[name], "--fail-on-worse") == 1


def test_a_comparison_that_shows_that_nothing_is_worse_passes(tmp_path: Path) -> None:
    better = campaign_of({"stop": [1.1 + n * 1e-3 for n in range(9)]})

    assert compared(tmp_path, campaign_of({"stop": [1.0] * 9}), better, "--fail-on-worse") == 0


def test_an_invalid_smallest_difference_is_a_usage_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one = campaign_of({"stop": [1.0]})

    assert compared(tmp_path, one, one, "--relevant", "m=small") == 2
    said = capsys.readouterr().err
    assert said == "hil: --relevant 'm=small' is not UNIT=NUMBER, such as m=0.01\n"


def test_a_line_that_ends_before_its_ordered_takeover_is_invalid(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--trains", "3", "--bench", "lockstep", "--for", "3.1", "--kill-master-at", "3"]

    assert hil(["run", "line", *words, "--out", str(tmp_path / "run")]) == EXIT_ENVIRONMENT

    assert "no later term was received" in capsys.readouterr().out
    assert json.loads((tmp_path / "run" / "results.json").read_text())["verdict"] == "invalid"
