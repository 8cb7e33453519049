"""Cases whose controller is its own process: identical frames, and each failure has its verdict."""

import json
import re
import shlex
import statistics
import sys
from pathlib import Path
from typing import Any, Final

import pytest

from metro_hil.campaign.builder import Scenario
from metro_hil.cli.hil import main
from metro_hil.engine.folder import find_folder
from metro_hil.engine.journal import read_journal
from metro_hil.model.case import CaseResult, Verdict
from metro_hil.model.log_columns import read_columns
from metro_hil.model.run_folder import RunFolder
from metro_hil.pytest.bench import Bench
from metro_hil.replay import replay_run
from metro_hil.run.dispatch import run_case

ROOT: Final = Path(__file__).parents[2]
EXAMPLE: Final = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
HOP: Final = {"start": "II", "end": "III", "duration_s": 180.0}
SHORT: Final = {**HOP, "duration_s": 20.0}
ARRIVES: Final = {"name": "arrives", "measure": "arrived_count", "min": 1.0}
DIES_AT_S: Final = 14.0

SPOILED: Final = f"""\
import json, os, sys, time
sys.path[:0] = {[str(ROOT)]!r}
from vobc.cli import grant
how, pids = sys.argv[1:]
with open(pids, "a+") as file:
    file.seek(0)
    again = bool(file.read())
    file.write(f"{{os.getpid()}}\\n")
if how == "no start" or how == "never again" and again:
    sys.exit("no room on the board")
say = grant._say
def spoiled(lines, message):
    if getattr(message, "now_ns", 0) >= {DIES_AT_S} * 1e9:
        if how == "dies":
            raise ZeroDivisionError("in the brake curve")
        if how == "killed":
            os.kill(os.getpid(), 9)
        if how == "hangs":
            time.sleep(3600)
        if how == "garbage":
            lines.write(b"brake!\\n")
            return lines.flush()
    say(lines, message)
grant._say = spoiled
sys.exit(grant.main([]))
"""
"""The shipped controller with one defect. Each start writes its process id to a file."""


class Spoiled:
    def __init__(self, folder: Path) -> None:
        self._program = folder / "spoiled.py"
        self._pids = folder / "pids"
        self._program.write_text(SPOILED)

    def table(self, how: str, **keys: object) -> dict[str, Any]:
        """The controller table of a scenario."""
        words = (sys.executable, str(self._program), how, str(self._pids))
        return {"kind": "command", "command": shlex.join(words), **keys}

    def started(self) -> list[int]:
        return [int(line) for line in self._pids.read_text().split()]

    def assert_gone(self, starts: int = 1) -> None:
        pids = self.started()
        assert len(pids) == starts
        assert not [pid for pid in pids if Path(f"/proc/{pid}").exists()]


@pytest.fixture
def spoiled(tmp_path: Path) -> Spoiled:
    return Spoiled(tmp_path)


def hop(train: dict[str, Any] = HOP, **keys: Any) -> Scenario:
    return Scenario(name="hop", train=train, **keys)


def result_of(train: dict[str, Any] = HOP, **keys: Any) -> CaseResult:
    (case,) = hop(train, **keys).cases()
    return run_case(case)


OURS: Final = (
    {"kind": "checkout", "path": str(ROOT)},
    {"kind": "command", "command": shlex.join((sys.executable, "-m", "vobc", "grant"))},
    {
        "kind": "command",
        "command": f"{shlex.quote(sys.executable)} -m vobc grant --connect {{grant}}",
    },
)


def told_by_any(measures: dict[str, float | None]) -> dict[str, float | None]:
    """The measures without those of ATO demands, which only the shipped controller reports, and
    without the bounds, which frames round up."""
    return {
        name: value
        for name, value in measures.items()
        if not name.startswith("commanded_") and "_bound_" not in name
    }


@pytest.fixture(scope="module")
def shipped() -> CaseResult:
    return result_of(monitor=[ARRIVES])


@pytest.mark.parametrize("controller", OURS, ids=("checkout", "standard input", "socket"))
def test_the_shipped_controller_as_a_process_runs_the_same_case(
    controller: dict[str, Any], shipped: CaseResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(ROOT)

    ours = result_of(controller=controller, monitor=[ARRIVES])

    assert ours.verdict is Verdict.PASS, ours.reason
    assert ours.chain == shipped.chain
    assert told_by_any(ours.measures) == told_by_any(shipped.measures)
    bound_m, exact_m = (each.measures["stop_bound_worst_m"] for each in (ours, shipped))
    assert bound_m is not None
    assert exact_m is not None
    assert exact_m <= bound_m <= exact_m + 0.05
    assert ours.monitors == shipped.monitors


@pytest.mark.parametrize(
    "fault",
    [
        {"kind": "controller_killed", "start_s": 14.0},
        {"kind": "controller_killed", "start_s": 14.0, "end_s": 14.5},
        {"kind": "controller_paused", "start_s": 14.0, "end_s": 14.33},
        {"kind": "clock_step", "step_s": 0.2, "start_s": 14.0},
        {"kind": "frame_delay", "delay_s": 0.03, "start_s": 14.0, "end_s": 16.0},
    ],
    ids=("killed", "restarted", "paused", "stepped", "delayed"),
)
def test_a_fault_acts_equally_on_a_controller_process(fault: dict[str, Any]) -> None:
    ours = result_of(SHORT, controller=OURS[0], fault=[fault])
    shipped = result_of(SHORT, fault=[fault])

    assert ours.verdict is Verdict.PASS, ours.reason
    assert ours.chain == shipped.chain
    assert told_by_any(ours.measures) == told_by_any(shipped.measures)


def test_a_slow_controller_sends_everything_late(bench: Bench, tmp_path: Path) -> None:
    """The oracle is BRAKE_CMD on the bus, which comes later by the delay than without the fault."""
    slow = {"kind": "slow_cycle", "extra_s": 0.03, "start_s": 14.0, "end_s": 18.0}
    first_ns = []
    for number, faults in enumerate(([], [slow])):
        live = bench.start(hop(controller=OURS[0], fault=faults))
        live.run_for(19.0)
        live.close()
        log = (tmp_path / f"run{number + 1}" / "bus.log").read_text().splitlines()
        stamps = [float(line[1:].partition(")")[0]) for line in log if " 101#" in line]
        first_ns.append([stamp for stamp in stamps if 14.1 < stamp < 17.9])

    assert len(first_ns[0]) == len(first_ns[1]) > 70
    late_s = [late - stamp for stamp, late in zip(*first_ns, strict=True)]
    # It comes later than that only where a wake-up in between kept the controller busy.
    assert min(late_s) > 0.0285
    assert statistics.median(late_s) == pytest.approx(0.03, abs=0.001)
    assert max(late_s) < 0.065


def test_a_killed_controller_is_gone_at_once_and_gets_its_restart_data(
    spoiled: Spoiled, tmp_path: Path
) -> None:
    fault = {"kind": "controller_killed", "start_s": 14.0, "end_s": 14.5}
    (case,) = hop(SHORT, controller=spoiled.table("well"), fault=[fault]).cases()
    place = RunFolder(tmp_path / "run")
    place.path.mkdir()

    result = run_case(case, folder=place)

    spoiled.assert_gone(starts=2)
    assert result.verdict is Verdict.PASS, result.reason
    log = (place.path / "ports.log").read_text().splitlines()
    told = [json.loads(line[6:])["told"] for line in log if line.startswith("start ")]
    assert [each["start_ns"] for each in told] == [0, 14_500_000_000]
    assert told[1]["memory"]["boot_count"] == told[0]["memory"]["boot_count"] + 1
    assert told[0]["standing"] is None
    assert told[1]["standing"] is not None
    again = replay_run(place.path)
    assert again.identical, again.first
    assert again.controllers == 2


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ("dies", ["died at t=14.000 s", "exit code 1", "ZeroDivisionError: in the brake curve"]),
        ("killed", ["died at t=14.000 s", "SIGKILL"]),
        ("hangs", ["hung at t=14.000 s", "no answer within 0.4 s"]),
        ("garbage", ["broke the protocol at t=14.000 s", "brake!"]),
    ],
)
def test_a_failing_controller_fails_the_case_and_the_run_continues_to_standstill(
    spoiled: Spoiled, tmp_path: Path, how: str, words: list[str]
) -> None:
    lease_s = 0.4 if how == "hangs" else 20.0
    (case,) = hop(controller=spoiled.table(how, lease_s=lease_s)).cases()
    place = RunFolder(tmp_path / "run")
    place.path.mkdir()

    result = run_case(case, folder=place)

    spoiled.assert_gone()
    assert result.verdict is Verdict.FAIL
    assert result.exit_reason == "the controller died"
    for word in words:
        assert word in result.reason
    truth = read_columns(place.truth_log)
    speeds_mps = truth.numbers("speed_mps")
    assert speeds_mps[truth.numbers("t_s") == DIES_AT_S] > 5.0
    assert speeds_mps[-1] == 0.0
    assert DIES_AT_S < result.sim_s < DIES_AT_S + 30.0
    told = [event for event in result.events if "controller" in event.what]
    assert [event.at_s for event in told] == [DIES_AT_S]


@pytest.mark.parametrize(
    ("controller", "words"),
    [
        ({"kind": "checkout", "path": "/nowhere/at/all"}, "/nowhere/at/all"),
        ({"kind": "command", "command": "/no/such/program"}, "/no/such/program"),
        ({"kind": "command", "command": "false"}, "exit code 1"),
        ({"kind": "command", "command": "cat"}, "controller"),
    ],
)
def test_a_controller_that_does_not_start_blocks_the_case(
    controller: dict[str, Any], words: str, tmp_path: Path
) -> None:
    (case,) = hop(controller=controller).cases()

    result = run_case(case, folder=RunFolder(tmp_path))

    assert result.verdict is Verdict.BLOCKED
    assert words in result.reason
    assert (tmp_path / "ports.log").read_text() == "end 0\n"


def test_a_controller_that_does_not_restart_fails_the_case(spoiled: Spoiled) -> None:
    fault = {"kind": "controller_killed", "start_s": 14.0, "end_s": 14.5}

    result = result_of(controller=spoiled.table("never again"), fault=[fault])

    spoiled.assert_gone(starts=2)
    assert result.verdict is Verdict.FAIL
    assert "did not start again at t=14.500 s" in result.reason
    assert "no room on the board" in result.reason


def test_the_example_of_the_document_is_judged(tmp_path: Path) -> None:
    (example,) = EXAMPLE.findall(
        (ROOT / "docs/reference/lockstep_interface.md").read_text(encoding="utf-8")
    )
    path = tmp_path / "example.py"
    path.write_text(example)
    command = shlex.join((sys.executable, str(path)))

    result = result_of(controller={"kind": "command", "command": command}, invariants="none")

    assert result.verdict is Verdict.INCONCLUSIVE
    assert result.reason == "the train never moved; nothing is watched"
    assert result.exit_reason == "stands for good"


def test_a_test_observes_the_death_of_a_controller_and_the_run_goes_on(
    bench: Bench, spoiled: Spoiled
) -> None:
    run = bench.start(hop(controller=spoiled.table("dies")))
    with pytest.raises(Exception, match=r"died at t=14\.000 s"):
        run.run_for(30.0)

    run.run_until("speed_mps == 0", timeout_s=30.0)

    result = run.close()
    spoiled.assert_gone()
    assert result.verdict is Verdict.FAIL
    assert "in the brake curve" in result.reason


@pytest.mark.sources
def test_a_bench_error_leaves_no_process_behind(
    spoiled: Spoiled, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(self: object, stamp_ns: int, can_id: int, data: bytes) -> None:
        raise KeyError("the bench")

    monkeypatch.setattr("metro_hil.model.frame_hash.FrameHash.frame", fails)

    with pytest.raises(KeyError):
        result_of(controller=spoiled.table("well"))

    spoiled.assert_gone()


def test_a_worker_survives_every_failure_of_its_controllers(
    spoiled: Spoiled,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The campaign keeps the logs of the failing runs themselves."""
    monkeypatch.chdir(tmp_path)
    kinds = {
        "dies": spoiled.table("dies"),
        "hangs": spoiled.table("hangs", lease_s=0.4),
        "absent": {"kind": "command", "command": "/no/such/program"},
        "well": spoiled.table("well"),
    }
    lines = ['name = "others"', *_train()]
    for name, table in kinds.items():
        lines += ["[[scenario]]", f'name = "{name}"', "[scenario.controller]"]
        lines += [f"{key} = {json.dumps(value)}" for key, value in table.items()]
    Path("others.toml").write_text("\n".join(lines))

    code = main(
        ["run", "others.toml", "--workers", "1", "--json", "--keep-worst", "0", "--no-report"]
    )

    document = json.loads(capsys.readouterr().out)
    folder = find_folder(None)
    results = {one.case_id.split("/")[0]: one for one in read_journal(folder.journal_path).results}
    assert code == 1
    assert document["problems"] == []
    assert {name: result.verdict.value for name, result in results.items()} == {
        "dies": "fail",
        "hangs": "fail",
        "absent": "blocked",
        "well": "pass",
    }
    assert {result.host.attempts for result in results.values()} == {1}
    assert len({result.host.worker for result in results.values()}) == 1
    assert not [pid for pid in spoiled.started() if Path(f"/proc/{pid}").exists()]
    kept = folder.kept(results["dies"].case_id)
    assert json.loads(kept.results.read_text())["chain"] == results["dies"].chain
    assert (kept.path / "ports.log").stat().st_size > 0


def _train() -> list[str]:
    return ["[train]", *(f"{key} = {json.dumps(value)}" for key, value in SHORT.items())]
